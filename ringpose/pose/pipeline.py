"""Break points -> pose of the ring: the paper's closed form and the most likely ring, method(7) sections 4 and 5."""

from collections.abc import Sequence

import numpy as np

from ringpose.errors import DataError
from ringpose.kernels.forms import ClosedForm, constrained_form, differentiated, paper_form
from ringpose.pose.method import Method as Method
from ringpose.pose.most_likely import most_likely_pose
from ringpose.pose.observability import pose_flags, why_undetermined, why_unusable
from ringpose.pose.point_covariance import point_covariance
from ringpose.pose.residuals import prediction_rms_px
from ringpose.pose.triangulate import triangulated
from ringpose.pose.uncertainty import PoseCovariance, pose_covariance
from ringpose.types.break_points import BreakPoints, RingEdgePoints
from ringpose.types.rig import Rig
from ringpose.types.ring import KnownRadii, Ring
from ringpose.types.ring_points import RingPoints
from ringpose.types.ring_pose import NoPose, RingPose

FORMS = {Method.PAPER: paper_form, Method.PAPER_CONSTRAINED: constrained_form}
"""The closed form of each method."""


def estimate_pose(
    break_points: BreakPoints,
    rig: Rig,
    method: Method = Method.ML,
    ring_edges: RingEdgePoints | None = None,
    known: KnownRadii | Sequence[Ring] | None = None,
) -> RingPose | NoPose:
    """Pose of the ring in the camera frame, or the reason why there is none.

    Its covariances are None if a seen break point's covariance is NaN. `known` is the ring's size or a catalogue of
    rings of which it may be one; the paper's methods have no use for it, nor for visible edges.
    """
    lasers, known_lasers = len(break_points.position_px), len(rig.lasers.names)
    if lasers != known_lasers:
        found = f"they are of {lasers} lasers, the rig has {known_lasers}"
        raise DataError("break points", found, "use the rig that took the shots")
    if method is Method.ML:
        return most_likely_pose(break_points, rig, ring_edges, known)
    return closed_form_pose(break_points, rig, method)


def closed_form_pose(
    break_points: BreakPoints, rig: Rig, method: Method = Method.PAPER_CONSTRAINED
) -> RingPose | NoPose:
    """The same by one of the paper's methods."""
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
