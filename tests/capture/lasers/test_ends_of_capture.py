"""The lasers go off within 50 ms however `ringpose capture` ends, and stay on without the watchdog."""

import signal
import time

import pytest
from guarded_lasers import fastest, on_mask

from ringpose.files.images.sessions import read_session

OFF_WITHIN_S = 0.05

HEARTBEAT_S = 1.0

LONG_ON = ("--settle", "0.4", "--sequence", "all,off")
"""Options with which the lasers are on for long enough to be observed."""

OTHER_SCHEMES = ("numato", "modbus", "ascii")

FATAL = [signal.SIGKILL, signal.SIGSEGV]

HANDLED = [signal.SIGTERM, signal.SIGINT, signal.SIGHUP]
"""Signals that the command converts to exceptions, all in the same way."""


def off_time(relays, process, number, time_until, limit_s=30.0):
    """Time from a signal to a capture with lasers on until they are off, and stay off."""
    assert time_until(lambda: on_mask(relays), 30.0) < 30.0
    process.send_signal(number)
    off_s = time_until(lambda: not on_mask(relays), limit_s)
    time.sleep(0.1)
    assert not on_mask(relays)
    return off_s


@pytest.mark.parametrize(
    ("scheme", "number"),
    [
        ("lcus", signal.SIGKILL),
        ("lcus", signal.SIGTERM),
        *(pytest.param("lcus", number, marks=pytest.mark.slow) for number in (signal.SIGSEGV, *HANDLED[1:])),
        *(pytest.param(scheme, signal.SIGKILL, marks=pytest.mark.slow) for scheme in OTHER_SCHEMES),
    ],
)
def test_the_lasers_are_off_within_50_ms_whatever_ends_the_capture(board, capturing, time_until, scheme, number):
    def measured():
        with board(scheme) as (relays, uri), capturing(uri, *LONG_ON, "--force") as process:
            off_s = off_time(relays, process, number, time_until)
        assert process.returncode == (-number if number in FATAL else 128 + number)
        return off_s

    assert fastest(measured, OFF_WITHIN_S) < OFF_WITHIN_S


@pytest.mark.parametrize("scheme", ["lcus", *(pytest.param(each, marks=pytest.mark.slow) for each in OTHER_SCHEMES)])
def test_a_suspended_capture_switches_off_and_can_be_continued(board, capturing, time_until, scheme):
    def measured():
        with board(scheme) as (relays, uri), capturing(uri, *LONG_ON, "--count", "1", "--force") as process:
            off_s = off_time(relays, process, signal.SIGSTOP, time_until)
            process.send_signal(signal.SIGCONT)
            names, message = process.communicate()
        assert (process.returncode, names.count("\n")) == (0, 1)
        assert all("the watchdog switched the lasers off" in line for line in message.splitlines())
        return off_s

    assert fastest(measured, OFF_WITHIN_S) < OFF_WITHIN_S


@pytest.mark.slow
def test_the_lasers_go_off_before_the_memory_of_a_large_capture_is_freed(board, capturing, time_until):
    def measured():
        ballast = "ballast = b'x' * 700_000_000"
        with board("lcus") as (relays, uri), capturing(uri, *LONG_ON, "--force", before=ballast) as process:
            return off_time(relays, process, signal.SIGKILL, time_until)

    assert fastest(measured, OFF_WITHIN_S) < OFF_WITHIN_S


@pytest.mark.parametrize(
    "number",
    [signal.SIGTERM, *(pytest.param(each, marks=pytest.mark.slow) for each in (signal.SIGKILL, signal.SIGINT))],
)
def test_the_lasers_are_off_within_50_ms_whatever_ends_a_live_measurement(board, capturing, time_until, number):
    def measured():
        live = ("pose", "--rig", "rig.yaml")
        with board("lcus") as (relays, uri), capturing(uri, "--settle", "0.4", first=live) as process:
            off_s = off_time(relays, process, number, time_until)
        assert process.returncode == (-number if number in FATAL else 128 + number)
        return off_s

    assert fastest(measured, OFF_WITHIN_S) < OFF_WITHIN_S


@pytest.mark.parametrize(
    "number",
    [signal.SIGKILL, *(pytest.param(each, marks=pytest.mark.slow) for each in (signal.SIGSEGV, signal.SIGSTOP))],
)
def test_without_the_watchdog_the_lasers_stay_on(board, capturing, time_until, without_watchdog, number):
    with board("lcus") as (relays, uri), capturing(uri, *LONG_ON, before=without_watchdog) as process:
        assert time_until(lambda: on_mask(relays), 30.0) < 30.0
        process.send_signal(number)
        off_s = time_until(lambda: not on_mask(relays), 1.4 * HEARTBEAT_S)
        process.kill()

    assert off_s == float("inf")


def test_a_killed_capture_leaves_its_finished_shots_and_can_be_resumed(board, capturing, time_until, tmp_path):
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
