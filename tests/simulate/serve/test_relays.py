"""The virtual relay board, with bytes written to its pseudo-terminal."""

import os
import select
import threading
import time
from contextlib import suppress

import pytest
from guarded_lasers import on_mask, wait_for

from ringpose.simulate.serve.relays import RelayContacts, RelayFaults, ServedRelays
from ringpose.wire.ascii_relays import AsciiCodec
from ringpose.wire.lcus import LcusCodec
from ringpose.wire.modbus import ModbusCodec, crc
from ringpose.wire.numato import NumatoCodec


def test_a_command_switches_on_the_laser_of_its_relay():
    with ServedRelays(LcusCodec(), relays=(2, 0)) as board:
        port = os.open(board.port, os.O_RDWR | os.O_NOCTTY)
        os.write(port, bytes.fromhex("A0 03 01 A4"))
        wait_for(lambda: on_mask(board) == 0b01)
        os.close(port)

    assert board.channels == "3,1"


def test_the_board_reports_its_coils():
    with ServedRelays(LcusCodec()) as board:
        port = os.open(board.port, os.O_RDWR | os.O_NOCTTY)
        os.write(port, bytes.fromhex("A0 02 01 A3 FF"))
        answer = b""
        while answer.count(b"\n") < 8:
            answer += os.read(port, 100)
        os.close(port)

    assert answer.startswith(b"CH1: OFF\r\nCH2: ON \r\nCH3: OFF\r\n")


def test_a_timed_pulse_ends_by_itself():
    with ServedRelays(ModbusCodec()) as board:
        port = os.open(board.port, os.O_RDWR | os.O_NOCTTY)
        before_s = time.monotonic()
        os.write(port, bytes.fromhex("01 05 02 00 00 07 8D B0"))
        os.read(port, 100)  # the answer comes when the relay is switched
        os.close(port)

    assert 1000.0 * board.contacts.shares(before_s, before_s + 1000.0)[0] == pytest.approx(0.7)


def test_an_unplugged_board_hangs_up():
    with ServedRelays(LcusCodec()) as board:
        port = os.open(board.port, os.O_RDWR | os.O_NOCTTY)

        board.unplug()

        with pytest.raises(OSError, match="Input/output"):
            os.write(port, b"x")
        os.close(port)


CODECS = {
    "lcus": (LcusCodec(), b"\xff"),
    "numato": (NumatoCodec(), b"\rrelay readall\r"),
    "modbus": (ModbusCodec(), bytes.fromhex("0101000000083DCC")),
    "ascii": (AsciiCodec(on="R{n} ON", off="R{n} OFF", read="R?"), b"\nR?\n"),
}


def impossible(name: str) -> list[bytes]:
    """Well-formed commands to relays that the board does not have, and endless noise."""
    frames = [bytes.fromhex(text) for text in ("0101 0000 ffff", "010f 0000 0001 01ff", "010f 0005 0007 017f")]
    return {
        "lcus": [bytes.fromhex("A0 FF 01 A0")],
        "numato": [b"relay on V\r"],
        "modbus": [frame + crc(frame) for frame in frames],
        "ascii": [b"R0 ON\n", b"R99999999999999999999 ON\n"],
    }[name] + [5000 * b"x"]


def answered(port: int, question: bytes) -> bool:
    """Whether the board answers a question, after earlier answers have been read."""
    while select.select([port], [], [], 0.2)[0]:
        os.read(port, 4096)
    for within_s in (0.5, 0.5, 120.0):  # the first one may end what came before
        os.write(port, question)
        if select.select([port], [], [], within_s)[0]:
            return True
    return False


@pytest.mark.parametrize("name", CODECS)
def test_no_bytes_whatsoever_stop_the_board(name, rng):
    codec, question = CODECS[name]

    with ServedRelays(codec) as board:
        port = os.open(board.port, os.O_RDWR | os.O_NOCTTY)
        for noise in [*impossible(name), *(rng.bytes(int(size)) for size in rng.integers(1, 60, 50))]:
            os.write(port, noise)
        is_there = answered(port, question)
        os.close(port)

    assert is_there


@pytest.mark.parametrize("name", CODECS)
def test_a_board_stops_although_its_answers_are_not_read(name):
    codec, question = CODECS[name]

    with ServedRelays(codec) as board:
        port = os.open(board.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        for _ in range(2000):
            with suppress(BlockingIOError):
                os.write(port, question)
        ending = threading.Thread(target=board.unplug, daemon=True)
        ending.start()
        ending.join(120.0)
        has_ended = not ending.is_alive()
        os.close(port)

    assert has_ended


@pytest.mark.parametrize(
    ("faults", "masks"),
    [
        (RelayFaults(), [0, 1, 1, 0, 0]),
        (RelayFaults(operate_s=0.25), [0, 0, 1, 0, 0]),
        (RelayFaults(release_s=0.25), [0, 1, 1, 1, 0]),
        (RelayFaults(late_s={0: 0.25}), [0, 0, 1, 1, 0]),
        (RelayFaults(stuck=frozenset({0})), [0, 1, 1, 1, 1]),
        (RelayFaults(welded=frozenset({0})), [1, 1, 1, 1, 1]),
        (RelayFaults(dead=frozenset({0})), [0, 0, 0, 0, 0]),
    ],
)
def test_contacts_follow_their_coils_with_the_injected_faults(faults, masks):
    contacts = RelayContacts(1, faults)

    contacts.command(0, True, 1.0)
    contacts.command(0, False, 2.0)

    assert [contacts.mask_at(time_s) for time_s in (0.9, 1.1, 1.3, 2.1, 2.3)] == masks


def test_the_share_of_an_interval_in_which_a_laser_is_on():
    contacts = RelayContacts(2)

    contacts.command(1, True, 10.0)
    contacts.command(1, False, 10.5)

    assert contacts.shares(9.5, 11.5) == pytest.approx((0.0, 0.25))
    assert contacts.on_since_s(10.2) == (None, 10.0)
    assert contacts.on_since_s(10.7) == (None, None)
