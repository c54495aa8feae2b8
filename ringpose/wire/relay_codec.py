"""What relay boards are told and answer, whichever bytes they want it in.

A codec maps commands to bytes for the driver and bytes to commands for the stand-in. Relays are counted from 0 here;
`first` is the number that the board itself gives to relay 0. Bit i of `lit` is relay i. No module of this kind
imports anything heavy: the guard starts with them.
"""

from dataclasses import dataclass
from typing import Protocol, TypeAlias, runtime_checkable


class WireError(Exception):
    """Bytes that say nothing, or refuse."""


@dataclass(frozen=True, slots=True)
class Switch:
    """One relay on or off."""

    relay: int
    on: bool


@dataclass(frozen=True, slots=True)
class SwitchRow:
    """`count` neighbouring relays at once: bit i of `lit` is relay `first` + i."""

    first: int
    count: int
    lit: int


@dataclass(frozen=True, slots=True)
class Pulse:
    """One relay on; the board itself switches it off after this time."""

    relay: int
    duration_s: float


@dataclass(frozen=True, slots=True)
class Read:
    """The question which of the relays 0 ... count - 1 are on."""

    count: int


Command: TypeAlias = Switch | SwitchRow | Pulse | Read


@runtime_checkable
class RelayCodec(Protocol):
    """The bytes of one kind of board."""

    @property
    def first(self) -> int:
        """The number that the board gives to relay 0."""

    @property
    def reports(self) -> bool:
        """Whether it can say what is on."""

    @property
    def switches_rows(self) -> bool:
        """Whether it knows `SwitchRow`."""

    def request(self, command: Command) -> bytes:
        """The command in bytes."""

    def is_whole(self, command: Command, received: bytes) -> bool:
        """Whether the answer to a command has come completely; at once where there is none."""

    def lit(self, command: Command, received: bytes) -> int:
        """What a whole answer says: for `Read` the relays that are on; 0 otherwise. A refusal is a `WireError`."""

    def commands(self, received: bytes) -> tuple[list[Command], bytes]:
        """For the stand-in: the commands in what was received, and the bytes of one that is still incomplete."""

    def answer(self, command: Command, lit: int, relays: int) -> bytes:
        """For the stand-in: what a board of so many relays says to a command; `lit` is what is on by then."""


def row_of(command: Command) -> tuple[int, int]:
    """Which relays a command switches on, and which off, as masks."""
    if isinstance(command, Read):
        return 0, 0
    if isinstance(command, SwitchRow):
        row = ((1 << command.count) - 1) << command.first
        on = (command.lit << command.first) & row
        return on, row & ~on
    bit = 1 << command.relay
    return (0, bit) if isinstance(command, Switch) and not command.on else (bit, 0)
