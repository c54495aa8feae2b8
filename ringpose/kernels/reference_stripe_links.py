"""Readable NumPy twin of `stripe_links.c`: ridges of neighbouring columns joined into pieces."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ringpose.kernels.reference_stripe_patches import Filter, Pixels
from ringpose.kernels.stripes import StripeRules

STEP, LEAST_STEP_PX, MOST_STEP_PX, NEXT_PX = 5, 1.25, 2.0, 1.0
"""A ridge may lie so many times farther from where its piece is expected than the piece's ridges do on average, within
limits; or so close to the last one."""

FIRST_UNREST_PX, UNREST_SHARE = 0.25, 0.125
"""What that average is taken for at first, and the share of each further column in it."""

COURSE_COLUMNS = 8
"""A piece's course is a line fitted to all its columns at first, later to about so many."""

GAIN = [0, 1, 1, 5 / 6, 7 / 10, 3 / 5, 11 / 21, 13 / 28, 5 / 12]
SLOPE_GAIN = [0, 0.3, 0.3, 0.3, 0.3, 1 / 5, 1 / 7, 3 / 28, 1 / 12]
"""Shares of a ridge's distance that move the line and turn it, by number of columns: those of least squares."""

CLOSEST_SHOULDERS, FARTHEST_SHOULDERS = 5, 40
"""Two ridges of a column so far apart may be the shoulders of a flat top."""

PLATEAU_SHARE = 0.8
"""Between shoulders the signal keeps this share of theirs."""


class Ridge(NamedTuple):
    """A ridge in one column."""

    x: int
    row: int
    y: np.float32
    response: np.float32
    bend: np.float32
    """How fast the response falls off on both sides; on a flat top minus half its width."""
    noise: np.float32


@dataclass(slots=True, kw_only=True)
class Track:
    """A piece that may go on."""

    expected: np.float32
    slope: np.float32 = np.float32(0)
    unrest: np.float32 = np.float32(FIRST_UNREST_PX)
    missing: int = 0
    ridges: list[Ridge] = field(default_factory=list)

    def takes(self, ridge: Ridge) -> bool:
        """Whether a ridge lies near where the piece is expected, or right beside its last one: a stripe may bend."""
        step = float(np.clip(STEP * self.unrest, LEAST_STEP_PX, MOST_STEP_PX))
        beside = self.missing == 0 and abs(self.ridges[-1].y - ridge.y) <= NEXT_PX
        return bool(abs(self.expected - ridge.y) <= step or beside)

    def follow(self, ridge: Ridge) -> None:
        """Go on with a ridge: a line through the columns so far, then one that forgets."""
        self.ridges.append(ridge)
        off = ridge.y - self.expected
        count = min(len(self.ridges), COURSE_COLUMNS)
        self.slope = self.slope + off * np.float32(SLOPE_GAIN[count]) / np.float32(self.missing + 1)
        self.expected = self.expected + (off * np.float32(GAIN[count]) + self.slope)
        self.unrest = self.unrest + np.float32(UNREST_SHARE) * (abs(off) - self.unrest)
        self.missing = 0

    def stay(self) -> None:
        """Go on without one."""
        self.expected = self.expected + self.slope
        self.missing += 1


def pieces(pixels: Pixels, ridges: Sequence[list[Ridge]], filter_: Filter, rules: StripeRules) -> list[list[Ridge]]:
    """All pieces, in the order in which they begin (by column, then row)."""
    tracks: list[Track] = []
    begun: list[list[Ridge]] = []
    for column in ridges:
        found = joined_shoulders(pixels, column, int(3 * filter_.sigma + 0.5))
        taken = matches(tracks, found)
        for number, track in enumerate(tracks):
            if number in taken:
                track.follow(found[taken[number]])
            else:
                track.stay()
        tracks = [each for each in tracks if each.missing <= rules.gap and each.missing < len(each.ridges)]
        for i, ridge in enumerate(found):
            if i not in taken.values():
                tracks.append(Track(expected=ridge.y, ridges=[ridge]))
                begun.append(tracks[-1].ridges)
        tracks.sort(key=lambda each: each.expected)
    return begun


def is_kept(piece: Sequence[Ridge], rules: StripeRules) -> bool:
    """Whether a piece has enough columns, and enough that stand out of the noise."""
    strong = [bool(ridge.response >= np.float32(rules.begin_sigmas) * ridge.noise) for ridge in piece]
    return strong.count(True) >= rules.shortest


def matches(tracks: Sequence[Track], ridges: Sequence[Ridge]) -> dict[int, int]:
    """Which ridge each piece takes: each ridge asks the nearest piece; a piece takes the nearest that asks."""
    taken: dict[int, int] = {}
    expected = np.array([track.expected for track in tracks])
    for i, ridge in enumerate(ridges if tracks else ()):
        nearest = int(np.argmin(abs(expected - ridge.y)))
        rival = ridges[taken[nearest]].y if nearest in taken else np.float32(np.inf)
        if tracks[nearest].takes(ridge) and abs(expected[nearest] - ridge.y) < abs(expected[nearest] - rival):
            taken[nearest] = i
    return taken


def joined_shoulders(pixels: Pixels, ridges: Sequence[Ridge], outside: int) -> list[Ridge]:
    """A column's ridges, both shoulders of each flat top made one."""
    joined: list[Ridge] = []
    left = list(ridges)
    while left:
        here = left.pop(0)
        if left and is_plateau(pixels, here, left[0], outside):
            other = left.pop(0)
            y = np.float32(0.5) * (other.y + here.y)
            half = np.float32(0.5) * (other.y - here.y)
            here = here._replace(y=y, row=int(y + np.float32(0.5)), bend=-half)
        joined.append(here)
    return joined


def is_plateau(pixels: Pixels, a: Ridge, b: Ridge, outside: int) -> bool:
    """Whether the signal between two ridges of a column stays near their own height."""
    if not CLOSEST_SHOULDERS <= b.row - a.row <= FARTHEST_SHOULDERS:
        return False
    if a.response > 2 * b.response or b.response > 2 * a.response:
        return False
    column = pixels[:, a.x]
    base = max(column[max(a.row - outside, 0)], column[min(b.row + outside, len(column) - 1)])
    level = min(column[a.row], column[b.row])
    least = base + np.float32(PLATEAU_SHARE) * (level - base)
    return bool(level > base and (column[a.row + 1 : b.row] >= least).all())
