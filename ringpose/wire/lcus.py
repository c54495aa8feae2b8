"""LCUS-1/2/4/8 boards (CH340, 9600 baud): `A0 number state sum`, no answer; `FF` asks for the states as text."""

import re
from dataclasses import dataclass

from ringpose.wire.relay_codec import Command, Pulse, Read, Switch, WireError, row_of

START = 0xA0

ASK = 0xFF

_LINE = re.compile(rb"CH(\d+) ?: ?(ON|OFF) ?\r\n")


@dataclass(frozen=True, slots=True)
class LcusCodec:
    """A board of as many relays as the driver uses, or more."""

    first: int = 1
    reports: bool = True
    switches_rows: bool = True

    def request(self, command: Command) -> bytes:
        """Four bytes for each relay, all in one go."""
        if isinstance(command, Read):
            return bytes([ASK])
        if isinstance(command, Pulse):
            raise WireError("an LCUS board has no timed pulse")
        on, off = row_of(command)
        numbers = [relay for relay in range((on | off).bit_length()) if (on | off) >> relay & 1]
        return b"".join(_frame(relay + self.first, on >> relay & 1) for relay in numbers)

    def is_whole(self, command: Command, received: bytes) -> bool:
        """Lines for all relays that were asked about; some boards answer one raw byte a relay instead."""
        if not isinstance(command, Read):
            return True
        return self._raw(command, received) or set(range(command.count)) <= set(self._states(received))

    def lit(self, command: Command, received: bytes) -> int:
        """The relays that are on."""
        if not isinstance(command, Read):
            return 0
        if self._raw(command, received):
            return sum(1 << relay for relay in range(command.count) if received[relay])
        states = self._states(received)
        if not set(range(command.count)) <= set(states):
            raise WireError(f"answered {received!r} to the question what is on")
        return sum(1 << relay for relay in range(command.count) if states[relay])

    def commands(self, received: bytes) -> tuple[list[Command], bytes]:
        """Frames with a right sum, and questions; anything else is skipped, byte by byte."""
        found: list[Command] = []
        place = 0
        while place < len(received):
            frame = received[place : place + 4]
            if frame[0] == START and len(frame) < 4:
                break
            if frame[0] == START and frame == _frame(frame[1], frame[2]) and frame[1] >= self.first:
                found.append(Switch(frame[1] - self.first, bool(frame[2])))
                place += 4
                continue
            if frame[0] == ASK:
                found.append(Read(0))
            place += 1
        return found, received[place:]

    def answer(self, command: Command, lit: int, relays: int) -> bytes:
        """Lines as the CH340 boards write them; nothing after a switch."""
        if not isinstance(command, Read):
            return b""
        return b"".join(
            b"CH%d: %s\r\n" % (relay + self.first, b"ON " if lit >> relay & 1 else b"OFF") for relay in range(relays)
        )

    def _states(self, received: bytes) -> dict[int, bool]:
        return {int(number) - self.first: state == b"ON" for number, state in _LINE.findall(received)}

    def _raw(self, command: Read, received: bytes) -> bool:
        return len(received) >= command.count and all(byte in (0, 1) for byte in received)


def _frame(number: int, state: int) -> bytes:
    return bytes([START, number, state, (START + number + state) & 0xFF])
