"""The most likely ring: Gauss-Newton on the rows of method(7), section 5, robust against ends at the wrong place.

No start from the paper's closed form is needed: on the plane the inverse depth is linear in the image, so the lines
give the plane at once, and in this state every ring is within a few steps of a likely one.

Where the search for the most likely ring begins.
"""

from math import hypot, isfinite
from typing import NamedTuple

import numpy as np

from ringpose.geometry.robust import huber_weights
from ringpose.pose.measurements import Measurements, Observations
from ringpose.pose.nuisance import ByRig, RigErrors, rows_by_common_errors
from ringpose.pose.residuals import (
    CURVATURE,
    LIKELY_BAND_M,
    LIKELY_CURVATURE,
    PARAMETERS,
    TURN,
    Prior,
    RingState,
    Rows,
    Sights,
    cross,
    moved,
    rows_of,
    sights_of,
)
from ringpose.types.arrays import Array, Float64
from ringpose.types.rig import Rig

HUBER_SIGMAS = 3.0
"""From here a break point's or a visible edge's residual counts linearly; 0.3 % of honest ones are beyond."""

MAX_STEPS = 15

STRIPES_OF_A_PLANE = 2
"""Fewer leave the tilt about the stripe to the edges."""

STEP_SIGMAS = 1e-4
"""A step of less than this in standard deviations is the last."""

RIDGE = 1e-7
"""Added to the normal matrix (metres, radians, one over metres), so that what is not determined stays put."""

_RIDGE = RIDGE * np.eye(PARAMETERS)

MIN_DEPTH_M, MAX_DEPTH_M = 1e-3, 1e3
"""A plane outside is none."""

STEEPEST_CURVATURE = 20.0
"""One over metres: a search that leaves these bounds has failed."""


class Fit(NamedTuple):
    """A solution and what it rests on."""

    state: RingState
    rows: Rows
    weight: Float64[Array, "row"]
    """Of the robust loss: 1 for a residual within `HUBER_SIGMAS`."""
    by_rig: Float64[Array, "row error"] | None
    """Derivatives by unit errors of the rig; None where they are not known."""
    mean_by_rig: Float64[Array, "error"] | None
    """The same of the mean of the break points, along the band."""
    rig_step: Float64[Array, "error"] | None
    """The rig's most likely errors, in their standard deviations."""
    weak: bool
    """Whether what the shot leaves open was held to what rings are like."""
    normal_matrix: Float64[Array, "7 7"]
    """Inverse covariance of the state if no residual is beyond the robust limit; the rig's errors are in it."""
    inverse: Float64[Array, "7 7"]
    """Of that, what is not determined at all held by `RIDGE`."""

    @property
    def residual(self) -> Float64[Array, "row"]:
        """What the ring and the rig's most likely errors leave, in standard deviations."""
        if self.by_rig is None or self.rig_step is None:
            return self.rows.residual
        left: Float64[Array, "row"] = self.rows.residual + self.by_rig @ self.rig_step
        return left


class Task(NamedTuple):
    """What a ring is to explain, and by which rig it was seen."""

    measured: Measurements
    sighted: Observations
    rig: Rig
    errors: RigErrors | None


def fitted(measured: Measurements, rig: Rig, before: Prior, errors: RigErrors | None) -> Fit | None:
    """The most likely ring; None if the search ends nowhere.

    What the shot leaves open (one stripe: the tilt about it; two: the curvature) is held to what rings are like in a
    second search, so that it cannot spoil the rest. Where visible edges close such a gap, the search begins from that:
    far from the ring they lead astray.
    """
    with np.errstate(all="ignore"):  # a search that leaves all bounds ends in `_plausible`
        return _fitted(measured, rig, before, errors)


def _fitted(measured: Measurements, rig: Rig, before: Prior, errors: RigErrors | None) -> Fit | None:
    before = before._replace(one_edge=before.radii is None and _edges_seen(measured) == 1)
    task = Task(measured, measured.sighted(rig.lasers), rig, errors)
    start = starting_state(measured, task.sighted, before)
    if start is not None and len(measured.edges.edge) and len(measured.lines.laser) < STRIPES_OF_A_PLANE:
        held = _search(start, task, before._replace(regularize_about=start))
        start = start if held is None else held.state
    fit = None if start is None else _search(start, task, before)
    if start is not None and (fit is None or _leaves_open(fit)):
        fit = _search(start, task, before._replace(regularize_about=start))
    if fit is not None and fit.state.curvature < 0 and _unsure_of_side(measured, before):
        turned = fit.state._replace(
            outward=-fit.state.outward, curvature=-fit.state.curvature, shift_m=-fit.state.shift_m
        )
        fit = _search(turned, task, before) or fit
    return fit


def _leaves_open(fit: Fit) -> bool:
    """Whether something is known worse from the shot than beforehand."""
    variance = fit.inverse.diagonal().tolist()
    tilt_squared = max(variance[:2]) / float(fit.state.plane @ fit.state.plane)
    return bool(max(tilt_squared, variance[TURN]) > 0.25 or variance[CURVATURE] > 1.0)


def _unsure_of_side(measured: Measurements, before: Prior) -> bool:
    """Whether a single edge, without a line on the face beside it, leaves open which of its sides is out."""
    return before.one_edge and bool(measured.points.alone.all())


def _edges_seen(measured: Measurements) -> int:
    return len({*measured.points.edge.tolist(), *measured.edges.edge.tolist()})


def _search(state: RingState, task: Task, before: Prior) -> Fit | None:
    """Gauss-Newton steps from a state; None if they lead to no ring. Common errors enter after the first step."""
    measured, sighted, rig, errors = task
    robust = _robust_rows(measured)
    common: ByRig | None = None
    left = None
    for number in range(MAX_STEPS):
        rows = rows_of(state, measured, sighted, before)  # r and J, whitened: residuals a to d
        if number == 1:  # they hardly change from here
            common = rows_by_common_errors(state, rows, measured, sighted, errors, rig)
        # weights by what the last step is expected to leave: at its start wrong ends hide among large residuals
        weight = _weights(rows.residual if left is None else left, robust)
        try:
            normal_matrix, step, rig_step = _step(rows, weight, None if common is None else common.rows)
        except np.linalg.LinAlgError:
            return None
        if not _plausible(state, step):
            return None
        if number and step @ normal_matrix @ step < STEP_SIGMAS**2:  # squared Mahalanobis length
            break
        left = rows.residual + rows.by_state @ step
        if common is not None and rig_step is not None:
            left = left + common.rows @ rig_step
        state = moved(state, step)
    inverse = _inverse(normal_matrix)
    if inverse is None:
        return None
    by_rig, mean_by_rig = (None, None) if common is None else common
    return Fit(
        state, rows, weight, by_rig, mean_by_rig, rig_step, before.regularize_about is not None, normal_matrix, inverse
    )


def _inverse(normal_matrix: Float64[Array, "7 7"]) -> Float64[Array, "7 7"] | None:
    """None where the normal matrix is numerically singular: rounding then leaves a variance that is not positive."""
    try:
        inverse = np.linalg.inv(normal_matrix + _RIDGE)
    except np.linalg.LinAlgError:
        return None
    return inverse if bool((inverse.diagonal() > 0).all()) else None


def _step(
    rows: Rows, weight: Float64[Array, "row"], by_rig: Float64[Array, "row error"] | None
) -> tuple[Float64[Array, "7 7"], Float64[Array, "7"], Float64[Array, "error"] | None]:
    """Normal matrix with the rig's errors eliminated, the ring's step, and the rig's errors after it.

    With J by the ring and B by unit errors of the rig: S = J^T W J - J^T W B (1 + B^T W B)^-1 B^T W J, the Schur
    complement, and S step = -(J^T W r - J^T W B (1 + B^T W B)^-1 B^T W r).
    """
    weighted = rows.by_state.T * weight
    normal_matrix, gradient = weighted @ rows.by_state, weighted @ rows.residual
    if by_rig is None:
        return normal_matrix, -np.linalg.solve(normal_matrix + _RIDGE, gradient), None
    weighted_by_rig = by_rig.T * weight
    own = weighted_by_rig @ by_rig
    own.flat[:: len(own) + 1] += 1.0
    mixed = np.empty((len(own), PARAMETERS + 1))
    mixed[:, :-1], mixed[:, -1] = weighted_by_rig @ rows.by_state, weighted_by_rig @ rows.residual
    from_ring = np.linalg.solve(own, mixed)
    eliminated = mixed[:, :-1].T @ from_ring
    normal_matrix = normal_matrix - eliminated[:, :-1]
    step = -np.linalg.solve(normal_matrix + _RIDGE, gradient - eliminated[:, -1])
    return normal_matrix, step, -from_ring[:, -1] - from_ring[:, :-1] @ step


def _robust_rows(measured: Measurements) -> slice:
    """Break points and visible edges; lines are fitted robustly before, and have no third end to check them."""
    first = 2 * len(measured.lines.laser)
    count = len(measured.points.laser) + int(measured.points.alone.sum()) + len(measured.edges.edge)
    return slice(first, first + count)


def _weights(residual: Float64[Array, "row"], robust: slice) -> Float64[Array, "row"]:
    weight = np.ones(len(residual))
    weight[robust] = huber_weights(residual[robust], HUBER_SIGMAS)
    return weight


def _plausible(state: RingState, step: Float64[Array, "7"]) -> bool:
    depth = hypot(*(state.plane + step[:3]).tolist())
    curvature = abs(state.curvature + float(step[CURVATURE]))
    return (
        all(map(isfinite, step.tolist()))
        and 1 / MAX_DEPTH_M < depth < 1 / MIN_DEPTH_M
        and (curvature < STEEPEST_CURVATURE)
    )


MIN_LENGTH_M = 1e-9
"""A direction of less than this is none."""


def starting_state(measured: Measurements, sighted: Observations, before: Prior) -> RingState | None:
    """The plane of the stripes, and a likely ring on it; None if there is none before the camera."""
    if not len(measured.points.x):
        return None
    try:
        plane = _plane(measured, sighted)
    except np.linalg.LinAlgError:
        return None
    state = RingState(plane, np.array([1.0, 0.0, 0.0]), 0.0, LIKELY_CURVATURE, 0.0)
    sights = sights_of(state, sighted)
    inverse_depth = sights.rays @ plane
    if not bool((inverse_depth > 0).all()):
        return None
    depth_m = 1.0 / inverse_depth
    ends = len(sighted.whitening)
    outward = _outward(state, measured, sighted, _along_stripes(sights, depth_m, plane)[ends:], depth_m[ends:])
    along = depth_m[ends:] * (sights.rays[ends:] @ outward)
    curvature, band_m = _likely_size(measured, along, before)
    return RingState(plane, outward, 0.0, curvature, band_m)


def _likely_size(measured: Measurements, along_m: Float64[Array, "point"], before: Prior) -> tuple[float, float]:
    """Curvature and width of the band."""
    by_edge: tuple[list[float], list[float]] = ([], [])
    for edge, along in zip(measured.points.edge.tolist(), along_m.tolist(), strict=True):
        by_edge[edge].append(along)
    inner, outer = by_edge
    band_m = sum(outer) / len(outer) - sum(inner) / len(inner) if inner and outer else LIKELY_BAND_M
    if before.radii is None or not np.isfinite(before.radii.radius_m).any():
        return LIKELY_CURVATURE, band_m
    inner_m, outer_m = before.radii.radius_m.tolist()
    whole = np.isfinite(outer_m - inner_m)
    return 1.0 / float(np.nanmean(before.radii.radius_m)), outer_m - inner_m if whole else band_m


def _plane(measured: Measurements, sighted: Observations) -> Float64[Array, "3"]:
    """The q that fits the stripes: (m . r - d q . r) / (m - d q)_y is linear in q but for its weak denominator."""
    ends, count = len(sighted.whitening), len(sighted.rays)
    whitening = np.zeros((count, count))
    whitening[:ends, :ends] = sighted.whitening
    alone = ends + np.flatnonzero(measured.points.alone)
    whitening[alone, alone] = 1.0 / np.sqrt(measured.points.covariance[alone - ends, 1, 1])
    cosine = (sighted.light_normal * sighted.rays).sum(axis=1)
    plane = np.array([0.0, 0.0, float((cosine / sighted.light_distance_m).sum()) / count])
    for _ in range(2):
        denominator = sighted.light_normal[:, 1] - sighted.light_distance_m * plane[1]
        rows = whitening @ ((sighted.light_distance_m / denominator)[:, None] * sighted.rays)
        matrix = rows.T @ rows
        matrix[[0, 1], [0, 1]] += 1.0 / plane[2] ** 2  # one stripe alone: a face that looks at the camera
        plane = np.linalg.solve(matrix, rows.T @ (whitening @ (cosine / denominator)))
    return plane


def _along_stripes(
    sights: Sights, depth_m: Float64[Array, "sight"], plane: Float64[Array, "3"]
) -> Float64[Array, "sight 3"]:
    """How points of the plane move when they go along their stripes in the image."""
    rate = depth_m * (plane[0] + sights.slope * plane[1])
    moved = -rate[:, None] * sights.rays
    moved[:, 0] += 1.0
    moved[:, 1] += sights.slope
    along: Float64[Array, "sight 3"] = depth_m[:, None] * moved
    return along


def _outward(
    state: RingState,
    measured: Measurements,
    sighted: Observations,
    by_x: Float64[Array, "point 3"],
    depth_m: Float64[Array, "point"],
) -> Float64[Array, "3"]:
    """From inner towards outer ends, seen from the middles of their stripes."""
    points = measured.points
    direction = (sighted.edge_sign * (points.x - points.middle_x)) @ by_x
    if float(direction @ direction) < MIN_LENGTH_M**2:
        ends = sighted.rays[[-1, -len(points.x)]] * depth_m[[-1, 0], None]
        direction = cross(state.normal, ends[0] - ends[1])
    if float(direction @ direction) < MIN_LENGTH_M**2:
        direction = by_x[0]
    direction = direction - (direction @ state.normal) * state.normal
    unit: Float64[Array, "3"] = direction / np.sqrt(direction @ direction)
    return unit
