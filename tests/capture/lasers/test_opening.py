"""Opening of relay lasers, and its errors."""

import os
import resource
import time
import tty

import pytest
from guarded_lasers import lasers_at, on_mask

from ringpose.errors import DeviceError

ALL_SCHEMES = ["lcus", "numato", "modbus", "ascii"]


@pytest.mark.parametrize("scheme", ALL_SCHEMES)
def test_opening_switches_all_lasers_off(board, scheme):
    with board(scheme) as (relays, uri):
        relays.contacts.command(1, True, time.monotonic())
        relays._coils_until_s[1] = float("inf")
        with lasers_at(uri):
            opened = on_mask(relays)

    assert opened == 0


def test_a_crash_writes_no_core_before_the_lasers_go_off(board):
    before = resource.getrlimit(resource.RLIMIT_CORE)
    with board("lcus") as (_, uri), lasers_at(uri):
        soft, hard = resource.getrlimit(resource.RLIMIT_CORE)
    resource.setrlimit(resource.RLIMIT_CORE, before)

    assert soft <= 1
    assert hard == before[1]


def test_a_watchdog_that_dies_while_it_opens_is_replaced(board, monkeypatch):
    with board("lcus") as (relays, uri):
        relays.contacts.command(1, True, time.monotonic())
        monkeypatch.setattr("ringpose.capture.lasers.watchdog._START", "import os; os._exit(1)  # {separator}")
        lasers = lasers_at(uri)
        with pytest.raises(DeviceError, match="the watchdog of the lasers ended; they were switched off without it"):
            lasers.open()
        lasers.close()

    assert on_mask(relays) == 0


def test_a_board_that_restarts_for_long_is_waited_for(board, monkeypatch):
    opens_at_once = "print('0 ok echoes', flush=True); import sys; sys.stdin.read()  # {separator}"
    monkeypatch.setattr("ringpose.capture.lasers.watchdog._START", opens_at_once)
    with board("lcus") as (_, uri):
        lasers = lasers_at(f"{uri}&opening=13")
        lasers.open()
        lasers.close()


@pytest.mark.parametrize("scheme", [pytest.param("numato", marks=pytest.mark.slow), "modbus"])
def test_a_board_of_eight_relays_that_is_silent_is_no_safety_fault(scheme):
    master, slave = os.openpty()
    tty.setraw(slave)
    lasers = lasers_at(f"{scheme}:{os.ttyname(slave)}?ch=0,1,2,3,4,5,6,7")

    with pytest.raises(DeviceError, match="does not answer; check the board"):
        lasers.open()

    lasers.close()
    os.close(master)
    os.close(slave)


def test_a_file_that_is_not_a_port_is_rejected(tmp_path):
    (tmp_path / "file").write_text("")

    with pytest.raises(DeviceError, match="it is not a serial port"), lasers_at(f"lcus:{tmp_path}/file?ch=1"):
        pass


def test_a_port_is_opened_exclusively(board):
    with (
        board("lcus") as (_, uri),
        lasers_at(uri),
        pytest.raises(DeviceError, match="another program uses it"),
        lasers_at(uri),
    ):
        pass


def test_a_board_with_another_protocol_is_an_error(board):
    with board("lcus") as (relays, _):
        lasers = lasers_at(f"modbus:{relays.port}?ch=0,1,2")
        with pytest.raises(DeviceError, match="does not answer"):
            lasers.open()
        lasers.close()

    assert on_mask(relays) == 0
