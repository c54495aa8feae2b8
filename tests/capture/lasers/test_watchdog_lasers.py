"""The driver of relay lasers and its watchdog, with a virtual board in this process."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import pytest
from guarded_lasers import fastest, lasers_at, on_mask

from ringpose.capture.lasers.driver import LasersWentOff
from ringpose.errors import DeviceError, LaserSafetyError
from ringpose.simulate.serve.relays import RelayFaults

ALL_SCHEMES = ["lcus", "numato", "modbus", "ascii"]


def have_been_on(relays, since_s: float) -> list[int]:
    """The lasers that have been on since a time, also if they are off again: this process may have waited meanwhile."""
    return [laser for laser, share in enumerate(relays.contacts.shares(since_s, time.monotonic())) if share > 0]


def off_after_signal(uri: str, relays, time_until, number: int, message: str) -> float:
    """Time from a signal to the watchdog until all lasers are off; the next command reports the fault."""
    lasers = lasers_at(uri + "&heartbeat=30&longest_on=30")
    with lasers:
        lasers.set_mask(0b111)
        assert time_until(lambda: on_mask(relays) == 0b111, 20.0) < 20.0
        os.kill(lasers.watchdog_pid, number)
        off_s: float = time_until(lambda: not on_mask(relays), 20.0)
        with pytest.raises(DeviceError, match=message):
            lasers.set_mask(0b001)
    return off_s


@pytest.mark.parametrize("scheme", ALL_SCHEMES)
def test_every_board_switches_and_reports_the_commanded_masks(board, scheme):
    with board(scheme) as (relays, uri):
        lasers, seen = lasers_at(uri), []
        with lasers:
            for mask in (0b001, 0b110, 0b111, 0b010, 0):
                lasers.set_mask(mask)
                seen.append((lasers.read_mask(), on_mask(relays)))  # the board answers when it has switched

    assert seen == [(mask, mask) for mask in (0b001, 0b110, 0b111, 0b010, 0)]


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP, signal.SIGSEGV])
def test_a_watchdog_that_dies_or_stops_is_replaced_at_once(board, time_until, number):
    def measured():
        message = "the watchdog of the lasers ended; they were switched off without it"
        with board("lcus") as (relays, uri):
            off_s = off_after_signal(uri, relays, time_until, number, message)
        assert on_mask(relays) == 0
        return off_s

    assert fastest(measured, 0.05) < 0.05


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGALRM])
def test_a_watchdog_that_receives_an_ending_signal_switches_off_first(board, time_until, number):
    def measured():
        with board("lcus") as (relays, uri):
            return off_after_signal(uri, relays, time_until, number, message="the watchdog of the lasers ended")

    assert fastest(measured, 0.05) < 0.05


def test_an_interrupt_meant_for_the_capture_leaves_the_watchdog_alone(board, time_until):
    with board("lcus") as (relays, uri):
        lasers = lasers_at(uri)
        with lasers:
            os.kill(lasers.watchdog_pid, signal.SIGINT)
            lasers.set_mask(0b100)
            on_s = time_until(lambda: on_mask(relays) == 0b100, 20.0)

    assert on_s < 20.0


def test_an_unplugged_board_is_a_safety_fault_within_100_ms(board):
    def measured():
        with board("lcus") as (relays, uri):
            lasers = lasers_at(uri)
            lasers.open()
            lasers.set_mask(0b001)
            relays.unplug()
            began_s = time.monotonic()
            with pytest.raises(LaserSafetyError, match="watchdog and port are lost, the lasers may be on"):
                lasers.wait(30.0)
            noticed_s = time.monotonic() - began_s
            lasers.close()
        return noticed_s

    assert fastest(measured, 0.1) < 0.1


def test_lasers_go_off_without_heartbeat_and_can_be_switched_on_again(board, time_until):
    with board("lcus") as (relays, uri):
        lasers = lasers_at(uri + "&heartbeat=0.5")
        with lasers:
            began_s = time.monotonic()
            lasers.set_mask(0b001)
            assert time_until(lambda: have_been_on(relays, began_s) == [0], 20.0) < 20.0
            off_s = time_until(lambda: not on_mask(relays), 20.0)
            with pytest.raises(LasersWentOff, match=r"no command came for 0\.5 s; raise heartbeat="):
                lasers.set_mask(0b010)
            still_off = on_mask(relays)
            lasers.set_mask(0)
            began_s = time.monotonic()
            lasers.set_mask(0b010)
            again_s = time_until(lambda: have_been_on(relays, began_s) == [1], 20.0)

    assert off_s < 20.0
    assert still_off == 0
    assert again_s < 20.0
    assert on_mask(relays) == 0


def test_a_laser_that_is_on_for_too_long_goes_off_despite_commands(board, time_until):
    def measured():
        with board("lcus") as (relays, uri):
            lasers = lasers_at(uri + "&longest_on=0.5")
            with lasers:
                began_s = time.monotonic()
                lasers.set_mask(0b001)
                assert time_until(lambda: have_been_on(relays, began_s) == [0], 20.0) < 20.0
                off_s = time_until(lambda: not on_mask(relays), 20.0)
                with pytest.raises(LasersWentOff, match=r"was on for 0\.5 s; raise longest_on="):
                    lasers.read_mask()
        return off_s

    assert fastest(measured, 0.55) < 0.55


WATCHDOG_AT_A_DOOR = """
import sys
sys.path[:] = sys.argv[3].split({{separator!r}})
from pathlib import Path
from ringpose.capture.lasers import watchdog_process
from ringpose.capture.lasers import serial_port
serial_port.SerialPort.is_contact_closed = lambda port, name: name == "{name}" and Path("{door}").exists()
sys.exit(watchdog_process.run(int(sys.argv[1]), sys.argv[2]))
"""
"""Starts the watchdog at a port that has an input, which no pseudo-terminal has."""


@pytest.mark.parametrize("name", ["cts", "dsr"])
def test_lasers_go_off_and_stay_off_while_the_interlock_is_open(board, time_until, monkeypatch, tmp_path, name):
    door = tmp_path / "closed"
    monkeypatch.setattr("ringpose.capture.lasers.watchdog._START", WATCHDOG_AT_A_DOOR.format(name=name, door=door))

    def measured():
        door.touch()
        with board("lcus") as (relays, uri):
            lasers = lasers_at(f"{uri}&interlock={name}&heartbeat=30&longest_on=30")
            with lasers:
                lasers.set_mask(0b101)
                assert lasers.read_mask() == 0b101
                door.unlink()
                off_s = time_until(lambda: not on_mask(relays), 20.0)
                with pytest.raises(LasersWentOff, match="the interlock is open"):
                    lasers.set_mask(0b010)
                lasers.set_mask(0)
                with pytest.raises(DeviceError, match="stay off: the interlock is open"):
                    lasers.set_mask(0b010)
        return off_s

    assert fastest(measured, 0.05) < 0.05


def test_a_timed_pulse_ends_even_if_capture_and_watchdog_are_killed_together(board, time_until):
    program = (
        "import os, signal, sys, time; from ringpose.capture.lasers.watchdog import WatchdogLasers; "
        "from ringpose.capture.lasers.relay_board import settings_of_line; "
        "lasers = WatchdogLasers(settings_of_line(sys.argv[1])); lasers.open(); lasers.set_mask(7); "
        "print(lasers.watchdog_pid, flush=True); time.sleep(60)"
    )
    with board("modbus") as (relays, uri):
        line = lasers_at(uri + "&pulse=0.5").settings.line()
        with subprocess.Popen([sys.executable, "-c", program, line], stdout=subprocess.PIPE, text=True) as process:
            watchdog = int(process.stdout.readline())
            os.kill(watchdog, signal.SIGSTOP)
            process.kill()
            os.kill(watchdog, signal.SIGKILL)
            burning = on_mask(relays)
            off_s = time_until(lambda: not on_mask(relays), 3.0)

    assert burning == 0b111
    assert off_s < 0.6


def test_a_child_that_outlives_the_capture_does_not_keep_the_lasers_on(board, time_until):
    program = (
        "import os, sys, time; from ringpose.capture.lasers.watchdog import WatchdogLasers; "
        "from ringpose.capture.lasers.relay_board import settings_of_line; "
        "lasers = WatchdogLasers(settings_of_line(sys.argv[1])); lasers.open(); lasers.set_mask(7); "
        "os.fork() or time.sleep(3); print('lit', flush=True); time.sleep(60)"
    )

    def measured():
        with board("lcus") as (relays, uri):
            line = replace(lasers_at(uri).settings, heartbeat_s=30.0, longest_on_s=30.0).line()
            words = [sys.executable, "-c", program, line]
            with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, start_new_session=True) as process:
                assert time_until(lambda: on_mask(relays) == 0b111, 20.0) < 20.0
                process.stdout.readline()
                process.kill()
                off_s = time_until(lambda: not on_mask(relays), 20.0)
                os.killpg(process.pid, signal.SIGKILL)
        return off_s

    assert fastest(measured, 0.05) < 0.05


def test_a_board_that_reports_its_coils_does_not_report_a_stuck_contact(board):
    with board("lcus", RelayFaults(stuck=frozenset({1}))) as (relays, uri):
        lasers = lasers_at(uri)
        with lasers:
            lasers.set_mask(0b010)
            lasers.set_mask(0)
            reported = lasers.read_mask()

    assert reported == 0
    assert on_mask(relays) == 0b010
