"""Codecs of relay boards against frames published by manufacturers and other projects."""

import pytest

from ringpose.wire.ascii_relays import AsciiCodec
from ringpose.wire.lcus import LcusCodec
from ringpose.wire.modbus import ModbusCodec
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
        (NUMATO, Switch(0, True), b"relay on 1\n\r>", "answered"),
        (NUMATO, Read(3), b"relay readall\n\r>", "answered"),
        (LCUS, Read(3), b"CH1: ON \r\n", "answered"),
        (ARDUINO, Switch(0, True), b"ERR\n", 'answered "ERR", not "OK"'),
        (ARDUINO, Read(3), b"what\n", 'answered "what"'),
    ],
)
def test_wrong_answers_are_rejected(codec, command, answer, complaint):
    with pytest.raises(WireError, match=complaint):
        codec.on_mask(command, answer)


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
