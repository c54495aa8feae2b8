"""The most likely ring: Gauss-Newton on the rows of MATH.md section 5, robust against ends at the wrong place.

No start from the paper's closed form is needed: on the plane the inverse depth is linear in the image, so the lines
give the plane at once, and in this state every ring is within a few steps of a likely one.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from ringpose.pose.measurements import Measurements
from ringpose.pose.residual_rows import LIKELY_BAND_M, LIKELY_CURVATURE, Beforehand, Rows, rows_of
from ringpose.pose.rig_errors import ByRig, RigErrors, rows_by_rig
from ringpose.pose.ring_model import CURVATURE, PARAMETERS, TURN, RingState, cross, moved, point_parts
from ringpose.types.arrays import Array
from ringpose.types.laser_planes import LaserPlanes
from ringpose.types.rig import Rig

HUBER_SIGMAS = 3.0
"""From here a break point's or a visible edge's residual counts linearly; 0.3 % of honest ones are beyond."""

MOST_STEPS = 15

STEP_SIGMAS = 1e-4
"""A step of less than this in standard deviations is the last."""

RIDGE = 1e-7
"""Added to the normal matrix (metres, radians, one over metres), so that what is not determined stays put."""

LEAST_DEPTH_M, MOST_DEPTH_M = 1e-3, 1e3
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

    @property
    def residual(self) -> Float64[Array, "row"]:
        """What the ring and the rig's most likely errors leave, in standard deviations."""
        if self.by_rig is None or self.rig_step is None:
            return self.rows.residual
        left: Float64[Array, "row"] = self.rows.residual + self.by_rig @ self.rig_step
        return left

    @property
    def cost(self) -> float:
        """Sum of squared residuals, those of the rig included, robust."""
        size = np.abs(self.residual)
        robust = np.where(self.weight < 1.0, HUBER_SIGMAS * (2.0 * size - HUBER_SIGMAS), size**2)
        return float(robust.sum() + (0.0 if self.rig_step is None else self.rig_step @ self.rig_step))


def fitted(measured: Measurements, rig: Rig, before: Beforehand, errors: RigErrors | None) -> Fit | None:
    """The most likely ring; None if the search ends nowhere.

    What the shot leaves open (one stripe: the tilt about it; two: the curvature) is held to what rings are like in a
    second search, so that it cannot spoil the rest.
    """
    before = before._replace(one_edge=before.radii is None and _edges_seen(measured) == 1)
    start = starting_state(measured, rig.lasers, before)
    fit = None if start is None else _search(start, measured, rig, before, errors)
    if start is not None and (fit is None or _leaves_open(fit)):
        fit = _search(start, measured, rig, before._replace(weak_about=start), errors)
    if fit is not None and fit.state.curvature < 0 and _unsure_of_side(measured, before):
        turned = fit.state._replace(
            outward=-fit.state.outward, curvature=-fit.state.curvature, shift_m=-fit.state.shift_m
        )
        fit = _search(turned, measured, rig, before, errors) or fit
    return fit


def _leaves_open(fit: Fit) -> bool:
    """Whether something is known worse from the shot than beforehand."""
    variance = np.diag(np.linalg.inv(fit.normal_matrix + RIDGE * np.eye(PARAMETERS)))
    tilt = float(np.sqrt(max(variance[0], variance[1]))) / float(np.abs(fit.state.plane).max())
    return bool(tilt > 0.5 or variance[TURN] > 0.25 or variance[CURVATURE] > 1.0)


def _unsure_of_side(measured: Measurements, before: Beforehand) -> bool:
    """Whether a single edge, without a line on the face beside it, leaves open which of its sides is out."""
    return before.one_edge and bool(measured.points.alone.all())


def _edges_seen(measured: Measurements) -> int:
    return len({*measured.points.edge.tolist(), *measured.edges.edge.tolist()})


def _search(
    state: RingState, measured: Measurements, rig: Rig, before: Beforehand, errors: RigErrors | None
) -> Fit | None:
    robust = _robust_rows(measured)
    by_rig: ByRig | None = None
    left = None
    for _ in range(MOST_STEPS):
        rows = rows_of(state, measured, rig.lasers, before)
        if errors is not None and by_rig is None:
            by_rig = rows_by_rig(state, rows, measured, errors, rig)
        weight = _weights(rows.residual if left is None else left, robust)
        normal_matrix, step, rig_step = _step(rows, weight, None if by_rig is None else by_rig.rows)
        if not _plausible(state, step):
            return None
        left = rows.residual + rows.by_state @ step
        if by_rig is not None and rig_step is not None:
            left = left + by_rig.rows @ rig_step
        state = moved(state, step)
        if step @ normal_matrix @ step < STEP_SIGMAS**2:
            break
    rows = rows_of(state, measured, rig.lasers, before)
    if errors is None:
        return Fit(state, rows, weight, None, None, None, before.weak_about is not None, normal_matrix)
    by_rig = rows_by_rig(state, rows, measured, errors, rig)
    normal_matrix, _, rig_step = _step(rows, weight, by_rig.rows)
    return Fit(state, rows, weight, by_rig.rows, by_rig.mean, rig_step, before.weak_about is not None, normal_matrix)


def _step(
    rows: Rows, weight: Float64[Array, "row"], by_rig: Float64[Array, "row error"] | None
) -> tuple[Float64[Array, "7 7"], Float64[Array, "7"], Float64[Array, "error"] | None]:
    """Normal matrix with the rig's errors eliminated, the ring's step, and the rig's errors after it."""
    weighted = rows.by_state.T * weight
    normal_matrix, gradient = weighted @ rows.by_state, weighted @ rows.residual
    if by_rig is None:
        return normal_matrix, -np.linalg.solve(normal_matrix + RIDGE * np.eye(PARAMETERS), gradient), None
    mixed = weighted @ by_rig
    own = (by_rig.T * weight) @ by_rig
    own[np.diag_indices_from(own)] += 1.0
    from_ring = np.linalg.solve(own, np.column_stack([mixed.T, by_rig.T @ (weight * rows.residual)]))
    normal_matrix = normal_matrix - mixed @ from_ring[:, :-1]
    step = -np.linalg.solve(normal_matrix + RIDGE * np.eye(PARAMETERS), gradient - mixed @ from_ring[:, -1])
    return normal_matrix, step, -from_ring[:, -1] - from_ring[:, :-1] @ step


def _robust_rows(measured: Measurements) -> slice:
    """Break points and visible edges; lines are fitted robustly before, and have no third end to check them."""
    first = 2 * len(measured.lines.laser)
    count = len(measured.points.laser) + int(measured.points.alone.sum()) + len(measured.edges.edge)
    return slice(first, first + count)


def _weights(residual: Float64[Array, "row"], robust: slice) -> Float64[Array, "row"]:
    weight = np.ones(len(residual))
    size = np.abs(residual[robust])
    weight[robust] = HUBER_SIGMAS / np.maximum(size, HUBER_SIGMAS)
    return weight


def _plausible(state: RingState, step: Float64[Array, "7"]) -> bool:
    plane = state.plane + step[:3]
    depth = float(np.sqrt(plane @ plane))
    curvature = abs(state.curvature + float(step[CURVATURE]))
    return (
        bool(np.isfinite(step).all())
        and 1 / MOST_DEPTH_M < depth < 1 / LEAST_DEPTH_M
        and (curvature < STEEPEST_CURVATURE)
    )


def starting_state(measured: Measurements, planes: LaserPlanes, before: Beforehand) -> RingState | None:
    """The plane of the stripes, and a likely ring on it; None if there is none before the camera."""
    plane = _starting_plane(measured, planes)
    straight = RingState(plane, np.array([1.0, 0.0, 0.0]), 0.0, LIKELY_CURVATURE, 0.0)
    points = point_parts(straight, measured.points, planes)
    if not len(measured.points.x) or not bool((points.position_m[:, 2] > 0).all()):
        return None
    outward = _outward(straight, measured, points.position_m, points.by_x)
    along = points.position_m @ outward
    inner, outer = along[measured.points.edge == 0], along[measured.points.edge == 1]
    band_m = float(outer.mean() - inner.mean()) if len(inner) and len(outer) else LIKELY_BAND_M
    curvature = LIKELY_CURVATURE
    if before.radii is not None and np.isfinite(before.radii.radius_m).any():
        curvature = 1.0 / float(np.nanmean(before.radii.radius_m))
        if np.isfinite(before.radii.radius_m).all():
            band_m = float(before.radii.radius_m[1] - before.radii.radius_m[0])
    return RingState(plane, outward, 0.0, curvature, band_m)


def _starting_plane(measured: Measurements, planes: LaserPlanes) -> Float64[Array, "3"]:
    """The q that fits the stripes: (m . r - d q . r) / (m - d q)_y is linear in q but for its weak denominator."""
    lines, points = measured.lines, measured.points
    alone = np.flatnonzero(points.alone)
    ray = np.concatenate(
        [
            np.stack([lines.x, lines.y, np.ones_like(lines.x)], axis=-1).reshape(-1, 3),
            np.stack([points.x[alone], points.y[alone], np.ones(len(alone))], axis=-1),
        ]
    )
    laser = np.concatenate([np.repeat(lines.laser, 2), points.laser[alone]])
    normal, distance = planes.normal[laser], planes.distance_m[laser]
    count = len(lines.laser)
    whitening = np.zeros((len(ray), len(ray)))
    for number in range(count):
        whitening[2 * number : 2 * number + 2, 2 * number : 2 * number + 2] = lines.whitening[number]
    whitening[range(2 * count, len(ray)), range(2 * count, len(ray))] = 1 / np.sqrt(points.covariance[alone, 1, 1])
    cosine = (normal * ray).sum(axis=1)
    plane = np.array([0.0, 0.0, float(np.mean(cosine / distance))])
    for _ in range(2):
        steepness = normal[:, 1] - distance * plane[1]
        rows = whitening @ ((distance / steepness)[:, None] * ray)
        matrix = rows.T @ rows
        matrix[[0, 1], [0, 1]] += 1.0 / plane[2] ** 2
        plane = np.linalg.solve(matrix, rows.T @ (whitening @ (cosine / steepness)))
    return plane


def _outward(
    state: RingState,
    measured: Measurements,
    position_m: Float64[Array, "point 3"],
    by_x: Float64[Array, "point 3"],
) -> Float64[Array, "3"]:
    """From inner towards outer ends, seen from the middles of their stripes."""
    points, lines = measured.points, measured.lines
    sign = 2.0 * points.edge - 1.0
    direction = np.zeros(3)
    for laser in set(points.laser.tolist()):
        own = points.laser == laser
        if bool((lines.laser == laser).any()):
            middle_x = float(lines.x[lines.laser == laser].mean())
            direction += ((sign * (points.x - middle_x))[own, None] * by_x[own]).sum(axis=0)
        else:
            direction += (sign[own, None] * (position_m[own] - position_m[own].mean(axis=0))).sum(axis=0)
    length = float(np.sqrt(direction @ direction))
    if length < 1e-9:
        spread = position_m[-1] - position_m[0]
        direction = cross(state.normal, spread) if float(spread @ spread) > 0 else by_x[0]
    direction = direction - (direction @ state.normal) * state.normal
    unit: Float64[Array, "3"] = direction / np.sqrt(direction @ direction)
    return unit
