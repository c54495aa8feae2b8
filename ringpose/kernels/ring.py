"""The kernels that look for the ring among the stripes, behind typed functions; twins in `reference_ring`."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int32, Int64

from ringpose.types.arrays import Array

try:
    from ringpose.kernels import _ring
except ImportError as error:
    raise ImportError(
        "ringpose.kernels: the C kernels are not built for this Python; run `pip install .` where ringpose's source is"
        " (a C compiler is needed)"
    ) from error


class RingRules(NamedTuple):
    """What groups of tracks are held against; costs are squared sigmas over two."""

    focal_x: float
    focal_y: float
    principal_y: float
    image_height: float
    border_px: float
    """Closer to the upper or lower border a stripe may well be missed."""
    along_sigma_px: float
    """How far a track's end may lie from its circle."""
    across_sigma_px: float
    """How far a track may lie from the plane's line."""
    plane_limit: float
    """Cost above which tracks do not lie on one plane, for each track."""
    circle_limit: float
    """Cost above which ends do not lie on two circles, for each track."""
    dropped_end_cost: float
    """What it costs to call one of six ends occluded."""
    unseen_cost: float
    """What it costs that a laser's stripe is not seen where the plane would show it."""
    maximum_tilt_rad: float
    minimum_radius_m: float
    minimum_band_m: float


class TrackRules(NamedTuple):
    """What cuts, joins and judges tracks."""

    kink_px: float
    """A piece that leaves its chord by more than this (and one and a half sigmas of its centres) is cut there."""
    joined_px: float
    """Tracks whose lines meet this closely across a gap (and two of their sigmas) are one."""
    short_series: float
    """Factor on a correlation length found in the residuals of a fitted line."""
    on_line_px: float
    """Centres so close to a track's line count as on it."""
    border_px: float
    """A track with an end so close to the image's left or right border is clipped."""
    minimum_columns: float
    image_width: float
    longest_lag: float
    """Columns over which errors of neighbouring centres are looked at for likeness."""


class Lens(NamedTuple):
    """OpenCV's pinhole and distortion."""

    fx: float
    fy: float
    cx: float
    cy: float
    k1: float
    k2: float
    p1: float
    p2: float
    k3: float
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0


TRACK_COLUMNS = (
    "laser", "count", "x_start", "x_end", "middle_x", "middle_y", "slope", "scatter", "correlation", "clipped", "spilt",
)  # fmt: skip
"""What `straight_tracks` says of each track; `spilt`: centres on its line within 1.5 lengths + 40 px of its middle
that lie more than 2 px beyond its ends."""


def straight_tracks(
    position_px: Float64[Array, "center xy=2"],
    sigma_px: Float64[Array, "center"],
    piece: Int64[Array, "center"],
    laser: Int64[Array, "piece"],
    lens: Lens,
    rules: TrackRules,
) -> Float64[Array, "track column=11"]:
    """Straight lines y = middle_y + slope (x - middle_x) through stripe centres, in undistorted pixels.

    Pieces are cut at their kinks (Ramer's method on running medians of seven) and joined across gaps; each line is a
    least-squares fit, a second one without outliers. Centres are sorted by piece, then column.
    """
    column, row = np.ascontiguousarray(position_px.T)
    numbers = (np.array(lens, dtype=np.float64), np.array(rules, dtype=np.float64))
    found = _ring.tracks(column, row, np.ascontiguousarray(sigma_px), piece, laser, *numbers)
    return np.frombuffer(found, dtype=np.float64).reshape(-1, len(TRACK_COLUMNS))


class Group(NamedTuple):
    """The best group of a size."""

    candidates: tuple[int, ...]
    score: float
    """Minus infinity if no group is possible."""
    rival: float
    """Best score of the same tracks under other lasers."""


def best_groups(
    track: Int32[Array, "candidate"],
    laser: Int32[Array, "candidate"],
    ends: Float64[Array, "candidate end=2 xy=2"],
    merit: Float64[Array, "candidate"],
    planes: Float64[Array, "laser xyz=3"],
    rules: RingRules,
) -> tuple[Group, Group, Group]:
    """The best groups of one, two and three candidates (tracks under a laser) that one planar ring explains.

    Candidates are sorted by laser; a group has different lasers and different tracks. `ends` are normalised image
    coordinates, `planes` the light planes as m / d, so that 1/z = (m / d) . (x, y, 1) on them. The score is the sum
    of the merits less the costs of plane, circles, unseen lasers, and tilt (half the square of tilt over 0.5 rad).
    """
    found = _ring.groups(
        track, laser, ends.reshape(-1, 4), merit, np.ascontiguousarray(planes), np.array(rules, dtype=np.float64)
    )
    one, two, three = (
        Group((first, second, third)[:size], score, rival)
        for size, (first, second, third, score, rival) in enumerate(found, start=1)
    )
    return one, two, three
