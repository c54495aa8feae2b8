"""The kernel that looks for the ring's face among tracks, behind a typed function."""

import math
from typing import NamedTuple

import numpy as np

from ringpose.kernels import _faces
from ringpose.kernels.ring import TRACK_COLUMNS
from ringpose.types.arrays import Array, Float64


class UnionRules(NamedTuple):
    """Which tracks may be pieces of one stripe, and are tried as one beside themselves."""

    least_spilt: float
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
    least_columns: float
    """and the least that are left."""


class CandidateRules(NamedTuple):
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


class RingRules(NamedTuple):
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


class FaceRules(NamedTuple):
    """What a face is held against."""

    unions: UnionRules
    candidates: CandidateRules
    ring: RingRules


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
    rules: FaceRules,
) -> Faces:
    """The best groups of one, two and three tracks, each under a laser of its own, that one planar ring explains.

    `unlabelled` is the mask of the lasers that tracks without a laser may belong to. `planes` are the light planes as
    m / d, so that 1/z = (m / d) . (x, y, 1) on them. Pieces of a line that may be one are tried as one, too. The
    score is the sum of the merits less the costs of plane, circles, unseen lasers, and tilt (half the square of tilt
    over 0.5 rad).
    """
    every, (one, two, three) = _faces.faces(tracks, unlabelled, planes, rules)
    groups = Group(*one), Group(*two), Group(*three)
    return Faces(np.frombuffer(every, np.float64).reshape(-1, len(TRACK_COLUMNS)), groups)
