"""The kernels that look for the ring among the stripes, behind typed functions; twins in `reference_ring`."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ringpose.types.arrays import Array, Float64, Int32, Int64, UInt

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
    left_x: float = -math.inf
    """Ends beyond this normalised x, or ..."""
    right_x: float = math.inf
    """... this are cut off by the image's border and on no circle."""


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


class EndRules(NamedTuple):
    """What finds the end of a stripe."""

    saturation_dn: float
    beyond_columns: float
    """Columns beyond a track in which its end is looked for."""
    inside_columns: float
    """Columns of the face that set its level before the edge."""
    outside_columns: float
    """Columns beyond the edge that set the level there."""
    flank_sigmas: float
    """Rows on both sides of the line that are looked at, in sigmas of the stripe."""
    flanks_share: float
    """Share of columns with a saturated pixel above which a stripe is read by its flanks."""
    undimmed_level: float
    """Share of the face's level above which the stripe still goes on."""
    least_headroom: float
    """Columns that saturation leaves less of than this say nothing about the stripe's level."""
    speckle_columns: float
    """Columns that share a grain of speckle."""
    grain_factor: float
    """Shift of the edge by the last grain, in its contrast times the edge's width."""
    shape_sigma: float
    """Columns by which an edge's position depends on how its blur is modelled."""
    saturated_share: float
    """Share of saturated columns above which `hidden_speckle` is assumed."""
    hidden_speckle: float
    texture_factor: float
    """What a column's section leaves unexplained, times this, is what it errs by."""
    near_columns: float
    """Columns beyond the edge in which the level there must be the one that was fitted."""
    most_excess: float
    """No end says more than this (in log likelihood) about the width that all share."""
    width_spread: float
    """Relative standard deviation of an edge's width about that."""
    blunt_gain: float
    """Gain in log likelihood by widths beyond that of the stripe's section, of all ends, above which ends are blunt."""


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
"""What `straight_tracks` says of each track; `spilt`: centres on its line between 2 px and the track's length
(at most 100 px) + 40 px beyond its ends."""


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
    found = _ring.tracks(column, row, np.ascontiguousarray(sigma_px), piece, laser, _numbers(lens), _numbers(rules))
    return np.frombuffer(found, dtype=np.float64).reshape(-1, len(TRACK_COLUMNS))


def stripe_ends(
    lit: UInt[Array, "row column"],
    dark: UInt[Array, "row column"] | None,
    lines: Float64[Array, "track column=5"],
    lens: Lens,
    rules: EndRules,
) -> Float64[Array, "track end=2 column=10"]:
    """Left and right end of the stripe on each line, to a fraction of a column.

    Lines are middle_x, middle_y, slope, x_start, x_end in undistorted pixels. The stripe's brightness along its line
    (the Gaussian section that fits each column best) is compared with a level inside, a level outside, and an error
    function between; the most likely position, width and levels win, widths near that which suits all ends best.
    Columns of the result: x, y and slope of the line there (distorted pixels), sigma along x, the level outside as a
    share of that inside, the share of saturated columns at the end, the edge's width, the sigma of the stripe's
    section, whether the edge is blunt, and the relative variance of the peaks by what lies beneath the stripe; NaN
    where no edge fits.
    """
    black = None if dark is None else np.ascontiguousarray(dark)
    found = _ring.ends(np.ascontiguousarray(lit), black, np.ascontiguousarray(lines), _numbers(lens), _numbers(rules))
    return np.frombuffer(found, dtype=np.float64).reshape(-1, 2, 10)


class ArcFit(NamedTuple):
    """How well points fit two arcs about one centre."""

    cost: float
    """Squared sigmas over two of all points."""
    cost_without: Float64[Array, "n"]
    """The same with each point left out."""
    curvature: float
    """One over the radius; positive if the centre lies on the side of positive x."""
    curvature_sigma: float


def arc_fit(
    position_px: Float64[Array, "n xy=2"],
    arc: Int32[Array, "n"],
    along_sigma_px: Float64[Array, "n"],
    planes: Float64[Array, "n normal_and_distance=4"],
    lens: Lens,
    circle_sigma_px: float,
) -> ArcFit:
    """How well at most 64 points, each seen on a light plane, fit two arcs about one centre.

    In the plane nearest to them, arcs a (x^2 + y^2) + x + b y + c_arc = 0 are fitted by least squares along x, which
    runs along the image's rows. Costs count distances in the points' sigmas along x and `circle_sigma_px` together;
    the curvature's sigma follows from moving each point by the former.
    """
    found = _ring.arcs(np.ascontiguousarray(position_px), arc, along_sigma_px, planes, _numbers(lens), circle_sigma_px)
    numbers = np.frombuffer(found, dtype=np.float64)
    return ArcFit(float(numbers[0]), numbers[1:-2], float(numbers[-2]), float(numbers[-1]))


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
    found = _ring.groups(track, laser, ends.reshape(-1, 4), merit, np.ascontiguousarray(planes), _numbers(rules))
    one, two, three = (
        Group((first, second, third)[:size], score, rival)
        for size, (first, second, third, score, rival) in enumerate(found, start=1)
    )
    return one, two, three


@lru_cache(maxsize=32)
def _numbers(values: tuple[int | float, ...]) -> Float64[Array, "n"]:
    """Rules or a lens as the kernels read them: the same ones for shot after shot."""
    numbers = np.array(values, dtype=np.float64)
    numbers.flags.writeable = False
    return numbers
