"""The clock of a stream of records, by their stamps in the order of arrival.

A record that is late fills a gap between the stamps of those that overtook it. Shots that are taken after a clock was
set back by less than the buffer's length have stamps among those of earlier shots, and nearer to them than one camera
takes shots: the second such record in succession shows that there are two clocks. A clock that was set back further
shows by stamps that remain older than those before for longer than a track is kept.
"""

from collections import deque
from enum import Enum, auto
from itertools import pairwise
from typing import NamedTuple

MIN_SHARE = 0.75
"""Distance of two stamps, in shortest intervals between shots, below which one camera has not taken both.

Stamps of a second clock are at most half an interval from one of the first. A late record is a whole one away.
"""

MIN_STAMPS, MAX_STAMPS = 5, 50
"""Number of stamps that show the shortest interval between shots, and of those that are remembered."""


class Arrival(Enum):
    """How the stamp of a record follows those of the records that arrived before it."""

    IN_ORDER = auto()
    LATE = auto()
    """It is older than the newest."""
    AHEAD = auto()
    """It is ahead of this computer's clock."""
    IN_DOUBT = auto()
    """It is among the stamps of earlier shots, too near to one of them."""
    SET_BACK = auto()
    """The clock was set back before this record."""
    AFTER_STRAY = auto()
    """Stamps that were ahead of this one were wrong."""


class _Aside(NamedTuple):
    """Successive records that are older than the newest, or ahead of this computer's clock."""

    is_ahead: bool
    stamp_s: float
    """Stamp of the last one."""
    state_s: float
    """Stamp of the track's record before the first one."""
    elapsed_s: float
    """Time from the first to the last, with bounded gaps."""


class StreamClock:
    """The stamps of a stream of records so far."""

    def __init__(self, lost_after_s: float) -> None:
        """`lost_after_s`: time without a measurement after which a track is given up."""
        self._lost_after_s = lost_after_s
        self._newest_s = self._state_s = -float("inf")
        self._shots_s: deque[float] = deque(maxlen=MAX_STAMPS)
        """Stamps of measured shots, which all hold at the same instant of a shot."""
        self._doubtful_s: float | None = None
        self._aside: _Aside | None = None
        """The records that were not in order, if only such have arrived since the last one that was."""

    @property
    def is_in_doubt(self) -> bool:
        """Whether the next record decides if the clock was set back."""
        return self._doubtful_s is not None

    def arrived(self, stamp_s: float, track_s: float, *, is_ahead: bool, is_shot: bool) -> Arrival:
        """How a record's stamp follows those before it.

        `track_s`: stamp of the track, NaN without one. `is_ahead`: whether the stamp is ahead of this computer's clock.
        `is_shot`: whether a shot was measured, whose stamp is not older than the track's buffer.
        """
        if not is_ahead and not stamp_s < self._newest_s:  # also if it is NaN
            self._newest_s = max(self._newest_s, stamp_s)
            self._aside = self._doubtful_s = None
            if is_shot:
                self._shots_s.append(stamp_s)
            return Arrival.IN_ORDER
        aside = self._aside = self._put_aside(stamp_s, track_s, is_ahead)
        if is_ahead:
            return Arrival.AHEAD
        if aside.elapsed_s > self._lost_after_s:
            if track_s > stamp_s:
                return Arrival.SET_BACK
            self._newest_s, self._state_s, self._aside = stamp_s, -float("inf"), None
            return Arrival.AFTER_STRAY
        return self._late(stamp_s) if is_shot else Arrival.LATE

    def state_stamp_s(self, stamp_s: float, track_s: float, *, is_used: bool) -> float:
        """The stamp of the track's record after a record with `stamp_s`: never before that of the record before.

        A record that is not used, and whose stamp is of another time, lets the time pass that is between it and the one
        before.
        """
        if self._aside is not None and not is_used:
            stamp_s = self._aside.state_s + self._aside.elapsed_s
        self._state_s = max(self._state_s, track_s, stamp_s)
        return self._state_s

    def _put_aside(self, stamp_s: float, track_s: float, is_ahead: bool) -> _Aside:
        """The successive records that are not in order, with this one.

        A stamp that is not later than the one before, or on the other side of the newest, is of another clock: its
        sequence begins anew. The time between two records, whose stamps may both be wrong, counts for no more than half
        of the time after which a track is lost.
        """
        last = self._aside
        if last is None or last.is_ahead != is_ahead or not stamp_s > last.stamp_s:
            return _Aside(is_ahead, stamp_s, max(self._state_s, track_s), 0.0)
        passed_s = min(stamp_s - last.stamp_s, self._lost_after_s / 2)
        return last._replace(stamp_s=stamp_s, elapsed_s=last.elapsed_s + passed_s)

    def _late(self, stamp_s: float) -> Arrival:
        """Whether a shot that is older than the newest is late, or of a clock that was set back."""
        if self._doubtful_s is not None and stamp_s > self._doubtful_s:
            return Arrival.SET_BACK
        if self._is_among_others(stamp_s):
            self._doubtful_s = stamp_s
            return Arrival.IN_DOUBT
        self._shots_s.append(stamp_s)
        return Arrival.LATE

    def _is_among_others(self, stamp_s: float) -> bool:
        if len(self._shots_s) < MIN_STAMPS:
            return False
        shortest_s = min(later - earlier for earlier, later in pairwise(sorted(self._shots_s)))
        return min(abs(stamp_s - each) for each in self._shots_s) < MIN_SHARE * shortest_s
