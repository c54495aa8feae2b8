"""Codecs of relay boards against frames published by manufacturers and other projects."""

import pytest

from ringpose.wire.ascii_relays import AsciiCodec
from ringpose.wire.lcus import LcusCodec
from ringpose.wire.modbus import ModbusCodec, crc
from ringpose.wire.numato import NumatoCodec
from ringpose.wire.relay_codec import Pulse, Read, Switch, SwitchRow, WireError

ARDUINO = AsciiCodec(on="R{n} ON", off="R{n} OFF", read="R?", acknowledged_by="OK")

LCUS, NUMATO, MODBUS = LcusCodec(), NumatoCodec(), ModbusCodec()

PUBLISHED = [
    (LCUS, Switch(0, True), bytes.fromhex("A0 01 01 A2")),
    (LCUS, Switch(1, True), bytes.fromhex("A0 02 01 A3")),
    (LCUS, Switch(2, True), bytes.fromhex("A0 03 01 A4")),
    (LCUS, Switch(0, False), bytes.fromhex("A0 01 00 A1")),
    (LCUS, Switch(1, False), bytes.fromhex("A0 02 00 A2")),
    (LCUS, Switch(2, False), bytes.fromhex("A0 03 00 A3")),
    (LCUS, SwitchRow(0, 3, 0), bytes.fromhex("A0 01 00 A1 A0 02 00 A2 A0 03 00 A3")),
    (LCUS, Read(3), bytes.fromhex("FF")),
    (MODBUS, Switch(0, True), bytes.fromhex("01 05 00 00 FF 00 8C 3A")),
    (MODBUS, Switch(1, True), bytes.fromhex("01 05 00 01 FF 00 DD FA")),
    (MODBUS, Switch(2, True), bytes.fromhex("01 05 00 02 FF 00 2D FA")),
    (MODBUS, Switch(0, False), bytes.fromhex("01 05 00 00 00 00 CD CA")),
    (MODBUS, Switch(1, False), bytes.fromhex("01 05 00 01 00 00 9C 0A")),
    (MODBUS, Switch(2, False), bytes.fromhex("01 05 00 02 00 00 6C 0A")),
    (MODBUS, SwitchRow(0, 8, 0), bytes.fromhex("01 0F 00 00 00 08 01 00 FE 95")),
    (MODBUS, SwitchRow(0, 3, 0b010), bytes.fromhex("01 0F 00 00 00 03 01 02 0E 96")),
    (MODBUS, Read(8), bytes.fromhex("01 01 00 00 00 08 3D CC")),
    (MODBUS, Pulse(0, 0.7), bytes.fromhex("01 05 02 00 00 07 8D B0")),
    (ModbusCodec(first=1, on_value=0x0100), Switch(0, True), bytes.fromhex("01 05 00 01 01 00 9D 9A")),
    (NUMATO, Switch(0, True), b"relay on 0\r"),
    (NUMATO, Switch(2, False), b"relay off 2\r"),
    (NUMATO, Switch(10, True), b"relay on A\r"),
    (NUMATO, Read(3), b"relay readall\r"),
    (ARDUINO, Switch(0, True), b"R1 ON\n"),
    (ARDUINO, Switch(2, False), b"R3 OFF\n"),
    (ARDUINO, Read(3), b"R?\n"),
]


def framed(body):
    """The bytes of a Modbus frame, in hexadecimal, with their checksum."""
    return bytes.fromhex(body) + crc(bytes.fromhex(body))


def is_answer(codec, command, received):
    """Whether bytes are accepted as the answer to a command."""
    try:
        codec.on_mask(command, received)
    except WireError:
        return False
    return codec.is_whole(command, received)


SWITCHES = [Switch(0, True), Switch(2, True), Switch(1, False)]


@pytest.mark.parametrize(("codec", "command", "published"), PUBLISHED)
def test_requests_equal_published_ones(codec, command, published):
    assert codec.request(command) == published


@pytest.mark.parametrize(
    ("codec", "command", "answer", "on_mask"),
    [
        (LCUS, Read(2), b"CH1: ON \r\nCH2: OFF\r\n", 0b01),
        (LCUS, Read(2), b"CH1:OFF \r\nCH2:ON \r\n", 0b10),
        (LCUS, Read(4), bytes.fromhex("01000100"), 0b101),
        (MODBUS, Read(8), bytes.fromhex("01 01 01 05 91 8B"), 0b101),
        (MODBUS, Switch(0, True), bytes.fromhex("01 05 00 00 FF 00 8C 3A"), 0),
        (NUMATO, Read(3), b"relay readall\n\r05\n\r>", 0b101),
        (NUMATO, Read(3), b"relay readall\r\n0005\r\n>", 0b101),
        (NUMATO, Switch(0, True), b"relay on 0\n\r>", 0),
        (ARDUINO, Read(3), b"6\r\n", 0b110),
        (ARDUINO, Read(3), b"hello\n0x3\n", 0b011),
        (AsciiCodec(on="a", off="b", read="?"), Read(1), b"ON\n", 1),
        (ARDUINO, Switch(0, True), b"OK\r\n", 0),
    ],
)
def test_answers_are_decoded(codec, command, answer, on_mask):
    assert codec.is_whole(command, answer)
    assert codec.on_mask(command, answer) == on_mask


@pytest.mark.parametrize(
    ("codec", "command", "answer", "complaint"),
    [
        (MODBUS, Read(8), bytes.fromhex("01 01 01 05 91 8C"), "not a valid frame"),
        (MODBUS, Switch(0, True), bytes.fromhex("01 05 00 01 FF 00 DD FA"), "answered"),
        (MODBUS, Pulse(0, 0.7), bytes.fromhex("01 85 03 02 91"), "illegal value"),
        (MODBUS, Read(3), bytes.fromhex("01 01 00 00 00 03 7c 0b"), "answered"),  # the request itself
        (MODBUS, SwitchRow(0, 3, 0), bytes.fromhex("01 0F 00 00 00 03 01 00 8E F1"), "answered"),
        (MODBUS, Read(3), framed("01 01 02 00 00"), "answered"),  # one byte too many
        (MODBUS, Read(9), framed("01 01 01 00"), "answered"),
        (MODBUS, Read(3), framed("02 01 01 00"), "answered"),  # another unit
        (MODBUS, Read(3), framed("01 85 02"), "answered"),  # the exception of another function
        (MODBUS, SwitchRow(0, 3, 0), framed("01 0F 00 00 00 02"), "answered"),  # another quantity
        (MODBUS, SwitchRow(0, 3, 0), framed("01 0F 00 01 00 03"), "answered"),  # another address
        (MODBUS, Switch(0, False), framed("01 05 00 00 FF 00"), "answered"),  # another value
        (NUMATO, Read(9), b"relay readall\n\r05\n\r>", "relays 0 to 7, and ch= names 8"),
        (LCUS, Read(9), LCUS.answer(Read(9), 0, 8), "relays 1 to 8, and ch= names 9"),
        (LCUS, Read(3), b"\x00\x01", "relays 1 to 2, and ch= names 3"),
        (NUMATO, Read(3), b"relay readall\n\r00\n\r>relay off 0\n\r>", "answered"),
        (NUMATO, Read(3), b"relay off 0\n\r>", "answered"),
        (NUMATO, Switch(0, False), b"relay off 0\n\r00\n\r>", "answered"),
        (LCUS, Read(2), b"CH1: OFF\r\nCH2: OFF\r\nA0", "answered"),
        (LCUS, Read(2), b"\xffCH1: OFF\r\nCH2: OFF\r\n", "answered"),
        (LCUS, Read(2), bytes(33), "answered"),
        (LCUS, Switch(0, False), bytes.fromhex("A00100A1"), "without an answer"),
        (ARDUINO, Read(3), b"-8\n", 'answered "-8"'),
        (ARDUINO, Read(3), b"0\n7", 'answered ""'),
        (ARDUINO, Read(3), b"R?\n", 'answered ""'),
        (AsciiCodec(on="R{n}", off="r{n}", read="0"), Read(3), b"0\n", 'answered ""'),  # what was sent
        (AsciiCodec(on="R{n}", off="r{n}", acknowledged_by="r1"), Switch(0, False), b"r1\n", "answered"),
        (NUMATO, Switch(0, True), b"relay on 1\n\r>", "answered"),
        (NUMATO, Read(3), b"relay readall\n\r>", "answered"),
        (LCUS, Read(3), b"CH1: ON \r\nCH3", "answered"),
        (ARDUINO, Switch(0, True), b"ERR\n", 'answered "ERR", not "OK"'),
        (ARDUINO, Read(3), b"what\n", 'answered "what"'),
    ],
)
def test_wrong_answers_are_rejected(codec, command, answer, complaint):
    with pytest.raises(WireError, match=complaint):
        codec.on_mask(command, answer)


ANSWERED = [
    *((codec, command) for codec in (NUMATO, ARDUINO) for command in (Read(3), Switch(2, True), Switch(1, False))),
    *((MODBUS, command) for command in (Read(3), SwitchRow(0, 3, 0), Pulse(0, 0.7), Switch(1, False))),
    (LCUS, Read(3)),
]
"""Commands that have an answer."""


@pytest.mark.parametrize(("codec", "command"), ANSWERED)
def test_every_byte_of_an_answer_counts(codec, command):
    answer = codec.answer(command, 0b101, 3)
    others = [answer[:i] + bytes([answer[i] ^ 0x40]) + answer[i + 1 :] for i in range(len(answer))]

    accepted = [each for each in (answer[:-1], answer + b"\x02", *others) if is_answer(codec, command, each)]

    assert is_answer(codec, command, answer)
    assert accepted == []


@pytest.mark.parametrize(("codec", "command"), ANSWERED)
def test_a_request_is_no_answer_unless_the_protocol_repeats_it(codec, command):
    repeats = codec is MODBUS and isinstance(command, Switch | Pulse)

    assert is_answer(codec, command, codec.request(command)) is repeats


@pytest.mark.parametrize("codec", [LCUS, NUMATO, MODBUS])
def test_a_partial_answer_is_incomplete(codec):
    answer = codec.answer(Read(4), 0b1010, 4)

    assert codec.is_whole(Read(4), answer)
    assert not codec.is_whole(Read(4), answer[:-1])


@pytest.mark.parametrize("codec", [LCUS, NUMATO, MODBUS, ARDUINO])
def test_commands_in_pieces_of_any_size_are_decoded(codec):
    sent = b"".join(codec.request(command) for command in SWITCHES)

    received, rest = [], b""
    for byte in sent:
        found, rest = codec.commands(rest + bytes([byte]))
        received += found

    assert received == SWITCHES
    assert rest == b""


@pytest.mark.parametrize("codec", [LCUS, MODBUS])
@pytest.mark.parametrize("noise", [bytes.fromhex(each) for each in ("00", "a00101", "010500", "fe01")])
def test_a_command_after_noise_is_decoded(codec, noise):
    found, _ = codec.commands(noise + codec.request(Switch(1, True)) + codec.request(Switch(0, False)))

    assert [command for command in found if command in (Switch(1, True), Switch(0, False))][-1] == Switch(0, False)


@pytest.mark.parametrize("codec", [LCUS, NUMATO, ARDUINO])
def test_only_a_modbus_board_has_a_timed_pulse(codec):
    with pytest.raises(WireError):
        codec.request(Pulse(0, 1.0))


def test_the_modbus_codec_decodes_rows_and_pulses():
    sent = [SwitchRow(0, 3, 0b010), Pulse(2, 0.7), Read(8)]

    found, rest = MODBUS.commands(b"".join(MODBUS.request(command) for command in sent))

    assert found[0] == SwitchRow(0, 3, 0b010)
    assert isinstance(found[1], Pulse)
    assert (found[1].relay, found[1].duration_s) == (2, pytest.approx(0.7))
    assert found[2] == Read(8)
    assert rest == b""
