"""The lasers go off however `ringpose capture` ends, long before a limit of the watchdog; without it they stay on."""

import signal

import pytest
from guarded_lasers import on_mask, wait_for, wait_until_off

from ringpose.files.images.sessions import read_session

LONG_ON = ("--settle", "0.4", "--sequence", "all,off")
"""Options with which the lasers are on for long enough to be observed."""

CAPTURE, LIVE = ("capture", "--output", "s"), ("pose", "--rig", "rig.yaml")

OTHER_SCHEMES = ("numato", "modbus", "ascii")

FATAL = [signal.SIGKILL, signal.SIGSEGV]

HANDLED = [signal.SIGTERM, signal.SIGINT, signal.SIGHUP]
"""Signals that the command converts to exceptions, all in the same way."""


def signal_while_on(relays, process, number):
    """Send a signal to a capture while lasers are on, and wait until they are off."""
    wait_for(lambda: on_mask(relays))
    process.send_signal(number)
    wait_until_off(relays)


@pytest.mark.parametrize(
    ("first", "scheme", "number"),
    [
        (CAPTURE, "lcus", signal.SIGKILL),
        (CAPTURE, "lcus", signal.SIGTERM),
        (LIVE, "lcus", signal.SIGTERM),
        *(pytest.param(CAPTURE, "lcus", each, marks=pytest.mark.slow) for each in (signal.SIGSEGV, *HANDLED[1:])),
        *(pytest.param(CAPTURE, scheme, signal.SIGKILL, marks=pytest.mark.slow) for scheme in OTHER_SCHEMES),
        *(pytest.param(LIVE, "lcus", each, marks=pytest.mark.slow) for each in (signal.SIGKILL, signal.SIGINT)),
    ],
)
def test_the_lasers_go_off_whatever_ends_a_capture_or_a_live_measurement(board, capturing, first, scheme, number):
    words = LONG_ON if first is CAPTURE else LONG_ON[:2]
    with board(scheme) as (relays, uri), capturing(uri, *words, first=first) as process:
        signal_while_on(relays, process, number)
        process.wait()
        assert not on_mask(relays)

    assert process.returncode == (-number if number in FATAL else 128 + number)


@pytest.mark.parametrize("scheme", ["lcus", *(pytest.param(each, marks=pytest.mark.slow) for each in OTHER_SCHEMES)])
def test_a_suspended_capture_switches_off_and_can_be_continued(board, capturing, scheme):
    with board(scheme) as (relays, uri), capturing(uri, *LONG_ON, "--count", "1") as process:
        signal_while_on(relays, process, signal.SIGSTOP)
        process.send_signal(signal.SIGCONT)
        names, message = process.communicate()

    assert (process.returncode, names.count("\n")) == (0, 1)
    assert all("the watchdog switched the lasers off" in line for line in message.splitlines())


@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGSEGV, marks=pytest.mark.slow)])
def test_without_the_watchdog_the_lasers_stay_on(board, capturing, without_watchdog, number):
    with board("lcus") as (relays, uri), capturing(uri, *LONG_ON, before=without_watchdog) as process:
        wait_for(lambda: on_mask(relays))
        process.send_signal(number)
        process.wait()
        assert on_mask(relays)


def test_a_killed_capture_leaves_its_finished_shots_and_can_be_resumed(board, capturing, tmp_path):
    with board("lcus") as (_, uri):
        with capturing(uri, "--settle", "0.01") as process:
            first = process.stdout.readline().strip()
            process.kill()
        with capturing(uri, "--settle", "0.01", "--count", "2", "--append") as process:
            resumed = process.stdout.read().split()

    assert process.returncode == 0
    session = read_session(tmp_path / "s")
    assert [capture.state for capture in session.captures] == ["stopped", "finished"]
    assert len(resumed) == 2
    assert first not in resumed
    assert len(set(session.shots)) == len(session.shots) >= 3
