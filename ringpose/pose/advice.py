"""What would make a pose better, in words."""

import numpy as np

from ringpose.pose.observability import standard_deviation
from ringpose.types.arrays import Array, Float64
from ringpose.types.pose import PoseFlag, RingPose

RADIUS_SD_M = 0.0005
"""How well a radius that is looked up is known."""


def advice(pose: RingPose) -> str:
    """Which measurement would help most, and by how much; empty if nothing is weak."""
    if PoseFlag.NORMAL_WEAK in pose.flags:
        return "one stripe leaves the tilt about it open; bring a second one onto the ring, or step back"
    if PoseFlag.SIDE_UNKNOWN in pose.flags:
        return (
            "the centre may lie on either side; lasers farther apart or a longer distance would tell inner from outer"
        )
    if PoseFlag.CENTER_WEAK not in pose.flags:
        return ""
    if pose.covariance_center_m2 is None or pose.covariance is None:
        return "the centre is not determined; the ring's radius (--radius-outer, --ring) or visible edges would give it"
    now_mm, then_mm = (
        1000.0 * standard_deviation(each)
        for each in (pose.covariance_center_m2, center_with_radius(pose.covariance, pose))
    )
    help_ = "the ring's radius (--radius-outer, --ring) or visible edges would make it"
    if then_mm > 0.5 * now_mm:
        help_ = "only stripes farther apart on the face would help much; with the radius it is"
    return f"the centre is known to {now_mm:.1f} mm; {help_} {then_mm:.1f} mm"


def center_with_radius(covariance: Float64[Array, "7 7"], pose: RingPose) -> Float64[Array, "2 2"]:
    """Covariance of the centre in the ring's plane if the outer radius (the inner, if that was not seen) were known.

    Conditioning of a Gaussian on one of its parts.
    """
    radius = 6 if np.isfinite(pose.radius_outer_m) else 5
    own, mixed = covariance[3:5, 3:5], covariance[3:5, radius]
    conditioned: Float64[Array, "2 2"] = own - np.outer(mixed, mixed) / (covariance[radius, radius] + RADIUS_SD_M**2)
    return conditioned
