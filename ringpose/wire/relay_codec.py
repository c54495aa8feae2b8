"""Commands for relay boards, and the interface of the codecs that translate them to the bytes of a protocol.

A codec encodes commands for the driver and decodes them for the virtual device. Relays are counted from 0; `first` is
the number of relay 0 in the protocol. In masks, bit i is relay i. Codecs are imported by the watchdog process and
import no heavy package themselves.
"""

from dataclasses import dataclass
from typing import Protocol, TypeAlias, runtime_checkable


class WireError(Exception):
    """A command or answer that the protocol does not allow."""


class Refused(WireError):
    """The board has answered that it rejects the command."""


class TooFewRelays(WireError):
    """The board reports fewer relays than the command reads."""


@dataclass(frozen=True, slots=True)
class Switch:
    """One relay on or off."""

    relay: int
    on: bool


@dataclass(frozen=True, slots=True)
class SwitchRow:
    """`count` adjacent relays at once: bit i of `on_mask` is relay `first` + i."""

    first: int
    count: int
    on_mask: int


@dataclass(frozen=True, slots=True)
class Pulse:
    """One relay on; the board itself switches it off after this time."""

    relay: int
    duration_s: float


@dataclass(frozen=True, slots=True)
class Read:
    """Read which of the relays 0 ... count - 1 are on."""

    count: int


Command: TypeAlias = Switch | SwitchRow | Pulse | Read


@runtime_checkable
class RelayCodec(Protocol):
    """The protocol of one kind of board."""

    @property
    def first(self) -> int:
        """The number of relay 0 in the protocol."""

    @property
    def reports(self) -> bool:
        """Whether the board can report which relays are on."""

    @property
    def switches_rows(self) -> bool:
        """Whether the protocol has `SwitchRow`."""

    def request(self, command: Command) -> bytes:
        """The bytes by which a driver sends a command."""

    def is_whole(self, command: Command, received: bytes) -> bool:
        """Whether the answer to a command has its whole length; always true for a command without an answer."""

    def on_mask(self, command: Command, received: bytes) -> int:
        """The mask of the relays that are on according to the answer to `Read`; 0 for other commands.

        Raises `Refused` if the board rejects the command, `TooFewRelays` if it has fewer than are read, and
        `WireError` if the bytes are not its answer and nothing else: the request itself, which some adapters echo, is
        not an answer unless the protocol repeats it.
        """

    def commands(self, received: bytes) -> tuple[list[Command], bytes]:
        """For the virtual device: the received commands, and the remaining bytes of an incomplete one."""

    def answer(self, command: Command, on_mask: int, relays: int) -> bytes:
        """For the virtual device: the answer of a board with `relays` relays; `on_mask` are on after the command."""


def row_of(command: Command) -> tuple[int, int]:
    """The masks of the relays that a command switches on and off."""
    if isinstance(command, Read):
        return 0, 0
    if isinstance(command, SwitchRow):
        row = ((1 << command.count) - 1) << command.first
        on = (command.on_mask << command.first) & row
        return on, row & ~on
    bit = 1 << command.relay
    return (0, bit) if isinstance(command, Switch) and not command.on else (bit, 0)
