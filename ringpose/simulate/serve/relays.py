"""A relay board on a pseudo-terminal, spoken to by the driver that speaks to the real one.

Which lasers truly shone, and when: contacts follow their coils late, and some not at all.
"""

import os
import select
import threading
import time
import tty
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from types import TracebackType

from ringpose.wire.relay_codec import Command, Pulse, Read, RelayCodec, SwitchRow, row_of

ALL_RELAYS = 8
"""Of the boards that are stood in for."""

_MAX_COMMAND = 64
"""Bytes; what goes on for longer without a command's end is noise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RelayFaults:
    """What is wrong with the lasers of a board, by their place in the rig."""

    operate_s: float = 0.0
    """From a command until the contact has closed."""
    release_s: float = 0.0
    """From a command until it has opened."""
    stuck: frozenset[int] = frozenset()
    """Lasers whose contact welds when it closes for the first time."""
    welded: frozenset[int] = frozenset()
    """Lasers that are on from the beginning, whatever is commanded."""
    dead: frozenset[int] = frozenset()
    """Lasers that stay dark."""
    late_s: Mapping[int, float] = field(default_factory=dict)
    """Lasers that come on and go off later than the rest."""


class ServedRelays:
    """A board whose relays switch lasers: relay `relays[i]` of the board (from 0) feeds laser i of the rig.

    `mask_at` and `contacts` tell what truly shines, which a camera's stand-in renders; the board itself reports its
    coils. A thread serves until the block ends or `unplug` pulls the cable.
    """

    def __init__(
        self,
        codec: RelayCodec,
        relays: Sequence[int] = (0, 1, 2),
        faults: RelayFaults | None = None,
        changed: Callable[[int], None] | None = None,
    ) -> None:
        self.relays = tuple(relays)
        self.contacts = RelayContacts(len(self.relays), faults)
        self.port = ""
        """The terminal to open, once served."""
        self._codec = codec
        self._changed = changed
        self._coils_until_s = [0.0] * ALL_RELAYS
        self._master = self._slave = -1
        self._stop_read, self._stop_write = -1, -1
        self._thread: threading.Thread | None = None

    @property
    def channels(self) -> str:
        """The relays by the board's own numbers, as the driver's URI has them after `ch=`."""
        return ",".join(str(relay + self._codec.first) for relay in self.relays)

    def mask_at(self, time_s: float) -> int:
        """The lasers that truly shine at a time (monotonic clock): bit i is laser i of the rig."""
        return self.contacts.mask_at(time_s)

    def __enter__(self) -> "ServedRelays":
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self._stop_read, self._stop_write = os.pipe()
        self._thread = threading.Thread(target=self._serve, name=self.port, daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.unplug()

    def unplug(self) -> None:
        """Pull the cable: the terminal hangs up. The contacts stay as they are."""
        if self._thread is None:
            return
        os.write(self._stop_write, b"x")
        self._thread.join()
        self._thread = None
        for number in (self._master, self._slave, self._stop_read, self._stop_write):
            os.close(number)

    def _serve(self) -> None:
        pending = b""
        while True:
            ready, _, _ = select.select([self._master, self._stop_read], [], [])
            if self._stop_read in ready:
                return
            commands, pending = self._codec.commands(pending + os.read(self._master, 4096))
            pending = pending[-_MAX_COMMAND:]
            for command in filter(_is_for_the_board, commands):
                self._carry_out(command)

    def _carry_out(self, command: Command) -> None:
        now_s = time.monotonic()
        before = self._coils(now_s)
        on, off = row_of(command)
        until_s = now_s + command.duration_s if isinstance(command, Pulse) else None
        for relay in range(ALL_RELAYS):
            if (on | off) >> relay & 1:
                self._switch(relay, bool(on >> relay & 1), now_s, until_s)
        coils = self._coils(now_s)
        with suppress(BlockingIOError):  # nobody reads what the board says
            os.write(self._master, self._codec.answer(command, coils, ALL_RELAYS))
        if self._changed is not None and not isinstance(command, Read) and coils != before:
            self._changed(coils)

    def _switch(self, relay: int, on: bool, now_s: float, until_s: float | None) -> None:
        self._coils_until_s[relay] = 0.0 if not on else float("inf") if until_s is None else until_s
        if relay in self.relays:
            self.contacts.command(self.relays.index(relay), on, now_s, until_s)

    def _coils(self, now_s: float) -> int:
        return sum(1 << relay for relay, until_s in enumerate(self._coils_until_s) if until_s > now_s)


def _is_for_the_board(command: Command) -> bool:
    """Whether it has the relays that are named; a command to others is not answered."""
    if isinstance(command, Read):
        return command.count <= ALL_RELAYS
    if isinstance(command, SwitchRow):
        row = range(command.first, command.first + command.count)
        return row.start >= 0 and row.stop <= ALL_RELAYS and command.on_mask < 1 << command.count
    return 0 <= command.relay < ALL_RELAYS


KEPT = 1000
"""Changes that each contact remembers."""


class RelayContacts:
    """The contacts of all lasers over time (monotonic clock, s)."""

    def __init__(self, lasers: int, faults: RelayFaults | None = None) -> None:
        self.faults = faults or RelayFaults()
        self._lock = threading.Lock()
        self._pulse_end_s: dict[int, float] = {}
        self._changes: list[list[tuple[float, bool]]] = [
            [(float("-inf"), laser in self.faults.welded)] for laser in range(lasers)
        ]

    def command(self, laser: int, on: bool, now_s: float, until_s: float | None = None) -> None:
        """A coil is switched now, and back at `until_s` if it is a pulse."""
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
            closing_s = now_s + late_s + (faults.operate_s if on else faults.release_s)
            changes.append((max(closing_s, changes[-1][0]), on))
            if until_s is not None and laser not in faults.stuck:
                self._pulse_end_s[laser] = until_s + late_s + faults.release_s
                changes.append((self._pulse_end_s[laser], False))
            del changes[1:-KEPT]

    def mask_at(self, time_s: float) -> int:
        """The lasers that shine at a time: bit i is laser i of the rig."""
        with self._lock:
            return sum(1 << laser for laser, changes in enumerate(self._changes) if _state(changes, time_s))

    def shares(self, begin_s: float, end_s: float) -> tuple[float, ...]:
        """For each laser the share of an interval in which it shines."""
        with self._lock:
            return tuple(_share(changes, begin_s, end_s) for changes in self._changes)

    def on_since_s(self, laser: int, time_s: float) -> float | None:
        """Since when a laser that shines at a time has done so; None if it does not."""
        with self._lock:
            changes = [change for change in self._changes[laser] if change[0] <= time_s]
        since_s = None
        for at_s, on in changes:
            since_s = (at_s if since_s is None else since_s) if on else None
        return since_s


def _state(changes: list[tuple[float, bool]], time_s: float) -> bool:
    return changes[bisect_right(changes, (time_s, True)) - 1][1]


def _share(changes: list[tuple[float, bool]], begin_s: float, end_s: float) -> float:
    if end_s <= begin_s:
        return float(_state(changes, begin_s))
    inner = [at_s for at_s, _ in changes if begin_s < at_s < end_s]
    edges = [begin_s, *inner, end_s]
    lit_s = sum(late - early for early, late in pairwise(edges) if _state(changes, early))
    return lit_s / (end_s - begin_s)
