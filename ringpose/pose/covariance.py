"""From the fitted state to centre, radii and grasp point, with their covariances (ringpose-method(7), section 5).

What of a fit is known well enough to be told, and what to mind about it.

From where on something counts as not determined, or as weak.
"""

import math
from collections.abc import Sequence
from math import hypot, sqrt
from typing import NamedTuple

import numpy as np

from ringpose.geometry.rotations import tilt_basis
from ringpose.pose.measurements import Measurements
from ringpose.pose.outlier_rejection import Hypothesis
from ringpose.pose.residuals import BAND, CURVATURE, PARAMETERS, PLANE, SHIFT, TURN, cross
from ringpose.pose.solver import Fit
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.options import Method
from ringpose.types.pose import PoseFlag, RingPose

TILTS, RADII, CENTER, GRASP, BEND, WIDTH = slice(0, 2), slice(5, 7), slice(7, 10), slice(10, 13), 13, 14
"""Rows of what is derived from a state."""

STRAIGHTEST = 1e-4
"""One over metres: a band straighter than this has a radius of ten kilometres for our purposes."""


class Quantities(NamedTuple):
    """What a state says, and its derivatives by the state."""

    center_m: Float64[Array, "3"]
    radius_m: Float64[Array, "2"]
    grasp_m: Float64[Array, "3"]
    by_state: Float64[Array, "15 7"]
    """Of the seven parameters of a pose, the centre, the grasp point, the curvature and the band's width."""


def quantities(fit: Fit) -> Quantities:
    """Centre c = o + (s - 1/k) u, radii 1/k -+ band/2, grasp point o + s u.

    The mean of the break points o lies in the direction u from the centre by construction, so the grasp point is the
    mid-band point there, whatever the centre's distance.
    """
    state, origin = fit.state, fit.rows.origin
    normal, along, outward = state.normal, state.along, state.outward
    inverse_length = 1.0 / float(np.sqrt(state.plane @ state.plane))
    basis = tilt_basis(normal)
    radius_m = 1.0 / (state.curvature if abs(state.curvature) > STRAIGHTEST else STRAIGHTEST)
    normal_by_plane = -inverse_length * (np.eye(3) - normal[:, None] * normal)

    by_state = np.zeros((15, PARAMETERS))
    by_state[0:2, PLANE] = -inverse_length * basis
    by_state[2, PLANE] = -(inverse_length**2) * normal
    by_state[5:7, CURVATURE] = -(radius_m**2)
    by_state[5:7, BAND] = (-0.5, 0.5)
    leaning = normal[:, None] * (outward @ normal_by_plane)  # the outward direction stays in the plane
    for first, reach_m in ((7, state.shift_m - radius_m), (10, state.shift_m)):
        rows = by_state[first : first + 3]
        rows[:, PLANE] = origin.by_plane - reach_m * leaning
        rows[:, SHIFT] = outward
        rows[:, TURN] = reach_m * along
    by_state[7:10, CURVATURE] = radius_m**2 * outward
    by_state[3:5] = basis @ by_state[CENTER]
    by_state[BEND, CURVATURE] = by_state[WIDTH, BAND] = 1.0
    return Quantities(
        center_m=origin.position_m + (state.shift_m - radius_m) * outward,
        radius_m=np.array([radius_m - 0.5 * state.band_m, radius_m + 0.5 * state.band_m]),
        grasp_m=origin.position_m + state.shift_m * outward,
        by_state=by_state,
    )


def covariance_of(fit: Fit, found: Quantities, measured: Measurements) -> Float64[Array, "15 15"]:
    """Joint covariance of the quantities: every residual errs by one, beyond the robust limit by that limit.

    With the gain G of the residuals on the state it is G G^T: the inverse normal matrix where no robust weight is
    active, its sandwich form where one is. The rig's errors, which are common to all residuals, pass the same gain.
    The grasp point also goes along the band with the mean of the break points.
    """
    inverse = fit.inverse
    gain = inverse @ (fit.rows.by_state.T * fit.weight)
    if fit.by_rig is not None:
        weighted = fit.by_rig.T * fit.weight
        own = weighted @ fit.by_rig
        own.flat[:: len(own) + 1] += 1.0
        from_ring = np.linalg.solve(own, weighted @ fit.rows.by_state)
        gain -= inverse @ from_ring.T @ weighted
    by_residual = -found.by_state @ gain
    joint = np.zeros((len(by_residual), len(by_residual)))
    if fit.by_rig is not None and fit.mean_by_rig is not None:
        by_rig = by_residual @ fit.by_rig
        by_rig[GRASP] += fit.state.along[:, None] * fit.mean_by_rig
        joint += by_rig @ by_rig.T
    first = 2 * len(measured.lines.laser)
    by_residual[GRASP, first : first + len(measured.points.laser)] += fit.state.along[:, None] * _mean_shift(
        fit, measured
    )
    spread = by_residual * np.where(fit.weight < 1.0, np.abs(fit.residual), 1.0)
    joint += spread @ spread.T
    return joint


def spread_of(rivals: Sequence[Fit], best: Fit, found: Quantities) -> Float64[Array, "15 15"]:
    """Squares of what rivals say instead of the best fit, summed: nobody knows which of them are true."""
    normal = best.state.normal
    basis, own = tilt_basis(normal), np.concatenate([found.center_m, found.grasp_m, found.radius_m])
    apart = np.zeros((len(rivals), 15))
    for row, fit in zip(apart, rivals, strict=True):
        said = quantities(fit)
        other = np.concatenate([said.center_m, said.grasp_m, said.radius_m]) - own
        row[TILTS] = basis @ fit.state.normal / float(fit.state.normal @ normal)
        row[2] = fit.state.normal @ said.center_m - normal @ found.center_m
        row[3:5], row[RADII], row[CENTER], row[GRASP] = basis @ other[:3], other[6:], other[:3], other[3:6]
        row[BEND] = fit.state.curvature - best.state.curvature
        row[WIDTH] = fit.state.band_m - best.state.band_m
    spread: Float64[Array, "15 15"] = apart.T @ apart
    return spread


def bow_m(joint: Float64[Array, "15 15"], fit: Fit) -> float:
    """How far the centre nears the band to second order when the ring errs by a sigma in the directions that turn it.

    For an observer at the band the centre is somewhere on a sphere: with the ring's tilt along `outward` and its turn
    about the normal it leaves the tangent plane by R / 2 times their squares.
    """
    normal, outward = fit.state.normal, fit.state.outward
    tilt, along = tilt_basis(normal) @ outward, cross(normal, outward)
    reach_m = 1.0 / max(abs(fit.state.curvature), STRAIGHTEST) - fit.state.shift_m
    by_tilt, by_turn = tilt @ joint[TILTS, TILTS] @ tilt, along @ joint[CENTER, CENTER] @ along / reach_m**2
    return 0.5 * reach_m * hypot(by_tilt, by_turn)


def with_second_order(joint: Float64[Array, "15 15"], bow: float, fit: Fit) -> Float64[Array, "15 15"]:
    """With the second moment of the bow, which goes with the squares of Gaussians: 3 bow^2."""
    by_bow = np.zeros(len(joint))
    by_bow[CENTER] = sqrt(3.0) * bow * fit.state.outward
    by_bow[3:5] = tilt_basis(fit.state.normal) @ by_bow[CENTER]
    more: Float64[Array, "15 15"] = joint + by_bow[:, None] * by_bow
    return more


def _mean_shift(fit: Fit, measured: Measurements) -> Float64[Array, "point"]:
    """How far the mean of the break points goes along the band when one of them errs by its standard deviation."""
    sigma = measured.points.sigma_x * np.sign(fit.rows.by_x)
    by_x, by_y = fit.state.along @ fit.rows.origin.by_ray
    shift: Float64[Array, "point"] = (by_x + fit.rows.slope * by_y) * sigma / len(sigma)
    return shift


UNKNOWN_FROM = 0.5
"""Standard deviation of the curvature, as a share of it, from which the centre is not determined at all: one over a
curvature that may be zero within two standard deviations has no error to speak of."""

GRASP_UNKNOWN_FROM_M = 0.01
"""Standard deviation of the grasp point, or of the band's width, from which nobody knows where the band is."""

BOWED_FROM = 4.0 / 9.0
"""Bow in sigmas of the centre beside it, from which no Gaussian tells the centre: a tilt by three sigmas brings it nine
bows aside, four of its sigmas, so that it is five off in all."""

_TINY, _EPSILON = float(np.finfo(float).tiny), float(np.finfo(float).eps)


class Determined(NamedTuple):
    """What of a fit is known well enough to be told."""

    normal: bool
    center: bool
    grasp: bool
    radius: Bool[Array, "edge=2"]


def determined(best: Hypothesis, joint: Float64[Array, "15 15"], sure_of_side: bool) -> Determined:
    """What is known: of the normal by its tilts, of centre and radii by the curvature, of the grasp point by itself."""
    fit = best.fit
    normal = standard_deviation(joint[TILTS, TILTS]) <= TILT_SD_LIMIT_RAD
    bend = sqrt(joint[BEND, BEND]) < UNKNOWN_FROM * fit.state.curvature
    grasp_sd_m = sqrt(max(float(fit.state.outward @ joint[GRASP, GRASP] @ fit.state.outward), 0.0))
    edges = {*best.measured.points.edge.tolist(), *best.measured.edges.edge.tolist()}
    told = sure_of_side or best.before.radii is not None
    return Determined(
        normal=normal,
        center=normal and sure_of_side and bend,
        grasp=max(grasp_sd_m, sqrt(joint[WIDTH, WIDTH])) <= GRASP_UNKNOWN_FROM_M,
        radius=np.array([told and bend and (edge in edges or best.before.radii is not None) for edge in range(2)]),
    )


def reported_pose(fit: Fit, found: Quantities, joint: Float64[Array, "15 15"] | None, known: Determined) -> RingPose:
    """The pose with NaN for what is not known; without covariances where there is none."""
    unknown = np.full(3, np.nan)
    radius_inner_m, radius_outer_m = np.where(known.radius, found.radius_m, np.nan).tolist()
    return RingPose(
        center_m=found.center_m if known.center else unknown,
        normal=fit.state.normal if known.normal else unknown,
        radius_inner_m=radius_inner_m,
        radius_outer_m=radius_outer_m,
        grasp_m=found.grasp_m if known.grasp else unknown,
        method=Method.ML.value,
        condition=_condition(fit),
        residual_rms_px=np.nan,
        covariance=None if joint is None else _with_unknown(joint[:7, :7], known),
        covariance_center_m2=None if joint is None or not known.center else joint[CENTER, CENTER],
        covariance_grasp_m2=None if joint is None or not known.grasp else joint[GRASP, GRASP],
    )


def poorly_determined_flags(
    fit: Fit, found: Quantities, joint: Float64[Array, "15 15"], known: Determined, bow: float
) -> PoseFlag:
    """What is not determined, worse than `WEAK_SD`, or told by no Gaussian."""
    limit_m = WEAK_SD * min(map(abs, found.radius_m.tolist()))
    flags = PoseFlag(0) if known.normal else PoseFlag.NORMAL_WEAK
    if not known.center or spreads_beyond(joint[CENTER, CENTER], limit_m) or _bowed(fit, joint, bow):
        flags |= PoseFlag.CENTER_WEAK
    if not known.radius.all() or max(joint[5, 5], joint[6, 6]) > limit_m**2:
        flags |= PoseFlag.RADIUS_WEAK
    return flags


def _bowed(fit: Fit, joint: Float64[Array, "15 15"], bow: float) -> bool:
    """Whether a likely tilt brings the centre far aside on its arc."""
    outward = fit.state.outward
    return bow > BOWED_FROM * sqrt(float(outward @ joint[CENTER, CENTER] @ outward))


def _with_unknown(covariance: Float64[Array, "7 7"], known: Determined) -> Float64[Array, "7 7"] | None:
    """NaN in the rows and columns of what is not determined; None if nothing is."""
    told = np.array([known.normal] * 3 + [known.center] * 2 + known.radius.tolist())
    if not told.any():
        return None
    if told.all():
        return covariance
    masked: Float64[Array, "7 7"] = np.where(told[:, None] & told, covariance, np.nan)
    return masked


def _condition(fit: Fit) -> float:
    """Largest over smallest singular value of the derivatives of all residuals, columns scaled to unit length."""
    scale = 1.0 / np.sqrt(np.maximum(fit.normal_matrix.diagonal(), _TINY))
    values = np.linalg.eigvalsh(fit.normal_matrix * scale[:, None] * scale)
    return float(np.sqrt(values[-1] / max(float(values[0]), _EPSILON)))


EDGE_ON_BELOW = 0.01
"""Sine of the angle at which the camera looks onto the ring's plane: 0.6 degrees, far less than any face shows."""

TILT_SD_LIMIT_RAD = 0.5
"""Standard deviation of the normal's direction (30 degrees) from which the points are a line within their errors.

Far below it the lever of the radius has made the centre weak, which is flagged.
"""

WEAK_SD = 0.05
"""Standard deviation of the centre, or of a radius, in radii, from which it is flagged as weak.

The centre follows from the height of the arc, and its distance is the inverse of that height. At 5 % the truth is
within 5 of the first-order standard deviations in all but one of 30 000 cases, at 10 % in all but one of 2000.
"""


def spreads_beyond(covariance: Float64[Array, "3 3"], limit: float) -> bool:
    """Whether the standard deviation is over the limit in some direction; mostly seen without eigenvalues.

    The largest variance is at least the largest on the diagonal, and at most their sum.
    """
    variances = covariance.diagonal().tolist()
    if max(variances) > limit**2:
        return True
    return not sum(variances) <= limit**2 and standard_deviation(covariance) > limit


def standard_deviation(covariance: Float64[Array, "n n"]) -> float:
    """In the direction in which it is largest."""
    if len(covariance) == 2:
        (first, mixed), (_, second) = covariance.tolist()
        return math.sqrt(max(0.5 * (first + second) + math.hypot(0.5 * (first - second), mixed), 0.0))
    return math.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))
