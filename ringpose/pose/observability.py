"""Which quantities of a pose are determined, and the pose with those (ringpose-method(7), section 5)."""

from math import sqrt
from typing import NamedTuple

import numpy as np

from ringpose.estimate.covariance import (
    BAND_OUT,
    CENTER,
    CURVATURE_OUT,
    GRASP,
    TILT_SD_LIMIT_RAD,
    TILTS,
    WEAK_SD,
    Quantities,
    exceeds_sd,
    standard_deviation,
)
from ringpose.estimate.hypotheses import Explanation
from ringpose.estimate.residuals import Estimate
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.options import Method
from ringpose.types.pose import PoseFlag, RingPose

UNKNOWN_FROM = 0.5
"""Relative standard deviation of the curvature from which the centre is not determined at all: the inverse of a
curvature that may be zero within two standard deviations has no finite error."""

MAX_RADIUS_M = 5.0
"""Larger rings do not exist: a larger radius comes from break points that are wrong in the same way."""

GRASP_UNKNOWN_FROM_M = 0.01
"""Standard deviation of the grasp point, or of the band's width, from which the grasp point is not determined."""

MAX_BIAS_SHARE = 4.0 / 9.0
"""Largest second-order bias of the centre, in its standard deviations, for which a Gaussian describes the centre: a
tilt by three sigmas moves the centre by nine times the bias, four of its sigmas."""

_TINY, _EPSILON = float(np.finfo(float).tiny), float(np.finfo(float).eps)


class Determined(NamedTuple):
    """Which quantities are determined well enough to be reported."""

    normal: bool
    center: bool
    grasp: bool
    radius: Bool[Array, "edge=2"]


def determined(best: Explanation, found: Quantities, covariance: Float64[Array, "15 15"]) -> Determined:
    """The normal is determined by its tilts, centre and radii by the curvature, the grasp point by its own sigma.

    A quantity in which comparable explanations of the shot differ is not determined.
    """
    normal = standard_deviation(covariance[TILTS, TILTS]) <= TILT_SD_LIMIT_RAD
    curvature = best.estimate.arcs.curvature
    curved = sqrt(covariance[CURVATURE_OUT, CURVATURE_OUT]) < UNKNOWN_FROM * curvature
    curved = curved and curvature > 1.0 / MAX_RADIUS_M
    across = np.array([best.estimate.arcs.normal, found.outward])
    grasp_sd_m = standard_deviation(across @ covariance[GRASP, GRASP] @ across.T)
    edges = {*best.measured.points.edge.tolist(), *best.measured.edges.edge.tolist()}
    radii_given = best.prior.radii is not None
    radii = (best.side_known or radii_given) and curved and "radius" not in best.differing
    grasp = max(grasp_sd_m, sqrt(covariance[BAND_OUT, BAND_OUT])) <= GRASP_UNKNOWN_FROM_M
    return Determined(
        normal=normal and "normal" not in best.differing,
        center=normal and best.side_known and curved and "center" not in best.differing,
        grasp=grasp and "grasp" not in best.differing,
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
        normal=estimate.arcs.normal if reported.normal else unknown,
        radius_inner_m=radius_inner_m,
        radius_outer_m=radius_outer_m,
        grasp_m=found.grasp_m if reported.grasp else unknown,
        method=Method.ML.value,
        condition_number=_condition_number(estimate),
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


def _condition_number(estimate: Estimate) -> float:
    """Condition number of the Jacobian of all residuals, its columns scaled to unit length."""
    scale = 1.0 / np.sqrt(np.maximum(estimate.normal_matrix.diagonal(), _TINY))
    values = np.linalg.eigvalsh(estimate.normal_matrix * scale[:, None] * scale)
    return float(np.sqrt(values[-1] / max(float(values[0]), _EPSILON)))


def poorly_determined_flags(
    estimate: Estimate, found: Quantities, covariance: Float64[Array, "15 15"], reported: Determined, bias_m: float
) -> PoseFlag:
    """Flags of what is not determined, has a sigma over `WEAK_SD`, or is not described by a Gaussian."""
    limit_m = WEAK_SD * min(map(abs, found.radius_m.tolist()))
    inward = estimate.arcs.axes[0]
    biased = bias_m > MAX_BIAS_SHARE * sqrt(float(inward @ covariance[CENTER, CENTER] @ inward))
    flags = PoseFlag(0) if reported.normal else PoseFlag.NORMAL_WEAK
    if not reported.grasp:
        flags |= PoseFlag.GRASP_WEAK
    if not reported.center or exceeds_sd(covariance[CENTER, CENTER], limit_m) or biased:
        flags |= PoseFlag.CENTER_WEAK
    if not reported.radius.all() or max(covariance[5, 5], covariance[6, 6]) > limit_m**2:
        flags |= PoseFlag.RADIUS_WEAK
    return flags
