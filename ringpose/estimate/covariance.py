"""From the estimated state to centre, radii and grasp point with their covariance, and which of them are determined.

Error propagation of ringpose-method(7), section 5. `x_wrt_y` is the derivative of x with respect to y.
"""

import math
from collections.abc import Sequence
from math import hypot, sqrt
from typing import NamedTuple

import numpy as np

from ringpose.estimate.hypotheses import Hypothesis
from ringpose.estimate.measurements import Measurements
from ringpose.estimate.residuals import BAND, CURVATURE, PARAMETERS, PLANE, SHIFT, TURN, cross
from ringpose.estimate.solver import Estimate
from ringpose.geometry.rotations import tilt_basis
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.options import Method
from ringpose.types.pose import PoseFlag, RingPose

TILTS, OFFSET, CENTER_IN_PLANE, RADII = slice(0, 2), 2, slice(3, 5), slice(5, 7)
CENTER, GRASP, CURVATURE_OUT, BAND_OUT = slice(7, 10), slice(10, 13), 13, 14
"""Rows of the joint covariance: the seven parameters of a pose, then derived quantities."""

MIN_CURVATURE = 1e-4
"""1/m: radii are limited to ten kilometres."""

EDGE_ON_BELOW = 0.01
"""Sine of the smallest angle between the line of sight and the ring's plane: 0.6 degrees."""

TILT_SD_LIMIT_RAD = 0.5
"""Standard deviation of the normal's direction (30 degrees) from which the points lie on a line within their errors.

Long before, the lever of the radius makes the centre weak, which is flagged.
"""

WEAK_SD = 0.05
"""Standard deviation of the centre, or of a radius, in radii, from which it is flagged as weak.

The centre follows from the height of the arc, and its distance is the inverse of that height. At 5 % the truth is
within 5 of the first-order standard deviations in all but one of 30 000 cases, at 10 % in all but one of 2000.
"""

UNKNOWN_FROM = 0.5
"""Relative standard deviation of the curvature from which the centre is not determined at all: the inverse of a
curvature that may be zero within two standard deviations has no finite error."""

GRASP_UNKNOWN_FROM_M = 0.01
"""Standard deviation of the grasp point, or of the band's width, from which the grasp point is not determined."""

MAX_BIAS_SHARE = 4.0 / 9.0
"""Largest second-order bias of the centre, in its standard deviations, for which a Gaussian describes the centre: a
tilt by three sigmas moves the centre by nine times the bias, four of its sigmas."""

_TINY, _EPSILON = float(np.finfo(float).tiny), float(np.finfo(float).eps)


class Quantities(NamedTuple):
    """The quantities of a pose, and their derivatives with respect to the state."""

    center_m: Float64[Array, "3"]
    radius_m: Float64[Array, "2"]
    grasp_m: Float64[Array, "3"]
    jacobian: Float64[Array, "15 7"]
    """Rows as in the joint covariance."""


class Determined(NamedTuple):
    """Which quantities are determined well enough to be reported."""

    normal: bool
    center: bool
    grasp: bool
    radius: Bool[Array, "edge=2"]


def quantities(estimate: Estimate) -> Quantities:
    """Centre c = o + (s - 1/k) u, radii 1/k -+ band/2, grasp point g = o + s u.

    The mean of the break points o lies in the direction u from the centre by construction, so the grasp point is the
    mid-band point there, independently of the centre's distance.
    """
    state, origin = estimate.state, estimate.residuals.origin
    normal, tangent, outward = state.normal, state.tangent, state.outward
    inverse_length = 1.0 / float(np.sqrt(state.plane @ state.plane))
    basis = tilt_basis(normal)
    radius_m = 1.0 / (state.curvature if abs(state.curvature) > MIN_CURVATURE else MIN_CURVATURE)
    normal_wrt_plane = -inverse_length * (np.eye(3) - normal[:, None] * normal)

    jacobian = np.zeros((15, PARAMETERS))
    jacobian[TILTS, PLANE] = -inverse_length * basis
    jacobian[OFFSET, PLANE] = -(inverse_length**2) * normal
    jacobian[RADII, CURVATURE] = -(radius_m**2)
    jacobian[RADII, BAND] = (-0.5, 0.5)
    outward_wrt_plane = normal[:, None] * (outward @ normal_wrt_plane)  # negative: `outward` stays in the plane
    for rows, lever_m in ((jacobian[CENTER], state.shift_m - radius_m), (jacobian[GRASP], state.shift_m)):
        rows[:, PLANE] = origin.wrt_plane - lever_m * outward_wrt_plane
        rows[:, SHIFT] = outward
        rows[:, TURN] = lever_m * tangent
    jacobian[CENTER, CURVATURE] = radius_m**2 * outward
    jacobian[CENTER_IN_PLANE] = basis @ jacobian[CENTER]
    jacobian[CURVATURE_OUT, CURVATURE] = jacobian[BAND_OUT, BAND] = 1.0
    return Quantities(
        center_m=origin.position_m + (state.shift_m - radius_m) * outward,
        radius_m=np.array([radius_m - 0.5 * state.band_m, radius_m + 0.5 * state.band_m]),
        grasp_m=origin.position_m + state.shift_m * outward,
        jacobian=jacobian,
    )


def joint_covariance(estimate: Estimate, found: Quantities, measured: Measurements) -> Float64[Array, "15 15"]:
    """Joint covariance of the quantities, from the gain of the residuals on the state.

    Every residual has unit variance; one beyond the robust limit has the square of its value. Without such residuals
    the result is the inverse normal matrix, otherwise its sandwich form. Common errors pass the same gain. The grasp
    point also moves along the band with the mean of the break points.
    """
    gain = estimate.inverse @ (estimate.residuals.jacobian.T * estimate.weights)  # N^-1 J^T W
    if estimate.nuisance is not None:  # with the common errors eliminated
        weighted = estimate.nuisance.residual.T * estimate.weights
        information = estimate.nuisance.information(estimate.weights)
        gain -= estimate.inverse @ np.linalg.solve(information, weighted @ estimate.residuals.jacobian).T @ weighted
    wrt_residual = -found.jacobian @ gain
    tangent = estimate.state.tangent[:, None]
    covariance = np.zeros((len(wrt_residual), len(wrt_residual)))
    if estimate.nuisance is not None:
        wrt_nuisance = wrt_residual @ estimate.nuisance.residual
        wrt_nuisance[GRASP] += tangent * estimate.nuisance.mean
        covariance += wrt_nuisance @ wrt_nuisance.T
    first = 2 * len(measured.lines.laser)
    wrt_residual[GRASP, first : first + len(measured.points.laser)] += tangent * _mean_shift_m(estimate, measured)
    scaled = wrt_residual * np.where(estimate.weights < 1.0, np.abs(estimate.remaining), 1.0)
    covariance += scaled @ scaled.T
    return covariance


def _mean_shift_m(estimate: Estimate, measured: Measurements) -> Float64[Array, "point"]:
    """Shift of the mean of the break points along the band by an error of one standard deviation in each of them."""
    sigma = measured.points.sigma_x * np.sign(estimate.residuals.distance_wrt_x)
    wrt_x, wrt_y = estimate.state.tangent @ estimate.residuals.origin.wrt_ray
    shift: Float64[Array, "point"] = (wrt_x + estimate.residuals.slope * wrt_y) * sigma / len(sigma)
    return shift


def covariance_of_competing(
    competing: Sequence[Estimate], best: Estimate, found: Quantities
) -> Float64[Array, "15 15"]:
    """Sum of the outer products of the differences of competing estimates from the best one."""
    normal = best.state.normal
    basis = tilt_basis(normal)
    differences = np.zeros((len(competing), 15))
    for row, estimate in zip(differences, competing, strict=True):
        other = quantities(estimate)
        row[TILTS] = basis @ estimate.state.normal / float(estimate.state.normal @ normal)
        row[OFFSET] = estimate.state.normal @ other.center_m - normal @ found.center_m
        row[RADII] = other.radius_m - found.radius_m
        row[CENTER], row[GRASP] = other.center_m - found.center_m, other.grasp_m - found.grasp_m
        row[CENTER_IN_PLANE] = basis @ row[CENTER]
        row[CURVATURE_OUT] = estimate.state.curvature - best.state.curvature
        row[BAND_OUT] = estimate.state.band_m - best.state.band_m
    covariance: Float64[Array, "15 15"] = differences.T @ differences
    return covariance


def second_order_bias_m(covariance: Float64[Array, "15 15"], estimate: Estimate) -> float:
    """Second-order shift of the centre towards the band when the ring tilts or turns by a standard deviation.

    Seen from the band the centre lies on a sphere: a tilt along `outward`, or a turn about the normal, by an angle a
    moves the centre out of the tangent plane by R a^2 / 2.
    """
    normal, outward = estimate.state.normal, estimate.state.outward
    tilt, tangent = tilt_basis(normal) @ outward, cross(normal, outward)
    lever_m = 1.0 / max(abs(estimate.state.curvature), MIN_CURVATURE) - estimate.state.shift_m
    tilt_variance = tilt @ covariance[TILTS, TILTS] @ tilt
    turn_variance = tangent @ covariance[CENTER, CENTER] @ tangent / lever_m**2
    return 0.5 * lever_m * hypot(tilt_variance, turn_variance)


def with_second_order(
    covariance: Float64[Array, "15 15"], bias_m: float, estimate: Estimate
) -> Float64[Array, "15 15"]:
    """The covariance with the second moment 3 bias^2 of the centre's second-order shift."""
    shift = np.zeros(len(covariance))
    shift[CENTER] = sqrt(3.0) * bias_m * estimate.state.outward
    shift[CENTER_IN_PLANE] = tilt_basis(estimate.state.normal) @ shift[CENTER]
    total: Float64[Array, "15 15"] = covariance + shift[:, None] * shift
    return total


def determined(best: Hypothesis, covariance: Float64[Array, "15 15"], side_known: bool) -> Determined:
    """The normal is determined by its tilts, centre and radii by the curvature, the grasp point by its own sigma.

    `side_known`: whether the shot determines on which side of the band the centre lies.
    """
    state = best.estimate.state
    normal = standard_deviation(covariance[TILTS, TILTS]) <= TILT_SD_LIMIT_RAD
    curved = sqrt(covariance[CURVATURE_OUT, CURVATURE_OUT]) < UNKNOWN_FROM * state.curvature
    grasp_sd_m = sqrt(max(float(state.outward @ covariance[GRASP, GRASP] @ state.outward), 0.0))
    edges = {*best.measured.points.edge.tolist(), *best.measured.edges.edge.tolist()}
    radii_given = best.prior.radii is not None
    radii = (side_known or radii_given) and curved
    return Determined(
        normal=normal,
        center=normal and side_known and curved,
        grasp=max(grasp_sd_m, sqrt(covariance[BAND_OUT, BAND_OUT])) <= GRASP_UNKNOWN_FROM_M,
        radius=np.array([radii and (edge in edges or radii_given) for edge in range(2)]),
    )


def reported_pose(
    estimate: Estimate, found: Quantities, covariance: Float64[Array, "15 15"] | None, reported: Determined
) -> RingPose:
    """The pose, with NaN for what is not determined; without covariances if there is none."""
    unknown = np.full(3, np.nan)
    radius_inner_m, radius_outer_m = np.where(reported.radius, found.radius_m, np.nan).tolist()
    return RingPose(
        center_m=found.center_m if reported.center else unknown,
        normal=estimate.state.normal if reported.normal else unknown,
        radius_inner_m=radius_inner_m,
        radius_outer_m=radius_outer_m,
        grasp_m=found.grasp_m if reported.grasp else unknown,
        method=Method.ML.value,
        condition_number=_condition(estimate),
        residual_rms_px=np.nan,
        covariance=None if covariance is None else _masked(covariance[:7, :7], reported),
        covariance_center_m2=None if covariance is None or not reported.center else covariance[CENTER, CENTER],
        covariance_grasp_m2=None if covariance is None or not reported.grasp else covariance[GRASP, GRASP],
    )


def _masked(covariance: Float64[Array, "7 7"], reported: Determined) -> Float64[Array, "7 7"] | None:
    """NaN in the rows and columns of what is not determined; None if nothing is."""
    kept = np.array([reported.normal] * 3 + [reported.center] * 2 + reported.radius.tolist())
    if not kept.any():
        return None
    if kept.all():
        return covariance
    masked: Float64[Array, "7 7"] = np.where(kept[:, None] & kept, covariance, np.nan)
    return masked


def _condition(estimate: Estimate) -> float:
    """Condition number of the Jacobian of all residuals, its columns scaled to unit length."""
    scale = 1.0 / np.sqrt(np.maximum(estimate.normal_matrix.diagonal(), _TINY))
    values = np.linalg.eigvalsh(estimate.normal_matrix * scale[:, None] * scale)
    return float(np.sqrt(values[-1] / max(float(values[0]), _EPSILON)))


def poorly_determined_flags(
    estimate: Estimate, found: Quantities, covariance: Float64[Array, "15 15"], reported: Determined, bias_m: float
) -> PoseFlag:
    """Flags of what is not determined, has a sigma over `WEAK_SD`, or is not described by a Gaussian."""
    limit_m = WEAK_SD * min(map(abs, found.radius_m.tolist()))
    outward = estimate.state.outward
    biased = bias_m > MAX_BIAS_SHARE * sqrt(float(outward @ covariance[CENTER, CENTER] @ outward))
    flags = PoseFlag(0) if reported.normal else PoseFlag.NORMAL_WEAK
    if not reported.center or exceeds_sd(covariance[CENTER, CENTER], limit_m) or biased:
        flags |= PoseFlag.CENTER_WEAK
    if not reported.radius.all() or max(covariance[5, 5], covariance[6, 6]) > limit_m**2:
        flags |= PoseFlag.RADIUS_WEAK
    return flags


def exceeds_sd(covariance: Float64[Array, "3 3"], limit: float) -> bool:
    """Whether the standard deviation exceeds the limit in some direction.

    The largest eigenvalue is between the largest diagonal element and the trace, which mostly decides.
    """
    variances = covariance.diagonal().tolist()
    if max(variances) > limit**2:
        return True
    return not sum(variances) <= limit**2 and standard_deviation(covariance) > limit


def standard_deviation(covariance: Float64[Array, "n n"]) -> float:
    """In the direction in which it is largest."""
    if len(covariance) == 2:
        (first, off_diagonal), (_, second) = covariance.tolist()
        half_sum, half_difference = 0.5 * (first + second), 0.5 * (first - second)
        return math.sqrt(max(half_sum + math.hypot(half_difference, off_diagonal), 0.0))
    return math.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))
