"""Tracks that may be one: pieces of a stripe that speckle, a glint or a bracket broke, on lines that could be the same.

Whether two pieces are one surface is not decided here. Their union stands beside them, with the scatter that it
has about one line, and the ring that explains it best chooses.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringpose.detect.tracks import Track
from ringpose.types.arrays import Array, Float64

LEAST_SPILT = 5
"""A track with fewer centres on its line beyond its ends has nothing to be joined to."""

LONGEST_GAP = 0.5
"""A gap of more than this share of both pieces together is no interruption."""

APART_PX, APART_SIGMAS = 1.0, 3.0
"""How far apart the lines may be in the middle of the gap: facets behind a stripe, and their own errors."""

FARTHEST_PX = 6.0
"""Lines farther apart than this are not compared any further."""

ROUNDS = 2
"""Pieces of three or four are joined two by two."""


def collinear_tracks(tracks: Sequence[Track]) -> list[Track]:
    """The unions of tracks that could be pieces of one stripe; none where nothing lies on the tracks' lines."""
    pieces = [track for track in tracks if track.spilt >= LEAST_SPILT and not track.clipped]
    unions: list[Track] = []
    left = pieces
    for _ in range(ROUNDS):
        left = [union(left[i], pieces[j]) for i, j in _near(left, pieces) if _meet(left[i], pieces[j])]
        unions += left
    return unions


def _near(left: Sequence[Track], right: Sequence[Track]) -> list[tuple[int, int]]:
    """Which tracks of the right begin not far from the end of which of the left, about on their lines."""
    if not left or not right:
        return []
    first, second = _table(left)[:, :, None], _table(right)[:, None]
    gap = second[1] - first[2]
    middle = first[2] + gap / 2
    apart = first[4] + first[5] * (middle - first[3]) - second[4] - second[5] * (middle - second[3])
    lengths = first[2] - first[1] + second[2] - second[1]
    near = (first[0] == second[0]) & (gap > 0) & (gap <= LONGEST_GAP * lengths) & (np.abs(apart) < FARTHEST_PX)
    return [(i, j) for i, j in np.argwhere(near).tolist()]


def _table(tracks: Sequence[Track]) -> Float64[Array, "field=6 track"]:
    """Laser, start, end, middle and slope of tracks."""
    rows = [(t.laser, t.x_start, t.x_end, t.middle_x, t.middle_y, t.slope) for t in tracks]
    return np.array(rows, dtype=np.float64).T


def _meet(first: Track, second: Track) -> bool:
    """Whether the second track, which lies to the right, can be on the first one's line."""
    middle = (first.x_end + second.x_start) / 2
    sigma = math.hypot(first.sigma(middle), second.sigma(middle))
    return abs(first.y(middle) - second.y(middle)) < APART_PX + APART_SIGMAS * sigma


def union(first: Track, second: Track) -> Track:
    """One track of both: the line and the scatter that all their centres together have."""
    parts = (first, second)
    count = first.count + second.count
    middle_x = sum(part.count * part.middle_x for part in parts) / count
    middle_y = sum(part.count * part.middle_y for part in parts) / count
    xx = xy = yy = 0.0
    for part in parts:
        dx, dy, own = part.middle_x - middle_x, part.middle_y - middle_y, max(part.length, 1.0) ** 2 / 12
        xx += part.count * (own + dx * dx)
        xy += part.count * (own * part.slope + dx * dy)
        yy += part.count * (own * part.slope**2 + part.scatter**2 + dy * dy)
    slope = xy / xx
    return replace(
        first,
        count=count,
        x_end=second.x_end,
        middle_x=middle_x,
        middle_y=middle_y,
        slope=slope,
        scatter=math.sqrt(max(yy - slope * xy, 0.0) / count),
        correlation=max(first.correlation, second.correlation),
        clipped=first.clipped or second.clipped,
        spilt=max(first.spilt - second.count, 0) + max(second.spilt - first.count, 0),
    )
