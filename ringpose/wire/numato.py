"""Numato boards (CDC-ACM, any baud): text commands, ended by a carriage return, are echoed; a prompt `>` follows."""

import re
from dataclasses import dataclass

from ringpose.wire.relay_codec import Command, Read, Switch, TooFewRelays, WireError

_DIGITS = "0123456789ABCDEFGHIJKLMNOPQRSTUV"
"""Names of the relays."""

_COMMAND = re.compile(r"relay (on|off) ([0-9A-V])|relay (readall)")

_ANSWER = re.compile(rb"[\r\n>]*(?P<echo>[^\r\n]+)[\r\n]+(?:(?P<states>[0-9a-fA-F]+)[\r\n]+)?>\s*")
"""The prompt of an earlier command may be in front of the echo."""


@dataclass(frozen=True, slots=True)
class NumatoCodec:
    """Echo and prompt do not confirm that a relay has switched; only reading the states does."""

    first: int = 0
    reports: bool = True
    switches_rows: bool = False

    def request(self, command: Command) -> bytes:
        """The bytes of a command: one line of text."""
        if isinstance(command, Read):
            return b"relay readall\r"
        if not isinstance(command, Switch):
            raise WireError("a Numato board switches one relay at a time")
        return f"relay {'on' if command.on else 'off'} {_DIGITS[command.relay]}\r".encode()

    def is_whole(self, command: Command, received: bytes) -> bool:
        """Whether the answer is complete: the prompt has come after the echo."""
        return received.rstrip().endswith(b">") and self._echo(command) in received

    def on_mask(self, command: Command, received: bytes) -> int:
        """The mask of the relays that are on, which the board sends as a hexadecimal number."""
        answer = _ANSWER.fullmatch(received)
        is_read = isinstance(command, Read)
        if answer is None or answer["echo"] != self._echo(command) or (answer["states"] is not None) is not is_read:
            raise WireError(f'answered {received!r} to "{self._echo(command).decode()}"')
        if not isinstance(command, Read):
            return 0
        relays = 4 * len(answer["states"])
        if relays < command.count:
            raise TooFewRelays(f"the board has relays 0 to {relays - 1}, and ch= names {command.count - 1}")
        return int(answer["states"], 16) & ((1 << command.count) - 1)

    def commands(self, received: bytes) -> tuple[list[Command], bytes]:
        """The commands in complete lines, and the bytes of an incomplete one; other lines are skipped."""
        *lines, rest = received.replace(b"\n", b"").split(b"\r")
        commands: list[Command] = []
        for line in lines:
            words = _COMMAND.fullmatch(line.decode("ascii", "replace"))
            if words is None:
                continue
            commands.append(Read(0) if words[3] else Switch(_DIGITS.index(words[2]), words[1] == "on"))
        return commands, rest

    def answer(self, command: Command, on_mask: int, relays: int) -> bytes:
        """The answer of a board: the echo, the states of the relays if they are read, and the prompt."""
        states = f"{on_mask:0{max(1, relays // 4)}x}\n\r".encode() if isinstance(command, Read) else b""
        return self._echo(command) + b"\n\r" + states + b">"

    def _echo(self, command: Command) -> bytes:
        return self.request(command).rstrip()
