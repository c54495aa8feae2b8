"""Covariance of a pose, to first order.

J Sigma J^T, with Sigma the joint covariance of the triangulated points and J by central differences of the same
closed form that gave the pose.
"""

from dataclasses import dataclass

from ringpose.types.arrays import Array, Float64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseCovariance:
    """Covariances of one pose; NaN where the quantity itself is NaN."""

    parameters: Float64[Array, "7 7"]
    """Of tilt_1, tilt_2, offset_m, center_1_m, center_2_m, radius_inner_m, radius_outer_m."""
    center_m2: Float64[Array, "3 3"]
    grasp_m2: Float64[Array, "3 3"]


def pose_covariance(
    jacobian: Float64[Array, "13 coordinate"], covariance_m2: Float64[Array, "coordinate coordinate"]
) -> PoseCovariance:
    """Covariance of a solution at points whose joint covariance is given.

    First order is enough while the centre's standard deviation is a few percent of the radius. Beyond that (flag
    CENTER_WEAK) the centre's distribution is skew: it is the arc's height that is measured, the centre's
    distance goes with its inverse, and the true centre may lie many of these standard deviations away.
    """
    joint = jacobian @ covariance_m2 @ jacobian.T
    return PoseCovariance(parameters=joint[:7, :7], center_m2=joint[7:10, 7:10], grasp_m2=joint[10:, 10:])
