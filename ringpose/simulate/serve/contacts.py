"""Which lasers truly shone, and when: contacts follow their coils late, and some not at all."""

import threading
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise

KEPT = 1000
"""Changes that each contact remembers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactFaults:
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


class Contacts:
    """The contacts of all lasers over time (monotonic clock, s)."""

    def __init__(self, lasers: int, faults: ContactFaults | None = None) -> None:
        self.faults = faults or ContactFaults()
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
