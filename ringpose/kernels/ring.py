"""The kernels that look for the ring among the stripes, behind typed functions; twins in `reference_ring`."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int32

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
