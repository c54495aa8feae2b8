"""An adapter that echoes what is sent is no board that obeys; a board behind it is used as any other."""

import os
import subprocess
import sys

import pytest
from echoing_adapter import echoing_adapter
from guarded_lasers import BOARDS, PATIENT, LinkedRelays, lasers_at, on_mask, wait_until_off

from ringpose.capture.lasers.relay_board import RelayBoard
from ringpose.capture.lasers.serial_port import SerialPort
from ringpose.errors import DeviceError

NO_BOARD = r"the adapter echoes what is sent \(.*\), and no board answers"


def uri_at(scheme, link, words="", channels=None):
    """The URI of a board at a link, by default with three adjacent relays."""
    codec, text = BOARDS[scheme]
    numbers = channels or ",".join(str(codec.first + laser) for laser in range(3))
    return text.format(port=link, channels=numbers) + PATIENT + words


class EchoingPort(SerialPort):
    """Returns what is sent, at once and whole, and nothing else."""

    def exchange(self, request, is_complete, limit_s, quiet_s=0.0):
        return request


@pytest.mark.parametrize("words", ["", "&read_back=no", "&read_back=try"])
@pytest.mark.parametrize("channels", [None, "1", "1,3"])
@pytest.mark.parametrize("scheme", BOARDS)
def test_an_echo_alone_is_no_board(scheme, channels, words):
    settings = lasers_at(uri_at(scheme, "port", words, channels)).settings

    with pytest.raises(DeviceError, match=NO_BOARD):
        RelayBoard(settings, EchoingPort("port", 9600)).all_off()


@pytest.mark.parametrize("read", ["", "0", "0x7"])
def test_an_echo_of_lines_alone_is_no_board_that_acknowledges_or_reports_them(read):
    settings = lasers_at(f"ascii:port?ch=1,2&on=R{{n}}&off=r{{n}}&ok=r1&read={read}").settings

    with pytest.raises(DeviceError, match=NO_BOARD):
        RelayBoard(settings, EchoingPort("port", 9600)).all_off()


@pytest.mark.parametrize("scheme", ["numato", "modbus", "ascii"])
def test_the_watchdog_does_not_start_at_an_echo_alone(tmp_path, scheme):
    lasers = lasers_at(uri_at(scheme, tmp_path / "port"))

    with echoing_adapter(tmp_path / "port"):
        with pytest.raises(DeviceError, match=f"{NO_BOARD}|does not answer"):  # the echo may come too late
            lasers.open()
        lasers.close()


@pytest.mark.parametrize(
    ("scheme", "channels", "words"),
    [
        *((scheme, None, "") for scheme in BOARDS),
        ("modbus", "1", ""),
        ("modbus", "0,2", "&read_back=no"),
        ("modbus", "0,2", "&pulse=600"),
    ],
)
def test_a_board_behind_an_echo_switches_and_reports_the_commanded_masks(tmp_path, scheme, channels, words):
    (tmp_path / "board").mkdir()
    relays = (1,) if channels == "1" else (0, 2) if channels else (0, 1, 2)
    every = (1 << len(relays)) - 1
    with LinkedRelays(tmp_path / "board", BOARDS[scheme][0], relays=relays) as board:
        link = tmp_path / "port"
        with echoing_adapter(link, board.port), lasers_at(uri_at(scheme, link, words, channels)) as lasers:
            seen = []
            for mask in (1, every, 0):
                lasers.set_mask(mask)
                seen.append((lasers.read_mask(), on_mask(board)))

    reported = words != "&read_back=no"
    assert seen == [(mask if reported else None, mask) for mask in (1, every, 0)]


def test_a_watchdog_killed_at_an_echoing_adapter_leaves_no_laser_on(tmp_path):
    (tmp_path / "board").mkdir()
    with LinkedRelays(tmp_path / "board", BOARDS["modbus"][0]) as board:
        link = tmp_path / "port"
        with echoing_adapter(link, board.port), lasers_at(uri_at("modbus", link)) as lasers:
            lasers.set_mask(0b111)
            os.kill(lasers.watchdog_pid, 9)
            wait_until_off(board)
            with pytest.raises(DeviceError, match="they were switched off without it"):
                lasers.set_mask(1)


@pytest.mark.parametrize("mode", ["echo", "both", "board"])
def test_the_fake_board_of_the_shared_cases_is_used_only_if_it_is_there(shared_data, tmp_path, mode):
    words = [sys.executable, str(shared_data / "cases" / "fake_modbus.py"), mode, "600"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        lasers = lasers_at(f"modbus:{process.stdout.readline().strip()}?ch=0,1,2{PATIENT}")
        try:
            if mode == "echo":
                with pytest.raises(DeviceError, match=f"{NO_BOARD}|does not answer"):
                    lasers.open()
                lasers.close()
            else:
                with lasers:
                    lasers.set_mask(0b101)
                    assert lasers.read_mask() == 0b101
        finally:
            process.kill()
