"""The measurement that would improve a pose most, and what a line says to the user."""

import numpy as np

from ringpose.estimate.covariance import standard_deviation
from ringpose.types.arrays import Array, Float64
from ringpose.types.pose import PoseFlag, PoseLine, RingPose

RADIUS_SD_M = 0.0005
"""Standard deviation assumed for a radius that the user looks up."""


def remarks_on(line: PoseLine) -> str:
    """The reason, the flags and the advice of a pose line in one sentence; its status if it has none of them."""
    remarks = [line.reason or "", ", ".join(line.flag_names), "" if line.pose is None else advice(line.pose)]
    return "; ".join(filter(None, remarks)) or line.status


def advice(pose: RingPose) -> str:
    """The measurement that would improve the pose most, and by how much; empty if the pose is well determined."""
    if PoseFlag.NORMAL_WEAK in pose.flags:
        return "one stripe leaves the tilt about it open; bring a second one onto the ring, or step back"
    if PoseFlag.SIDE_UNKNOWN in pose.flags:
        return "the centre may lie on either side; lasers farther apart or a longer distance would show which one"
    if PoseFlag.CENTER_WEAK not in pose.flags:
        return ""
    if pose.covariance_center_m2 is None or pose.covariance is None:
        return "the centre is not determined; the ring's radius (--radius-outer, --ring) or visible edges would give it"
    now_mm = 1000.0 * standard_deviation(pose.covariance_center_m2)
    then_mm = 1000.0 * standard_deviation(center_covariance_with_radius(pose, pose.covariance))
    remedy = "the ring's radius (--radius-outer, --ring) or visible edges would make it"
    if then_mm > 0.5 * now_mm:
        remedy = "only stripes farther apart on the face would help much; with the radius it is"
    return f"the centre is known to {now_mm:.1f} mm; {remedy} {then_mm:.1f} mm"


def center_covariance_with_radius(pose: RingPose, covariance: Float64[Array, "7 7"]) -> Float64[Array, "2 2"]:
    """Covariance (m^2) of the centre in the ring's plane if the outer radius (else the inner one) were measured.

    The Gaussian of the pose's parameters, conditioned on a radius with the standard deviation `RADIUS_SD_M`.
    """
    radius = 6 if np.isfinite(pose.radius_outer_m) else 5
    cross_covariance = covariance[3:5, radius]
    variance_m2 = covariance[radius, radius] + RADIUS_SD_M**2
    conditioned: Float64[Array, "2 2"] = (
        covariance[3:5, 3:5] - np.outer(cross_covariance, cross_covariance) / variance_m2
    )
    return conditioned
