"""Straight tracks through stripe centres, which of them lie on the ring, and arcs through their ends."""

import math
from typing import NamedTuple

import numpy as np

from ringpose.kernels import _kernels
from ringpose.types.arrays import Array, Float64, Int64


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


class TrackParams(NamedTuple):
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


TRACK_COLUMNS = (
    "laser", "centers", "x_start", "x_end", "middle_x", "middle_y",
    "slope", "scatter", "correlation", "clipped", "spilt",
)  # fmt: skip
"""What `stripe_line_segments` says of each track; `spilt`: centres on its line between 2 px and the track's length
(at most 100 px) + 40 px beyond its ends."""

LASER, CENTERS, X_START, X_END, MIDDLE_X, MIDDLE_Y, SLOPE, SCATTER, CORRELATION, CLIPPED, SPILT = range(
    len(TRACK_COLUMNS)
)


def stripe_line_segments(
    position_px: Float64[Array, "center xy=2"],
    sigma_px: Float64[Array, "center"],
    piece: Int64[Array, "center"],
    laser: Int64[Array, "piece"],
    lens: Lens,
    rules: TrackParams,
) -> Float64[Array, "track column=11"]:
    """Straight lines y = middle_y + slope (x - middle_x) through stripe centres, in undistorted pixels.

    Pieces are cut at their kinks (Ramer's method on running medians of seven) and joined across gaps; each line is a
    least-squares fit, a second one without outliers. Centres are sorted by piece, then column.
    """
    position, sigma = np.ascontiguousarray(position_px), np.ascontiguousarray(sigma_px)
    found = _kernels.tracks(position, sigma, piece, laser, lens, rules)
    return np.frombuffer(found, dtype=np.float64).reshape(-1, len(TRACK_COLUMNS))


class UnionParams(NamedTuple):
    """Which tracks may be pieces of one stripe, and are tried as one beside themselves."""

    min_spilt: float
    """A track with fewer centres on its line beyond its ends has nothing to be joined to."""
    longest_gap: float
    """Longest gap, as a share of both tracks together."""
    apart_px: float
    """How far apart the lines may be in the middle of the gap,"""
    apart_sigmas: float
    """and how many of their sigmas more."""
    farthest_px: float
    """Lines farther apart are none, whatever their sigmas."""
    rounds: float
    """Each joins what the one before has joined to one more track."""
    taken_by_fit: float
    """Independent columns that a line's fit takes,"""
    min_columns: float
    """and the least that are left."""


class CandidateParams(NamedTuple):
    """Which tracks may be the face, and which of them are tried for each laser."""

    nearest_m: float
    farthest_m: float
    """Depth of a face."""
    shortest_m: float
    longest_m: float
    """Length of a stripe on it."""
    usual_scatter_px: float
    """Half its square over two is what a track's merit loses for its scatter; it gains twice the logarithm of ..."""
    enough_columns: float
    """... its columns, but no more than for these."""
    spill_cost: float
    """What it costs if all centres on a track's line lie beyond the track, but no more than ..."""
    coincidence_cost: float
    """... this if another laser's stripe would lie there on a body behind the face, by ..."""
    behind_least_m: float
    behind_most_m: float
    """... so much in depth."""
    clipped_cost: float
    """What it costs that a track leaves the image."""
    union_cost: float
    """What it costs that a track is put together."""
    most: float
    """Tracks of the greatest merit that are tried for each laser."""


class RingParams(NamedTuple):
    """What groups of tracks are held against; costs are squared sigmas over two."""

    focal_x: float
    focal_y: float
    principal_x: float
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
    """... this, or ..."""
    top_y: float = -math.inf
    """... beyond this normalised y, or ..."""
    bottom_y: float = math.inf
    """... this are cut off by the image's border and on no circle."""


class FaceParams(NamedTuple):
    """What a face is held against."""

    unions: UnionParams
    candidates: CandidateParams
    ring: RingParams


class Group(NamedTuple):
    """The best group of a size: a track for each of some lasers."""

    lasers: tuple[int, ...]
    tracks: tuple[int, ...]
    """Numbers."""
    score: float
    """Minus infinity if no group is possible."""
    rival: float
    """Best score of the same tracks under other lasers."""


class Faces(NamedTuple):
    """What may be the ring's face."""

    tracks: Float64[Array, "n column=11"]
    """The given ones, and then those that were put together of them."""
    groups: tuple[Group, Group, Group]
    """Of one, two and three tracks."""


def ring_faces(
    tracks: Float64[Array, "track column=11"],
    unlabelled: int,
    planes: Float64[Array, "laser xyz=3"],
    rules: FaceParams,
) -> Faces:
    """The best groups of one, two and three tracks, each under a laser of its own, that one planar ring explains.

    `unlabelled` is the mask of the lasers that tracks without a laser may belong to. `planes` are the light planes as
    m / d, so that 1/z = (m / d) . (x, y, 1) on them. Pieces of a line that may be one are tried as one, too. The
    score is the sum of the merits less the costs of plane, circles, unseen lasers, and tilt (half the square of tilt
    over 0.5 rad).
    """
    every, (one, two, three) = _kernels.faces(
        np.ascontiguousarray(tracks), unlabelled, np.ascontiguousarray(planes), *rules
    )
    groups = Group(*one), Group(*two), Group(*three)
    return Faces(np.frombuffer(every, np.float64).reshape(-1, len(TRACK_COLUMNS)), groups)


class ArcFit(NamedTuple):
    """How well points fit two arcs about one centre."""

    seen: tuple[int, int]
    """Points on either arc."""
    cost: float
    """Squared sigmas over two of all points."""
    cost_without: tuple[float, ...]
    """The same with each point left out, laser by laser, left and right; infinite where there is none."""
    curvature: float
    """One over the radius; positive if the centre lies on the side of positive x."""
    curvature_sigma: float


def arc_fit(
    position_px: Float64[Array, "laser end=2 xy=2"],
    covariance_px2: Float64[Array, "laser end=2 xy=2 xy=2"],
    planes: Float64[Array, "laser normal_and_distance=4"],
    lens: Lens,
    circle_sigma_px: float,
    fitted_exactly: int,
) -> ArcFit:
    """How well the ends of stripes fit two arcs about one centre, one through the left ends, one through the right.

    In the plane nearest to them, arcs a (x^2 + y^2) + x + b y + c_arc = 0 are fitted by least squares along x, which
    runs along the image's rows. Costs count distances in the points' sigmas along x and `circle_sigma_px` together;
    the curvature's sigma follows from moving each point by the former, or by both where all points are no more than
    `fitted_exactly`. Ends that are NaN are none.
    """
    position, covariance, light = (np.ascontiguousarray(each) for each in (position_px, covariance_px2, planes))
    return ArcFit(*_kernels.arcs(position, covariance, light, lens, circle_sigma_px, fitted_exactly))
