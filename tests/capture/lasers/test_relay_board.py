"""The relay board driver with a port that records every byte and sends given answers."""

import pytest

from ringpose.capture.lasers.relay_board import RelayBoard, RelaySettings
from ringpose.capture.lasers.serial_port import SerialPort
from ringpose.errors import DeviceError

ALL_OFF = bytes.fromhex("A00100A1 A00200A2 A00300A3")

ASK = b"\xff"

DARK = b"CH1: OFF\r\nCH2: OFF\r\nCH3: OFF\r\n"


class NotedPort(SerialPort):
    """Returns `answers` in turn, the last one repeatedly; an exception is raised."""

    def __init__(self, *answers):
        super().__init__("port", 9600)
        self.sent, self.answers = [], list(answers)

    def exchange(self, request, is_whole, limit_s, quiet_s=0.0):
        self.sent.append(request)
        if request != ASK:
            return b""
        answer = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
        if isinstance(answer, Exception):
            raise answer
        return answer


def board_at(port, read_back="try", relays=(0, 1, 2)):
    return RelayBoard(RelaySettings(scheme="lcus", port="port", relays=relays, read_back=read_back), port)


def test_off_commands_are_sent_before_on_commands():
    port = NotedPort(DARK)
    board = board_at(port)
    board.set_mask(0b101)
    port.sent.clear()

    board.set_mask(0b110)

    assert [request.hex() for request in port.sent] == ["a00100a1", "a00201a3"]


def test_adjacent_relays_are_switched_off_by_one_command():
    together, apart = NotedPort(DARK), NotedPort(DARK)

    board_at(together).all_off()
    board_at(apart, relays=(0, 2)).all_off()

    assert together.sent == [ALL_OFF, ASK]
    assert [request.hex() for request in apart.sent] == ["a00100a1", "a00300a3", "ff"]


def test_a_stale_answer_is_read_again():
    board = board_at(NotedPort(DARK.replace(b"CH2: OFF", b"CH2: ON "), DARK))

    assert board.read_mask() == 0


def test_a_silent_board_receives_off_twice_and_is_not_read_again():
    port = NotedPort(b"")
    board = board_at(port)

    board.all_off()

    assert port.sent == [ALL_OFF, ASK, ALL_OFF]
    assert board.read_mask() is None


@pytest.mark.parametrize("answer", [b"", DARK.replace(b"CH3: OFF", b"CH3: ON "), DeviceError("port", "gone")])
def test_lasers_not_reported_off_are_an_error_after_three_attempts(answer):
    port = NotedPort(answer)

    with pytest.raises(DeviceError):
        board_at(port, read_back="yes").all_off()

    assert port.sent.count(ALL_OFF) == 3


def test_a_board_that_answers_at_the_third_attempt_is_off():
    port = NotedPort(DeviceError("port", "busy"), DeviceError("port", "busy"), DARK)

    board_at(port, read_back="yes").all_off()

    assert port.sent.count(ALL_OFF) == 3


def test_one_relay_that_fails_does_not_keep_the_others_on():
    class Failing(NotedPort):
        def exchange(self, request, is_whole, limit_s, quiet_s=0.0):
            super().exchange(request, is_whole, limit_s)
            if request.hex() == "a00100a1":
                raise DeviceError("port", "does not answer")
            return b""

    port = Failing(b"")
    board = board_at(port, "no", relays=(0, 2))
    board.set_mask(0b11)
    port.sent.clear()

    with pytest.raises(DeviceError):
        board.set_mask(0)

    assert [request.hex() for request in port.sent] == ["a00100a1", "a00300a3"] * 3


@pytest.mark.parametrize("lost", [1, 2])
def test_a_lost_byte_does_not_end_the_capture(lost):
    class Noisy(NotedPort):
        """Does not answer a number of commands in a row, then answers as a Modbus board."""

        def exchange(self, request, is_whole, limit_s, quiet_s=0.0):
            self.sent.append(request)
            if len(self.sent) % (lost + 1):
                raise DeviceError("port", "does not answer")
            return request

    port = Noisy()
    board = RelayBoard(RelaySettings(scheme="modbus", port="port", relays=(0, 1), read_back="no"), port)

    board.set_mask(0b01)
    board.set_mask(0b10)

    assert [request.hex() for request in port.sent[lost :: lost + 1]] == [
        "01050000ff008c3a", "010500000000cdca", "01050001ff00ddfa",
    ]  # fmt: skip
