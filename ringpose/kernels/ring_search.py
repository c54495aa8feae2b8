"""Gauss and Newton's steps to the most likely ring of stripes and break points, behind a typed function.

The search in `ringpose.pose.likelihood` also covers what is rarer: points without a line, and shots that leave
something open.
"""

from typing import NamedTuple

import numpy as np

from ringpose.kernels import _search
from ringpose.kernels.ring_rows import Predicted, prediction_in
from ringpose.types.arrays import Array, Float64

FAILED = 0
"""The status of a search that leaves what rings are like, or for which there is no next step."""

_HEAD = 1 + 9 + 2 * 49


class Sought(NamedTuple):
    """What there is to explain."""

    rays: Float64[Array, "sight xyz=3"]
    light: Float64[Array, "sight 4"]
    """Normal and distance of each sight's light plane."""
    whitening: Float64[Array, "end end"]
    points: Float64[Array, "point 2"]
    """Sign of each point's edge, standard deviation of its abscissa."""
    edge_rays: Float64[Array, "visible xyz=3"]
    """Points of the ring's visible edges."""
    edges: Float64[Array, "visible 3"]
    """Sign of each one's edge, displacement by a standard deviation across it."""
    radii: Float64[Array, "2 edge=2"]
    """Radii known beforehand and their standard deviations, NaN if not."""

    @property
    def rows(self) -> int:
        """Number of residuals."""
        return len(self.rays) + len(self.edges) + int(np.count_nonzero(self.radii[0] == self.radii[0]))


class Started(NamedTuple):
    """Where a search may begin."""

    plane: Float64[Array, "3"]
    """q of q . P = 1."""
    outward: Float64[Array, "3"]
    """From inner towards outer break points, on that plane."""
    along_m: Float64[Array, "point"]
    """How far out each break point is."""


def started(
    rays: Float64[Array, "sight xyz=3"],
    light: Float64[Array, "sight 4"],
    whitening: Float64[Array, "end end"],
    points: Float64[Array, "point 2"],
    middle_x: Float64[Array, "point"],
) -> Started | None:
    """The plane of stripes, and where out is on it; None if there is none before the camera.

    The arguments are as in `Sought`; `middle_x` is the middle of each point's stripe.
    """
    found = np.frombuffer(_search.start(rays, light, whitening, points, middle_x), dtype=np.float64)
    return Started(found[:3], found[3:6], found[6:]) if len(found) else None


class SearchRules(NamedTuple):
    """When a search ends, and what is no ring."""

    huber_sigmas: float
    step_sigmas: float
    ridge: float
    least_depth_m: float
    most_depth_m: float
    steepest: float


class Searched(NamedTuple):
    """Where a search has come to; the last rows are those of the state before the last step."""

    failed: bool
    state: Float64[Array, "9"]
    normal_matrix: Float64[Array, "7 7"]
    inverse: Float64[Array, "7 7"]
    """With the ridge."""
    error_step: Float64[Array, "error"]
    """The most likely common errors."""
    weight: Float64[Array, "row"]
    left: Float64[Array, "row"]
    """Residuals that the last step is expected to leave."""
    residual: Float64[Array, "row"]
    by_state: Float64[Array, "row 7"]
    prediction: Predicted


def searched(
    state: Float64[Array, "9"],
    sought: Sought,
    rules: SearchRules,
    steps: tuple[int, int],
    common: Float64[Array, "common error"] | None = None,
    left: Float64[Array, "row"] | None = None,
) -> Searched:
    """Steps of these numbers, from a state: plane 3, outward 3, shift_m, curvature, band_m.

    The first step of all, number 0, weighs the residuals as they are and does not end the search; a later one weighs
    what the one before is expected to leave. `common` are the residuals' derivatives by errors that they have in
    common.
    """
    rows, errors = sought.rows, 0 if common is None else common.shape[1]
    found = np.frombuffer(
        _search.search(
            state,
            *sought,
            np.empty((rows, 0)) if common is None else np.ascontiguousarray(common),
            np.zeros(rows) if left is None else left,
            np.array(rules),
            *steps,
        ),
        dtype=np.float64,
    )
    at = _HEAD + errors
    return Searched(
        failed=bool(found[0] == FAILED),
        state=found[1:10],
        normal_matrix=found[10:59].reshape(7, 7),
        inverse=found[59:_HEAD].reshape(7, 7),
        error_step=found[_HEAD:at],
        weight=found[at : at + rows],
        left=found[at + rows : at + 2 * rows],
        residual=found[at + 2 * rows : at + 3 * rows],
        by_state=found[at + 3 * rows : at + 10 * rows].reshape(-1, 7),
        prediction=prediction_in(found[at + 10 * rows :], len(sought.rays), len(sought.points)),
    )
