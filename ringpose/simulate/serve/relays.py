"""A virtual relay board on a pseudo-terminal, and the state over time of the contacts that switch the lasers.

A contact follows its coil with a delay, and an injected fault may keep it closed or open: the board reports its coils,
as a real one does, and the virtual camera renders the contacts.
"""

import os
import select
import threading
import time
import tty
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise

from ringpose.wire.relay_codec import Command, Pulse, Read, RelayCodec, SwitchRow, row_of

BOARD_RELAYS = 8
"""Number of relays of a virtual board."""

KEPT_CHANGES = 1000
"""Number of state changes that are stored for each contact."""

_MAX_COMMAND_BYTES = 64
"""Only this many of the received bytes that do not form a command are kept."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RelayFaults:
    """Injected faults of the contacts; lasers are numbered from 0 in the rig's order."""

    operate_s: float = 0.0
    """Delay from a command until a contact closes."""
    release_s: float = 0.0
    """Delay from a command until a contact opens."""
    stuck: frozenset[int] = frozenset()
    """Lasers whose contact welds when it closes for the first time."""
    welded: frozenset[int] = frozenset()
    """Lasers whose contact is closed from the start."""
    dead: frozenset[int] = frozenset()
    """Lasers that are never on."""
    late_s: Mapping[int, float] = field(default_factory=dict)
    """Additional delay of single lasers, in both directions."""


class ServedRelays:
    """A board whose relay `relays[i]` (from 0) switches laser i of the rig.

    A context manager: a thread serves the board inside the block.
    """

    def __init__(
        self,
        codec: RelayCodec,
        relays: Sequence[int] = (0, 1, 2),
        faults: RelayFaults | None = None,
    ) -> None:
        self.relays = tuple(relays)
        self.contacts = RelayContacts(len(self.relays), faults)
        self.port = ""
        """Path of the pseudo-terminal, once the board is served."""
        self._codec = codec
        self._coils_until_s = [0.0] * BOARD_RELAYS
        """Time until which each coil is on (monotonic clock)."""
        self._thread: threading.Thread | None = None

    @property
    def channels(self) -> str:
        """The parameter `ch=` of the laser URI: the relays by the board's own numbers."""
        return ",".join(str(relay + self._codec.first) for relay in self.relays)

    def __enter__(self) -> "ServedRelays":
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self._stop_read, self._stop_write = os.pipe()
        self._thread = threading.Thread(target=self._serve, name=self.port, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()

    def unplug(self) -> None:
        """Close the pseudo-terminal, as if the cable were unplugged; the contacts keep their state."""
        if self._thread is None:
            return
        os.write(self._stop_write, b"x")
        self._thread.join()
        self._thread = None
        for descriptor in (self._master, self._slave, self._stop_read, self._stop_write):
            os.close(descriptor)

    def _serve(self) -> None:
        pending = b""
        while True:
            ready, _, _ = select.select([self._master, self._stop_read], [], [])
            if self._stop_read in ready:
                return
            commands, pending = self._codec.commands(pending + os.read(self._master, 4096))
            pending = pending[-_MAX_COMMAND_BYTES:]
            for command in filter(_has_valid_relays, commands):
                self._execute(command)

    def _execute(self, command: Command) -> None:
        """Switch the coils and contacts of a command, and answer it."""
        now_s = time.monotonic()
        on, off = row_of(command)
        until_s = now_s + command.duration_s if isinstance(command, Pulse) else None
        for relay in range(BOARD_RELAYS):
            if not (on | off) >> relay & 1:
                continue
            is_on = bool(on >> relay & 1)
            self._coils_until_s[relay] = 0.0 if not is_on else float("inf") if until_s is None else until_s
            if relay in self.relays:
                self.contacts.command(self.relays.index(relay), is_on, now_s, until_s)
        coils = sum(1 << relay for relay, end_s in enumerate(self._coils_until_s) if end_s > now_s)
        with suppress(BlockingIOError):  # the client does not read its answers
            os.write(self._master, self._codec.answer(command, coils, BOARD_RELAYS))


def _has_valid_relays(command: Command) -> bool:
    """Whether the board has the relays of a command; commands to other relays are not answered."""
    if isinstance(command, Read):
        return command.count <= BOARD_RELAYS
    if isinstance(command, SwitchRow):
        row = range(command.first, command.first + command.count)
        return row.start >= 0 and row.stop <= BOARD_RELAYS and command.on_mask < 1 << command.count
    return 0 <= command.relay < BOARD_RELAYS


class RelayContacts:
    """The state of the contacts of all lasers over time (monotonic clock)."""

    def __init__(self, lasers: int, faults: RelayFaults | None = None) -> None:
        self.faults = faults or RelayFaults()
        self._lock = threading.Lock()
        self._pulse_end_s: dict[int, float] = {}
        self._changes: list[list[tuple[float, bool]]] = [
            [(float("-inf"), laser in self.faults.welded)] for laser in range(lasers)
        ]
        """For each laser the times of the state changes, ascending, and the state from then on."""

    def command(self, laser: int, on: bool, now_s: float, until_s: float | None = None) -> None:
        """Switch the coil of a laser now, and off at `until_s` if it is a pulse."""
        faults = self.faults
        if laser in faults.welded or laser in faults.dead:
            return
        late_s = faults.late_s.get(laser, 0.0)
        with self._lock:
            changes = self._changes[laser]
            if changes[-1][0] == self._pulse_end_s.pop(laser, None) and changes[-1][0] > now_s:
                changes.pop()
            if laser in faults.stuck and changes[-1][1]:
                return
            change_s = now_s + late_s + (faults.operate_s if on else faults.release_s)
            changes.append((max(change_s, changes[-1][0]), on))
            if until_s is not None and laser not in faults.stuck:
                self._pulse_end_s[laser] = until_s + late_s + faults.release_s
                changes.append((self._pulse_end_s[laser], False))
            del changes[1:-KEPT_CHANGES]

    def mask_at(self, time_s: float) -> int:
        """Mask of the lasers that are on at a time; bit i is laser i of the rig."""
        with self._lock:
            return sum(1 << laser for laser, changes in enumerate(self._changes) if _is_on(changes, time_s))

    def shares(self, begin_s: float, end_s: float) -> tuple[float, ...]:
        """For each laser the share of an interval during which it is on; the state if the interval is empty."""
        with self._lock:
            return tuple(_share_on(changes, begin_s, end_s) for changes in self._changes)

    def on_since_s(self, time_s: float) -> tuple[float | None, ...]:
        """For each laser the time since which it has been on without interruption; None if it is off at `time_s`."""
        with self._lock:
            return tuple(_on_since_s(changes, time_s) for changes in self._changes)


def _is_on(changes: list[tuple[float, bool]], time_s: float) -> bool:
    return changes[bisect_right(changes, (time_s, True)) - 1][1]


def _on_since_s(changes: list[tuple[float, bool]], time_s: float) -> float | None:
    since_s = None
    for change_s, on in changes:
        if change_s <= time_s:
            since_s = (change_s if since_s is None else since_s) if on else None
    return since_s


def _share_on(changes: list[tuple[float, bool]], begin_s: float, end_s: float) -> float:
    if end_s <= begin_s:
        return float(_is_on(changes, begin_s))
    edges = [begin_s, *(change_s for change_s, _ in changes if begin_s < change_s < end_s), end_s]
    on_s = sum(late - early for early, late in pairwise(edges) if _is_on(changes, early))
    return on_s / (end_s - begin_s)
