"""What of a fit is known well enough to be told, and what to mind about it."""

from math import sqrt
from typing import NamedTuple

import numpy as np

from ringpose.pose.consistency import Explanation
from ringpose.pose.likelihood import Fit
from ringpose.pose.likelihood_output import BEND, CENTER, GRASP, TILTS, WIDTH, Quantities
from ringpose.pose.observability import TILT_SD_LIMIT_RAD, WEAK_SD, spreads_beyond, standard_deviation
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.options import Method
from ringpose.types.pose import PoseFlag, RingPose

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


def determined(best: Explanation, joint: Float64[Array, "15 15"], sure_of_side: bool) -> Determined:
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


def told_pose(fit: Fit, found: Quantities, joint: Float64[Array, "15 15"] | None, known: Determined) -> RingPose:
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


def weak_flags(fit: Fit, found: Quantities, joint: Float64[Array, "15 15"], known: Determined, bow: float) -> PoseFlag:
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
