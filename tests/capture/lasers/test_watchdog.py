"""Conditions under which the watchdog switches off, with a fake clock and board."""

import os
import signal
import subprocess
from dataclasses import replace

import pytest

from ringpose.capture.lasers.relay_board import RelayBoard, RelaySettings, settings_of_line
from ringpose.capture.lasers.watchdog_process import ParentProcess, Watchdog
from ringpose.errors import DeviceError

SETTINGS = RelaySettings(scheme="lcus", port="port", relays=(0, 1, 2), heartbeat_s=1.0, longest_on_s=5.0)


class NotedBoard(RelayBoard):
    def __init__(self, fails=False):
        self.on_mask, self.offs, self.repeats, self.fails = 0, 0, 0, fails

    def set_mask(self, lasers):
        if self.fails:
            raise DeviceError("port", "does not answer", "look")
        self.on_mask = lasers

    def all_off(self):
        self.on_mask, self.offs = 0, self.offs + 1

    def repeat(self):
        self.repeats += 1

    def read_mask(self):
        return self.on_mask


class Clock:
    now_s = 100.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


def watchdog_of(board, clock, faults=(), **changes):
    return Watchdog(board, replace(SETTINGS, **changes), faults, clock)


def test_replies_have_the_number_of_their_command(clock):
    watchdog = watchdog_of(NotedBoard(), clock)

    assert [watchdog.execute(line) for line in ("1 set 5", "2 read", "3 off", "4 read")] == [
        "1 ok 5\n", "2 ok 5\n", "3 ok 0\n", "4 ok 0\n",
    ]  # fmt: skip


def test_a_failure_of_the_board_is_replied(clock):
    assert watchdog_of(NotedBoard(fails=True), clock).execute("7 set 1") == "7 err does not answer; look\n"


@pytest.mark.parametrize(("silent_s", "on_mask"), [(0.9, 1), (1.0, 0)])
def test_a_missing_heartbeat_switches_off(clock, silent_s, on_mask):
    board = NotedBoard()
    watchdog = watchdog_of(board, clock)
    watchdog.execute("1 set 1")

    clock.now_s += silent_s
    watchdog.check()

    assert board.on_mask == on_mask


def test_no_heartbeat_is_needed_with_all_lasers_off(clock):
    board = NotedBoard()
    watchdog = watchdog_of(board, clock)

    clock.now_s += 1000.0
    watchdog.check()

    assert watchdog.wait_s() is None
    assert board.offs == 0


def test_the_time_on_is_counted_from_when_the_laser_came_on(clock):
    board = NotedBoard()
    watchdog = watchdog_of(board, clock)
    watchdog.execute("1 set 1")
    for number, mask in enumerate((3, 1, 5, 1, 3, 1), start=2):
        clock.now_s += 0.8
        watchdog.execute(f"{number} set {mask}")

    clock.now_s += 0.21
    answer = watchdog.execute("9 set 1")

    assert answer == "9 off a laser was on for 5 s; raise longest_on= (and pulse=) if it has to be\n"
    assert board.on_mask == 0


def test_the_time_on_restarts_with_another_laser(clock):
    board = NotedBoard()
    watchdog = watchdog_of(board, clock)
    for number in range(20):
        clock.now_s += 0.8
        watchdog.execute(f"{number} set {1 << number % 3}")

    assert board.on_mask


@pytest.mark.parametrize("repeat_s", [None, 0.2])
def test_a_pulse_bounds_the_time_unless_it_is_repeated(repeat_s):
    settings = RelaySettings(scheme="modbus", port="p", relays=(0,), pulse_s=2.0, repeat_s=repeat_s)

    assert settings.on_limit_s == (2.0 if repeat_s is None else 5.0)


def test_on_commands_are_repeated_for_boards_with_a_watchdog(clock):
    board = NotedBoard()
    watchdog = watchdog_of(board, clock, repeat_s=0.2)
    watchdog.execute("1 set 1")

    for _ in range(4):
        clock.now_s += watchdog.wait_s() or 0.0
        watchdog.check()

    assert board.repeats == 4
    assert clock.now_s == pytest.approx(100.8)


def test_no_laser_is_switched_on_during_a_fault(clock):
    board = NotedBoard()

    assert watchdog_of(board, clock, [lambda: "the interlock is open"]).execute("1 set 1") == (
        "1 err stay off: the interlock is open\n"
    )
    assert board.on_mask == 0


def test_a_fault_switches_off_within_10_ms(clock):
    board, fault = NotedBoard(), [""]
    watchdog = watchdog_of(board, clock, [lambda: "", lambda: fault[0]])
    watchdog.execute("1 set 1")

    fault[0] = "the interlock is open"
    waited_s = watchdog.wait_s()
    watchdog.check()

    assert waited_s == pytest.approx(0.01)
    assert board.on_mask == 0
    assert watchdog.execute("2 set 1") == "2 off the interlock is open\n"


@pytest.mark.parametrize(
    ("number", "fault"), [(signal.SIGSTOP, "the capture was stopped"), (signal.SIGKILL, "the capture is ending")]
)
def test_a_parent_that_is_stopped_or_ending_is_a_fault(monkeypatch, number, fault):
    """Its kernel flags show that it is ending before its memory is freed and its pipes are closed."""
    with subprocess.Popen(["sleep", "600"]) as process:
        monkeypatch.setattr(os, "getppid", lambda: process.pid)
        parent = ParentProcess(process.pid)
        running = parent.fault()
        process.send_signal(number)
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WSTOPPED | os.WNOWAIT)
        found = parent.fault()
        process.kill()
        os.close(parent.end)

    assert (running, found) == ("", fault)


def test_settings_round_trip_through_json():
    settings = RelaySettings(
        scheme="modbus", port="/dev/x y", relays=(2, 0), codec_parameters={"unit": 7}, pulse_s=0.5, interlock="cts"
    )

    assert settings_of_line(settings.line()) == settings
