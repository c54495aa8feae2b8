"""LCUS-1/2/4/8 boards (CH340, 9600 baud): `A0 number state sum` without an answer; `FF` reads the states as text."""

import re
from dataclasses import dataclass

from ringpose.wire.relay_codec import Command, Pulse, Read, Switch, TooFewRelays, WireError, row_of

START = 0xA0

READ = 0xFF

_LINE = re.compile(rb"CH(\d+) ?: ?(ON|OFF) ?\r\n")

_WHOLE_LINES = re.compile(rb"(?:CH\d+ ?: ?(?:ON|OFF) ?\r\n)+")

_LINES = re.compile(_WHOLE_LINES.pattern + rb"(?:C(?:H\d* ?:? ?[OFN]* ?\r?)?)?")
"""Whole lines; the line of a relay that is not used may have come in part."""

_MAX_RAW = 32
"""No board has more relays."""


@dataclass(frozen=True, slots=True)
class LcusCodec:
    """A board with at least as many relays as the driver uses."""

    first: int = 1
    reports: bool = True
    switches_rows: bool = True

    def request(self, command: Command) -> bytes:
        """The bytes of a command: four for each relay, to be sent in one write."""
        if isinstance(command, Read):
            return bytes([READ])
        if isinstance(command, Pulse):
            raise WireError("an LCUS board has no timed pulse")
        on, off = row_of(command)
        numbers = [relay for relay in range((on | off).bit_length()) if (on | off) >> relay & 1]
        return b"".join(_frame(relay + self.first, on >> relay & 1) for relay in numbers)

    def is_whole(self, command: Command, received: bytes) -> bool:
        """Whether the answer has a line for each relay that is read, or, as of some boards, one raw byte for each."""
        if not isinstance(command, Read):
            return True
        return self._raw(command, received) or set(range(command.count)) <= set(self._states(received))

    def on_mask(self, command: Command, received: bytes) -> int:
        """The mask of the relays that are on according to an answer."""
        if not isinstance(command, Read):
            if received:
                raise WireError(f"answered {received!r} to a command without an answer")
            return 0
        if self._raw(command, received):
            return sum(1 << relay for relay in range(command.count) if received[relay])
        states = self._states(received)
        reported = len(received) if _is_raw(received) else len(states) if _WHOLE_LINES.fullmatch(received) else 0
        if 0 < reported < command.count:
            raise TooFewRelays(f"the board has relays 1 to {reported}, and ch= names {command.count - 1 + self.first}")
        if not set(range(command.count)) <= set(states) or not _LINES.fullmatch(received):
            raise WireError(f"answered {received!r} when the relays were read")
        return sum(1 << relay for relay in range(command.count) if states[relay])

    def commands(self, received: bytes) -> tuple[list[Command], bytes]:
        """The commands in `received`, and the bytes of an incomplete last frame.

        Bytes that begin neither a valid frame nor a read are skipped.
        """
        commands: list[Command] = []
        position = 0
        while position < len(received):
            frame = received[position : position + 4]
            if frame[0] == START and len(frame) < 4:
                break
            if frame[0] == START and frame == _frame(frame[1], frame[2]) and frame[1] >= self.first:
                commands.append(Switch(frame[1] - self.first, bool(frame[2])))
                position += 4
                continue
            if frame[0] == READ:
                commands.append(Read(0))
            position += 1
        return commands, received[position:]

    def answer(self, command: Command, on_mask: int, relays: int) -> bytes:
        """The answer of a board with a CH340: a line for each relay if they are read; a switch has no answer."""
        if not isinstance(command, Read):
            return b""
        return b"".join(
            b"CH%d: %s\r\n" % (relay + self.first, b"ON " if on_mask >> relay & 1 else b"OFF")
            for relay in range(relays)
        )

    def _states(self, received: bytes) -> dict[int, bool]:
        return {int(number) - self.first: state == b"ON" for number, state in _LINE.findall(received)}

    def _raw(self, command: Read, received: bytes) -> bool:
        return command.count <= len(received) <= _MAX_RAW and _is_raw(received)


def _is_raw(received: bytes) -> bool:
    return all(byte in (0, 1) for byte in received)


def _frame(number: int, state: int) -> bytes:
    return bytes([START, number, state, (START + number + state) & 0xFF])
