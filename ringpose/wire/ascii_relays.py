"""Boards controlled by lines of text, such as an Arduino with a custom sketch: the lines are templates."""

import re
from dataclasses import dataclass

from ringpose.wire.relay_codec import Command, Read, Switch, WireError

_ON_WORDS = frozenset({"1", "on", "high", "true"})

_NUMBER = re.compile(r"0+|[1-9][0-9]{0,9}|0x[0-9a-f]{1,8}|0b[01]{1,32}")

_OFF_WORDS = frozenset({"0", "off", "low", "false"})


@dataclass(frozen=True, slots=True)
class AsciiCodec:
    """Templates of the lines; `{n}` stands for the number of the relay."""

    on: str
    off: str
    read: str = ""
    """Reads all relays; the answer is their mask (bit 0: the first relay). Empty if the board does not report them."""
    acknowledged_by: str = ""
    """The line that acknowledges each command; empty if there is none."""
    end: str = "\n"
    first: int = 1
    switches_rows: bool = False

    @property
    def reports(self) -> bool:
        """Whether the board can report which relays are on."""
        return bool(self.read)

    def request(self, command: Command) -> bytes:
        """The bytes of a command: one line of text."""
        if isinstance(command, Read):
            return (self.read + self.end).encode()
        if not isinstance(command, Switch):
            raise WireError("a board controlled by text lines switches one relay at a time")
        template = self.on if command.on else self.off
        return (template.replace("{n}", str(command.relay + self.first)) + self.end).encode()

    def is_whole(self, command: Command, received: bytes) -> bool:
        """Whether the answer is complete: it ends with a line that is not the echo of the command, if one is expected.

        Adapters and sketches may echo the command.
        """
        if not isinstance(command, Read) and not self.acknowledged_by:
            return True
        return received.endswith(b"\n") and bool(self._answer_lines(command, received))

    def on_mask(self, command: Command, received: bytes) -> int:
        """The mask of the relays that are closed according to the last line of an answer; 0 for an acknowledgement."""
        lines = self._answer_lines(command, received)
        line = lines[-1] if lines and received.endswith(b"\n") else ""
        if isinstance(command, Read):
            return self._mask(line, command.count)
        if self.acknowledged_by and line != self.acknowledged_by:
            raise WireError(f'answered "{line}", not "{self.acknowledged_by}"')
        return 0

    def commands(self, received: bytes) -> tuple[list[Command], bytes]:
        """The commands in complete lines that match a template, and the bytes of an incomplete line."""
        end = self.end.encode()
        *lines, rest = received.split(end)
        commands = [self._command(line.decode("ascii", "replace")) for line in lines]
        return [command for command in commands if command is not None], rest

    def answer(self, command: Command, on_mask: int, relays: int) -> bytes:
        """The answer of a board: the mask of its relays as a line, or the acknowledgement."""
        if isinstance(command, Read):
            return f"{on_mask}\r\n".encode()
        return f"{self.acknowledged_by}\r\n".encode() if self.acknowledged_by else b""

    def _answer_lines(self, command: Command, received: bytes) -> list[str]:
        """The lines of an answer without blank ones and without the command itself."""
        sent = self.request(command).decode().strip()
        lines = [line.strip() for line in received.decode("ascii", "replace").split("\n")]
        return [line for line in lines if line not in ("", sent)]

    def _command(self, line: str) -> Command | None:
        if self.read and line == self.read:
            return Read(0)
        for template, on in ((self.on, True), (self.off, False)):
            number = re.fullmatch(re.escape(template).replace(r"\{n\}", r"(\d+)"), line)
            if number is not None:
                return Switch(int(number[1]) - self.first, on)
        return None

    def _mask(self, line: str, count: int) -> int:
        word = line.lower()
        if count == 1 and word in _ON_WORDS | _OFF_WORDS:
            return int(word in _ON_WORDS)
        if not _NUMBER.fullmatch(word):
            raise WireError(f'answered "{line}" when the relays were read')
        return int(word, 0) & ((1 << count) - 1)
