"""Detection -> pose of the ring: closed form or maximum likelihood (ringpose-method(7), sections 4 and 5)."""

from collections.abc import Sequence

import numpy as np

from ringpose.errors import DataError
from ringpose.estimate.nuisance import with_stability
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.pose.maximum_likelihood import most_likely_pose
from ringpose.types.arrays import Array, Bool
from ringpose.types.assumptions import IDEAL, Assumptions
from ringpose.types.detection import BreakPoints, Rejection, RingEdgePoints
from ringpose.types.options import Method as Method
from ringpose.types.pose import KnownRadii, NoPose, PoseFlag, PoseResult, Ring, RingPose
from ringpose.types.rig import Rig


def estimate_pose(
    break_points: BreakPoints,
    rig: Rig,
    method: Method = Method.ML,
    ring_edges: RingEdgePoints | None = None,
    known: KnownRadii | Sequence[Ring] | None = None,
    assumptions: Assumptions = IDEAL,
) -> RingPose | NoPose:
    """Pose of the ring in the camera frame, or the reason why there is none; see `pose_result`."""
    return pose_result(break_points, rig, method, ring_edges, known, assumptions).pose


def pose_result(
    break_points: BreakPoints,
    rig: Rig,
    method: Method = Method.ML,
    ring_edges: RingEdgePoints | None = None,
    known: KnownRadii | Sequence[Ring] | None = None,
    assumptions: Assumptions = IDEAL,
    lasers_on: Bool[Array, "laser"] | None = None,
    rejected: Sequence[Rejection] = (),
    camera: CameraMotion | None = None,
) -> PoseResult:
    """Pose of the ring in the camera frame, or the reason why there is none, with what it assumes and rejected.

    Its covariances are None if a seen break point's covariance is NaN. `known` are the ring's radii, or a
    catalogue that it may belong to; the paper's methods use neither it nor visible edges, and of the assumptions only
    the stability of the rig. `lasers_on`: which lasers were on in the shot. `rejected`: what the detector has rejected.
    `camera`: its motion by the poses of a robot, which the paper's methods do not use.
    """
    lasers, known_lasers = len(break_points.position_px), len(rig.lasers.names)
    if lasers != known_lasers:
        found = f"they are of {lasers} lasers, the rig has {known_lasers}"
        raise DataError("break points", found, "use the rig that took the shots")
    try:
        with np.errstate(all="ignore"):  # solutions are checked for finite values
            if method is Method.ML:
                return most_likely_pose(break_points, rig, ring_edges, known, assumptions, lasers_on, rejected, camera)
            from ringpose.pose.closed_form import closed_form_pose  # not imported by method `ml`

            pose = closed_form_pose(break_points, with_stability(rig, assumptions.stability), method)
            flags = PoseFlag(0) if isinstance(pose, NoPose) else pose.flags
            return PoseResult(pose=pose, flags=flags, rejected=tuple(rejected))
    except np.linalg.LinAlgError:
        return PoseResult(pose=NoPose.SINGULAR)
