"""The driver of relay lasers and its watchdog, with a virtual board in this process."""

import os
import signal
import subprocess
import sys
import time

import pytest
from guarded_lasers import lasers_at, on_mask, wait_for, wait_until_off

from ringpose.capture.lasers.driver import LasersWentOff
from ringpose.capture.lasers.relay_board import RelayBoard
from ringpose.capture.lasers.serial_port import SerialPort
from ringpose.errors import DeviceError, LaserSafetyError
from ringpose.simulate.serve.relays import RelayFaults

ALL_SCHEMES = ["lcus", "numato", "modbus", "ascii"]

LOST = "the watchdog of the lasers ended; they were switched off without it"


def have_been_on(relays, since_s: float) -> list[int]:
    """The lasers that have been on since a time, also if they are off again: this process may have waited meanwhile."""
    return [laser for laser, share in enumerate(relays.contacts.shares(since_s, time.monotonic())) if share > 0]


@pytest.mark.parametrize("scheme", ALL_SCHEMES)
def test_every_board_switches_and_reports_the_commanded_masks(board, scheme):
    with board(scheme) as (relays, uri):
        lasers, seen = lasers_at(uri), []
        with lasers:
            for mask in (0b001, 0b110, 0b111, 0b010, 0):
                lasers.set_mask(mask)
                seen.append((lasers.read_mask(), on_mask(relays)))  # the board answers when it has switched

    assert seen == [(mask, mask) for mask in (0b001, 0b110, 0b111, 0b010, 0)]


@pytest.mark.parametrize(
    ("number", "message"),
    [
        *((number, LOST) for number in (signal.SIGKILL, signal.SIGSTOP, signal.SIGSEGV)),
        *((number, "the watchdog of the lasers ended") for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGALRM)),
    ],
)
def test_a_watchdog_that_dies_stops_or_is_ended_leaves_no_laser_on(board, number, message):
    with board("lcus") as (relays, uri), lasers_at(uri) as lasers:
        lasers.set_mask(0b111)
        wait_for(lambda: on_mask(relays) == 0b111)
        os.kill(lasers.watchdog_pid, number)
        wait_until_off(relays)
        with pytest.raises(DeviceError, match=message):
            lasers.set_mask(0b001)
        assert on_mask(relays) == 0


def test_an_interrupt_meant_for_the_capture_leaves_the_watchdog_alone(board):
    with board("lcus") as (relays, uri), lasers_at(uri) as lasers:
        os.kill(lasers.watchdog_pid, signal.SIGINT)
        lasers.set_mask(0b100)
        wait_for(lambda: on_mask(relays) == 0b100)


def test_an_unplugged_board_is_a_safety_fault_that_ends_a_wait(board):
    with board("lcus") as (relays, uri):
        lasers = lasers_at(uri)
        lasers.open()
        lasers.set_mask(0b001)
        relays.unplug()
        with pytest.raises(LaserSafetyError, match="watchdog and port are lost, the lasers may be on"):
            lasers.wait(600.0)
        lasers.close()


def test_lasers_go_off_without_heartbeat_and_can_be_switched_on_again(board):
    with board("lcus", limits="&heartbeat=0.5&longest_on=600") as (relays, uri), lasers_at(uri) as lasers:
        began_s = time.monotonic()
        lasers.set_mask(0b001)
        wait_for(lambda: have_been_on(relays, began_s) == [0])
        wait_until_off(relays)
        with pytest.raises(LasersWentOff, match=r"no command came for 0\.5 s; raise heartbeat="):
            lasers.set_mask(0b010)
        assert on_mask(relays) == 0
        lasers.set_mask(0)
        began_s = time.monotonic()
        lasers.set_mask(0b010)
        wait_for(lambda: have_been_on(relays, began_s) == [1])

    assert on_mask(relays) == 0


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
def test_lasers_go_off_and_stay_off_while_the_interlock_is_open(board, monkeypatch, tmp_path, name):
    door = tmp_path / "closed"
    monkeypatch.setattr("ringpose.capture.lasers.watchdog._START", WATCHDOG_AT_A_DOOR.format(name=name, door=door))
    door.touch()

    with board("lcus") as (relays, uri), lasers_at(f"{uri}&interlock={name}") as lasers:
        lasers.set_mask(0b101)
        assert lasers.read_mask() == 0b101
        door.unlink()
        wait_until_off(relays)
        with pytest.raises(LasersWentOff, match="the interlock is open"):
            lasers.set_mask(0b010)
        lasers.set_mask(0)
        with pytest.raises(DeviceError, match="stay off: the interlock is open"):
            lasers.set_mask(0b010)


def test_a_timed_pulse_ends_though_no_process_is_left_to_end_it(board):
    with board("modbus", limits="&pulse=0.5") as (relays, uri):
        settings, began_s = lasers_at(uri).settings, time.monotonic()
        port = SerialPort(settings.port, settings.baud)
        port.open()
        RelayBoard(settings, port).set_mask(0b111)
        port.close()
        assert have_been_on(relays, began_s) == [0, 1, 2]
        wait_until_off(relays)


def test_a_child_that_outlives_the_capture_does_not_keep_the_lasers_on(board):
    program = (
        "import os, sys, time; from ringpose.capture.lasers.watchdog import WatchdogLasers; "
        "from ringpose.capture.lasers.relay_board import settings_of_line; "
        "lasers = WatchdogLasers(settings_of_line(sys.argv[1])); lasers.open(); lasers.set_mask(7); "
        "os.fork() and print('lit', flush=True); time.sleep(600)"
    )

    with board("lcus") as (relays, uri):
        words = [sys.executable, "-c", program, lasers_at(uri).settings.line()]
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, start_new_session=True) as process:
            process.stdout.readline()
            wait_for(lambda: on_mask(relays) == 0b111)
            process.kill()
            wait_until_off(relays)
            os.killpg(process.pid, signal.SIGKILL)


def test_a_board_that_reports_its_coils_does_not_report_a_stuck_contact(board):
    with board("lcus", RelayFaults(stuck=frozenset({1}))) as (relays, uri):
        lasers = lasers_at(uri)
        with lasers:
            lasers.set_mask(0b010)
            lasers.set_mask(0)
            reported = lasers.read_mask()

    assert reported == 0
    assert on_mask(relays) == 0b010
