"""Methods `paper` and `paper-constrained`: the closed form with its covariance (method(7), section 4)."""

import numpy as np

from ringpose.kernels.forms import ClosedForm, constrained_form, differentiated, paper_form
from ringpose.pose.closed_form_doubts import pose_flags, why_undetermined, why_unusable
from ringpose.pose.method import Method
from ringpose.pose.residuals import prediction_rms_px
from ringpose.pose.triangulate import triangulated
from ringpose.pose.triangulation import point_covariance
from ringpose.pose.uncertainty import PoseCovariance, pose_covariance
from ringpose.types.break_points import BreakPoints
from ringpose.types.rig import Rig
from ringpose.types.ring_points import RingPoints
from ringpose.types.ring_pose import NoPose, RingPose

FORMS = {Method.PAPER: paper_form, Method.PAPER_CONSTRAINED: constrained_form}
"""The closed form of each method."""


def closed_form_pose(
    break_points: BreakPoints, rig: Rig, method: Method = Method.PAPER_CONSTRAINED
) -> RingPose | NoPose:
    """Pose of the ring in the camera frame by one of the paper's methods, or the reason why there is none."""
    points = triangulated(break_points, rig)
    undetermined = why_undetermined(points, break_points)
    if undetermined is not None:
        return undetermined

    form, covariance = form_and_covariance(points, break_points, rig, method)
    residual = prediction_rms_px(form, points, break_points, rig)
    unusable = why_unusable(residual, covariance)
    if unusable is not None:
        return unusable

    return ring_pose(form, covariance, residual, method)


def ring_pose(form: ClosedForm, covariance: PoseCovariance | None, residual_rms_px: float, method: Method) -> RingPose:
    """The record of a batch of one."""
    radius_inner_m, radius_outer_m = form.radius_m[0].tolist()
    return RingPose(
        center_m=form.center_m[0],
        normal=form.normal[0],
        radius_inner_m=radius_inner_m,
        radius_outer_m=radius_outer_m,
        grasp_m=form.grasp_m[0],
        method=method.value,
        condition=float(form.condition[0]),
        residual_rms_px=residual_rms_px,
        covariance=None if covariance is None else covariance.parameters,
        covariance_center_m2=None if covariance is None else covariance.center_m2,
        covariance_grasp_m2=None if covariance is None else covariance.grasp_m2,
        flags=pose_flags(form, covariance),
    )


def form_and_covariance(
    points: RingPoints, break_points: BreakPoints, rig: Rig, method: Method
) -> tuple[ClosedForm, PoseCovariance | None]:
    """The method's solution, a batch of one, and its covariance.

    None if the covariance of a seen break point, or of the rig, is not finite.
    """
    laser, edges = np.nonzero(points.seen)
    positions, covariance_px2 = points.position_m[laser, edges], break_points.covariance_px2[laser, edges]
    covariance_m2 = (
        point_covariance(positions, covariance_px2, laser, rig) if np.isfinite(covariance_px2).all() else None
    )
    if covariance_m2 is None or not np.isfinite(covariance_m2).all():
        return FORMS[method](positions[None], edges), None
    form, jacobian = differentiated(positions, edges, constrained=method is Method.PAPER_CONSTRAINED)
    return form, pose_covariance(jacobian, covariance_m2)
