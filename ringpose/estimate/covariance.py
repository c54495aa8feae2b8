"""From the estimated ring to centre, radii and grasp point with their covariance.

Error propagation of ringpose-method(7), section 5. `x_wrt_y` is the derivative of x with respect to y.
"""

import math
from math import hypot, sqrt
from typing import NamedTuple

import numpy as np

from ringpose.estimate.linearization import PARAMETERS
from ringpose.estimate.ring_estimate import Estimate
from ringpose.estimate.solver import UNKNOWN_FROM as UNKNOWN_FROM
from ringpose.geometry.ring import (
    CURVATURE,
    HALF_BAND,
    LIFT,
    TILT_ALONG,
    TILT_INWARD,
    RingArcs,
    center_wrt_step,
    edge_distances,
    public_wrt_step,
)
from ringpose.geometry.rotations import cross, tilt_basis
from ringpose.types.arrays import Array, Float64
from ringpose.types.pose import RingVelocity

JOINT = (
    "tilt", "tilt", "offset", "center_in_plane", "center_in_plane", "radius", "radius",
    *("center" for _ in "xyz"), *("grasp" for _ in "xyz"), "curvature", "band",
)  # fmt: skip
"""Rows of the joint covariance: the seven parameters of a pose, then derived quantities."""


def _rows_of(quantity: str) -> slice:
    first = JOINT.index(quantity)
    return slice(first, first + JOINT.count(quantity))


TILTS, CENTER_IN_PLANE, RADII, CENTER, GRASP = map(_rows_of, ("tilt", "center_in_plane", "radius", "center", "grasp"))
OFFSET, CURVATURE_OUT, BAND_OUT = map(JOINT.index, ("offset", "curvature", "band"))

EDGE_ON_BELOW = 0.01
"""Sine of the smallest angle between the line of sight and the ring's plane: 0.6 degrees."""

WEAK_SD = 0.05
"""Standard deviation of the centre, or of a radius, in radii, from which it is flagged as weak.

The centre follows from the height of the arc, and its distance is the inverse of that height. At 5 % the truth is
within 5 of the first-order standard deviations in all but one of 30 000 cases, at 10 % in all but one of 2000.
"""

GRASP_UNKNOWN_FROM_M = 0.01
"""Standard deviation of the grasp point, or of the band's width, from which the grasp point is not determined."""


class Quantities(NamedTuple):
    """The quantities of a pose, and their derivatives with respect to the ring's step."""

    normal: Float64[Array, "3"]
    basis: Float64[Array, "2 3"]
    """The tilt basis of the normal."""
    center_m: Float64[Array, "3"]
    radius_m: Float64[Array, "2"]
    grasp_m: Float64[Array, "3"]
    mean_m: Float64[Array, "3"]
    """Where the mean of the break points' rays meets the ring's plane."""
    outward: Float64[Array, "3"]
    """Unit vector in the ring's plane at the grasp point, from the centre."""
    jacobian: Float64[Array, "15 7"]
    """Rows as in the joint covariance."""
    along: Float64[Array, "3"]
    """Unit vector along the face at the grasp point, normal x outward."""
    along_wrt_points_m: Float64[Array, "point"]
    """Shift of the grasp point along the face by an error of one standard deviation in each break point."""
    along_wrt_nuisance_m: Float64[Array, "error"]
    """Shift of the grasp point along the face by each of the rates and the rig's errors, for a fixed ring."""


def quantities(estimate: Estimate) -> Quantities:
    """Centre, radii and grasp point: the point on the middle of the face nearest to the mean of the break points.

    These are the break points of one arc: the mean of those on both would be near the centre.

    The grasp point does not use the centre, so that it stays known where the centre is not.
    """
    arcs, residuals = estimate.arcs, estimate.residuals
    observations, stripes = residuals.observations, residuals.at.stripes
    shown, ends = observations.described, observations.view.ends
    rays = stripes.rays[shown]
    mean_ray, normal = rays.mean(axis=0), arcs.axes[2]
    depth_m = float(arcs.origin @ normal) / float(mean_ray @ normal)
    mean_m = depth_m * mean_ray
    outward = _outward_at(arcs, mean_m)
    face_direction, basis = cross(normal, outward), tilt_basis(normal)
    middle = edge_distances(arcs, mean_ray[None], np.zeros(1))
    distance_m = float(middle.distance_m[0])

    # the mean point moves along its ray with the plane, and with the lines of its stripes
    offset = (mean_m - arcs.origin) @ arcs.axes.T
    depth_wrt_step = np.zeros(PARAMETERS)
    depth_wrt_step[[TILT_INWARD, TILT_ALONG, LIFT]] = -offset[0], -offset[1], 1.0
    mean_wrt_ray = depth_m * (np.eye(3) - np.outer(mean_ray, normal) / float(mean_ray @ normal))
    y_wrt_step = stripes.y_wrt_step[shown, :PARAMETERS].mean(axis=0)
    mean_wrt_step = np.outer(mean_ray, depth_wrt_step / float(mean_ray @ normal)) + np.outer(
        mean_wrt_ray[:, 1], y_wrt_step
    )
    distance_wrt_step = middle.wrt_step[0] + middle.wrt_ray[0, 1] * y_wrt_step
    # `outward` turns in the plane with the direction from centre to mean point, and tilts with the plane
    center_jacobian = center_wrt_step(arcs)
    turn_wrt_step = face_direction @ (mean_wrt_step - center_jacobian) / (arcs.mean_radius_m + distance_m)
    tilt_wrt_step = np.zeros(PARAMETERS)
    tilt_wrt_step[[TILT_INWARD, TILT_ALONG]] = arcs.axes[:2] @ outward
    outward_wrt_step = np.outer(face_direction, turn_wrt_step) - np.outer(normal, tilt_wrt_step)

    jacobian = np.zeros((15, PARAMETERS))
    jacobian[:7] = public_wrt_step(arcs, basis)
    jacobian[CENTER] = center_jacobian
    jacobian[GRASP] = mean_wrt_step - np.outer(outward, distance_wrt_step) - distance_m * outward_wrt_step
    jacobian[CURVATURE_OUT, CURVATURE] = 1.0
    jacobian[BAND_OUT, HALF_BAND] = 2.0
    along_wrt_ray = face_direction @ mean_wrt_ray[:, :2]
    along_wrt_x = np.zeros(len(stripes.rays) - ends)
    wrt_x, wrt_y = residuals.at.edges.wrt_ray[: len(along_wrt_x)].T
    outwards = np.where(wrt_x + stripes.slope[ends:] * wrt_y < 0.0, -1.0, 1.0)
    along_wrt_x[shown - ends] = along_wrt_ray @ np.array([np.ones(len(rays)), stripes.slope[shown]]) / len(rays)
    count = len(residuals.rate_sds)  # of the mean of the predicted break points, for a fixed ring: by rates, then rig
    mean_ray_wrt_rates = np.zeros((2, count))
    y_wrt_rates = stripes.y_wrt_step[shown, PARAMETERS : PARAMETERS + count]
    mean_ray_wrt_rates[1] = y_wrt_rates.mean(axis=0) * residuals.rate_sds
    return Quantities(
        normal=normal,
        basis=basis,
        center_m=arcs.center,
        radius_m=arcs.radius_m,
        grasp_m=mean_m - distance_m * outward,
        mean_m=mean_m,
        outward=outward,
        jacobian=jacobian,
        along=face_direction,
        along_wrt_points_m=along_wrt_x * outwards * observations.points.sigma_x,
        along_wrt_nuisance_m=along_wrt_ray
        @ np.concatenate([mean_ray_wrt_rates, estimate.fixed.mean_ray_wrt_rig], axis=1),
    )


def _outward_at(arcs: RingArcs, point_m: Float64[Array, "3"]) -> Float64[Array, "3"]:
    """Unit vector in the ring's plane from the centre towards a point; also defined at curvature 0 (straight edges)."""
    x, y, _ = (arcs.axes @ (point_m - arcs.origin)).tolist()
    h_x, h_y = 1.0 - arcs.curvature * x, arcs.curvature * y
    unit: Float64[Array, "3"] = (-h_x * arcs.axes[0] + h_y * arcs.axes[1]) / hypot(h_x, h_y)
    return unit


def joint_covariance(estimate: Estimate, values: Quantities) -> Float64[Array, "15 15"]:
    """Joint covariance of the quantities, J N^-1 J^T, Eq. (5.10).

    The grasp point also moves along the face with the mean of the break points, whose errors change the ring, too:
    the step is -G (noise + B q), with the gain G = N^-1 (J^T W - J^T W B (1 + B^T W B)^-1 B^T W).
    """
    covariance: Float64[Array, "15 15"] = values.jacobian @ estimate.inverse @ values.jacobian.T
    residuals, nuisance = estimate.residuals, estimate.nuisance
    along = nuisance[:, : len(values.along_wrt_nuisance_m)] @ values.along_wrt_nuisance_m
    ends = residuals.observations.view.ends
    along[ends : ends + len(values.along_wrt_points_m)] += values.along_wrt_points_m
    weighted = along * estimate.weights
    if nuisance.shape[1]:
        cross_information = nuisance.T @ weighted
        information = (nuisance.T * estimate.weights) @ nuisance + np.eye(nuisance.shape[1])
        weighted -= estimate.weights * (nuisance @ np.linalg.solve(information, cross_information))
    step_with_along = -estimate.inverse @ (residuals.jacobian.T @ weighted)
    with_along = np.outer(values.jacobian @ step_with_along, values.along)
    covariance[:, GRASP] += with_along
    covariance[GRASP] += with_along.T
    variance = values.along_wrt_points_m @ values.along_wrt_points_m
    variance += values.along_wrt_nuisance_m @ values.along_wrt_nuisance_m
    covariance[GRASP, GRASP] += variance * np.outer(values.along, values.along)
    return 0.5 * (covariance + covariance.T)  # exactly symmetric, also for large variances


def ring_velocity(estimate: Estimate, values: Quantities) -> RingVelocity | None:
    """Velocity of the ring's centre and angular velocity across its normal, with their covariance; None if still.

    The rates are q = -M^-1 (B^T W r + C step) with M = 1 + B^T W B and C = B^T W J, so that their covariance is
    M^-1 + M^-1 C N^-1 C^T M^-1, in the standard deviations of their prior.
    """
    scale = estimate.residuals.rate_sds
    count = len(scale)
    if not count:
        return None
    weighted = estimate.nuisance.T * estimate.weights
    inverse = np.linalg.inv(weighted @ estimate.nuisance + np.eye(len(weighted)))
    gain = (inverse @ (weighted @ estimate.residuals.jacobian))[:count]
    covariance = (inverse[:count, :count] + gain @ estimate.inverse @ gain.T) * scale[:, None] * scale
    to_basis = np.eye(count)  # angular velocities from the arcs' axes to the tilt basis of the normal
    to_basis[3:, 3:] = values.basis @ estimate.arcs.axes[:2].T
    covariance = to_basis @ covariance @ to_basis.T
    return RingVelocity(
        center_m_s=estimate.rates.velocity_m_s,
        rate_rad_s=estimate.rates.rate_rad_s,
        covariance=0.5 * (covariance + covariance.T),
    )


def difference_from(
    other: Estimate, other_values: Quantities, best: Estimate, values: Quantities
) -> Float64[Array, "15"]:
    """The quantities of another estimate minus those of the best one, in the order of the joint covariance."""
    normal, basis = values.normal, values.basis
    difference = np.zeros(15)
    difference[TILTS] = basis @ other_values.normal / float(other_values.normal @ normal)
    difference[OFFSET] = other_values.normal @ other_values.center_m - normal @ values.center_m
    difference[RADII] = other_values.radius_m - values.radius_m
    difference[CENTER], difference[GRASP] = (
        other_values.center_m - values.center_m,
        other_values.grasp_m - values.grasp_m,
    )
    offset_m = float(normal @ values.center_m)
    difference[CENTER_IN_PLANE] = basis @ difference[CENTER] - offset_m * difference[TILTS]
    difference[CURVATURE_OUT] = other.arcs.curvature - best.arcs.curvature
    difference[BAND_OUT] = 2.0 * (other.arcs.half_band_m - best.arcs.half_band_m)
    return difference


DIFFERS = 4.0
"""Squared Mahalanobis distance, per degree of freedom, from which two explanations differ in a quantity."""


def differing_quantities(best: Estimate, other: Estimate) -> frozenset[str]:
    """Names of the quantities in which two explanations differ by more than the errors of the best one."""
    values, others = quantities(best), quantities(other)
    covariance = joint_covariance(best, values)
    difference = difference_from(other, others, best, values)
    # the grasp points lie at different places along the face: how far the best one is from the other ring
    height_m = float(others.normal @ (values.grasp_m - other.arcs.origin))
    radial = edge_distances(other.arcs, (values.grasp_m / values.grasp_m[2])[None], np.zeros(1))
    across = np.array([values.normal, values.outward])
    tested = {
        "center": (difference[CENTER], covariance[CENTER, CENTER]),
        "normal": (difference[TILTS], covariance[TILTS, TILTS]),
        "grasp": (np.array([height_m, float(radial.distance_m[0])]), across @ covariance[GRASP, GRASP] @ across.T),
        "radius": (difference[RADII], covariance[RADII, RADII]),
    }
    velocity, of_other = ring_velocity(best, values), ring_velocity(other, others)
    if velocity is not None and of_other is not None:
        change = of_other.center_m_s - velocity.center_m_s
        tested["velocity"] = (change, velocity.covariance[:3, :3])
    return frozenset(name for name, (by, of) in tested.items() if not _within(by, of))


def _within(difference: Float64[Array, "n"], covariance: Float64[Array, "n n"]) -> bool:
    """Whether a difference is within `DIFFERS` of its errors; false for numbers that are not finite."""
    if not bool(np.isfinite(difference).all() and np.isfinite(covariance).all()):
        return False
    squared = float(difference @ np.linalg.pinv(covariance, hermitian=True) @ difference)
    return squared <= DIFFERS * len(difference)


MAX_BIAS_SHARE = 4.0 / 9.0
"""Largest second-order bias of the centre, in its standard deviations, for which a Gaussian describes the centre: a
tilt by three sigmas moves the centre by nine times the bias, four of its sigmas."""


def second_order_bias_m(covariance: Float64[Array, "15 15"], estimate: Estimate, values: Quantities) -> float:
    """Second-order shift of the centre towards the band when the ring tilts or turns by a standard deviation.

    Seen from the band the centre lies on a sphere: a tilt along `outward`, or a turn about the normal, by an angle a
    moves the centre out of the tangent plane by R a^2 / 2.
    """
    inward, tangent, _ = estimate.arcs.axes
    tilt = values.basis @ inward
    lever_m = abs(float(values.radius_m.mean()))
    tilt_variance = tilt @ covariance[TILTS, TILTS] @ tilt
    turn_variance = tangent @ covariance[CENTER, CENTER] @ tangent / lever_m**2
    return 0.5 * lever_m * hypot(tilt_variance, turn_variance)


def with_second_order(
    covariance: Float64[Array, "15 15"], bias_m: float, estimate: Estimate, values: Quantities
) -> Float64[Array, "15 15"]:
    """The covariance with the second moment 3 bias^2 of the centre's second-order shift.

    Where little else is uncertain towards the band, as with given radii, at least with that of `MAX_BIAS_SHARE`.
    """
    inward = estimate.arcs.axes[0]
    variance = float(inward @ covariance[CENTER, CENTER] @ inward)
    shift = np.zeros(len(covariance))
    shift[CENTER] = sqrt(max(3.0 * bias_m**2, (bias_m / MAX_BIAS_SHARE) ** 2 - variance)) * inward
    shift[CENTER_IN_PLANE] = values.basis @ shift[CENTER]
    total: Float64[Array, "15 15"] = covariance + shift[:, None] * shift
    return total


def with_unknown_distance(
    covariance: Float64[Array, "15 15"], estimate: Estimate, values: Quantities
) -> Float64[Array, "15 15"]:
    """The covariance of the grasp point of a single stripe, whose distance u from the centre is open, Eq. (5.14).

    What one stripe shows is symmetric about it in the ring's plane: the centre, and with it the grasp point beside the
    stripe, may as well lie on the other side. Visible edges show the side. And where u is about 0, the ends seem to
    determine the radii, as they depend on its square: an error of given radii shifts the grasp point by
    (r_o - r_i)^2 / (4 r_i r_o) of itself.
    """
    residuals = estimate.residuals
    lasers = set(residuals.observations.laser.tolist())
    if len(lasers) != 1 or len(estimate.edge_residuals):
        return covariance
    along = cross(residuals.observations.rig.lasers.normal[lasers.pop()], values.normal)
    along /= np.linalg.norm(along)
    aside = cross(values.normal, along)
    shift = np.zeros(len(covariance))
    shift[GRASP] = 2.0 * float((values.grasp_m - values.mean_m) @ aside) * aside
    given, (inner_m, outer_m) = estimate.prior.radii, values.radius_m.tolist()
    radial = np.zeros(len(covariance))
    if given is not None:
        share = (outer_m - inner_m) ** 2 / (4.0 * inner_m * outer_m)
        radial[GRASP] = share * float(np.nanmax(given.sd_m)) * values.outward
    total: Float64[Array, "15 15"] = covariance + shift[:, None] * shift + radial[:, None] * radial
    return total


def exceeds_sd(covariance: Float64[Array, "3 3"], limit: float) -> bool:
    """Whether the standard deviation exceeds the limit in some direction.

    The largest eigenvalue is between the largest diagonal element and the trace, which mostly decides.
    """
    variances = covariance.diagonal().tolist()
    if max(variances) > limit**2:
        return True
    return not sum(variances) <= limit**2 and standard_deviation(covariance) > limit


def standard_deviation(covariance: Float64[Array, "n n"]) -> float:
    """Standard deviation in the direction in which it is largest."""
    if covariance.shape == (2, 2):
        (first, off_diagonal), (_, second) = covariance.tolist()
        half_sum, half_difference = 0.5 * (first + second), 0.5 * (first - second)
        return math.sqrt(max(half_sum + math.hypot(half_difference, off_diagonal), 0.0))
    return math.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))
