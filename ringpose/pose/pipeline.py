"""Detection -> pose line: one shot by itself; `ringpose.measure.stream` measures streams of them.

The pose is estimated in closed form or by maximum likelihood (ringpose-method(7), sections 4 and 5).
"""

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite
from time import perf_counter

import numpy as np

from ringpose.errors import DataError
from ringpose.estimate.nuisance import with_stability
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.measure import status
from ringpose.pose.maximum_likelihood import most_likely_pose
from ringpose.pose.mirrored import mirrored
from ringpose.pose.visibility import unused_lasers
from ringpose.types.arrays import Array, Bool
from ringpose.types.assumptions import IDEAL, USUAL, AssumptionOptions, Assumptions
from ringpose.types.detection import BreakPoints, Detection, JudgedRing, Rejection, RingEdgePoints
from ringpose.types.image import Shot
from ringpose.types.options import Method, PoseFrame
from ringpose.types.pose import (
    HARMLESS_FLAGS,
    KnownRadii,
    NoPose,
    PoseLine,
    PoseResult,
    Ring,
    RingPose,
)
from ringpose.types.rig import Rig


def assumptions_about(
    source: Shot | Detection, rig: Rig, known: KnownRadii | Sequence[Ring] | None, options: AssumptionOptions
) -> Assumptions:
    """What is assumed about a shot; the tolerance of a known ring of the catalogue replaces that of the options."""
    assumptions = options.about_shot(rig.stability, still=source.still)
    if isinstance(known, KnownRadii) and known.tolerance_m is not None:
        assumptions = replace(assumptions, ring_tolerance_m=known.tolerance_m)
    return assumptions


def pose_line(
    source: Detection,
    rig: Rig,
    method: Method = Method.ML,
    frame: PoseFrame = PoseFrame.CAMERA,
    known: KnownRadii | Sequence[Ring] | None = None,
    options: AssumptionOptions = USUAL,
    camera: CameraMotion | None = None,
) -> PoseLine:
    """The pose of one shot, or the reason why it has none, and the time that the computation took.

    `known` are the ring's radii, or the catalogue that it belongs to. `options` state what
    is assumed. The frame `tool` needs the rig's mount; without it vectors and record are in the camera frame. `camera`:
    its motion by the poses of the robot that carries it, which is removed within the shot; velocity and assumptions
    about the motion are then relative to the robot's base. None for a camera that counts as inertial.
    """
    assumptions = assumptions_about(source, rig, known, options)
    if frame is PoseFrame.TOOL and rig.tool_from_camera is None:
        frame = PoseFrame.CAMERA
    start_s = perf_counter()
    points = source.break_points
    findings = status.findings_of_detection(source)
    if not isinstance(points, BreakPoints):
        return PoseLine(
            shot=source.shot,
            stamp_s=source.stamp_s,
            pose=None,
            flags=status.flags_of(findings),
            reason="; ".join(filter(None, [points.value, source.advice])),
            frame=frame,
            lasers=unused_lasers(rig, source.lasers_on, points not in status.WITHOUT_STRIPES),
            rejected=source.rejected,
            latency_s=perf_counter() - start_s,
            rig=rig.sha256,
        )
    result = pose_result(
        points,
        rig,
        method,
        source.ring_edges,
        known,
        assumptions,
        source.lasers_on,
        source.rejected,
        camera,
        source.ring,
    )
    rejected = result.rejected or source.rejected
    findings |= status.findings_of_rejections(rejected, by_detector=source.rejected)
    pose, velocity = result.pose, result.velocity
    if isinstance(pose, RingPose) and frame is PoseFrame.TOOL and rig.tool_from_camera is not None:
        from ringpose.pose.transform import pose_in_frame, velocity_in_frame

        velocity = None if velocity is None else velocity_in_frame(velocity, pose, rig.tool_from_camera)
        pose = pose_in_frame(pose, rig.tool_from_camera)
    end_s = perf_counter()
    return PoseLine(
        shot=source.shot,
        stamp_s=source.stamp_s,
        pose_stamp_s=result.stamp_s if isfinite(result.stamp_s) else source.stamp_s,
        pose=pose if isinstance(pose, RingPose) else None,
        flags=result.flags | status.flags_of(findings),
        reason=status.reason_of(result, source),
        frame=frame,
        velocity=velocity,
        measurement=result.measurement,
        priors=result.priors,
        lasers=result.lasers,
        rejected=rejected,
        plane_evidence=result.plane_evidence,
        latency_s=end_s - start_s,
        stage_s={"pose": end_s - start_s},
        rig=rig.sha256,
    )


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
    judged: JudgedRing | None = None,
) -> PoseResult:
    """Pose of the ring in the camera frame, or the reason why there is none, with its assumptions and rejections.

    Its covariances are None if a seen break point's covariance is NaN. `known` are the ring's radii, or a catalogue
    that it may belong to. The paper's methods use neither `known` nor visible edges, and of the assumptions only the
    stability of the rig. `lasers_on`: which lasers were on in the shot. `rejected`: what the detector has rejected.
    `camera`: its motion by the poses of a robot, which the paper's methods do not use. `judged`: the ring by which the
    break points were judged, from which method `ml` starts.
    """
    lasers, known_lasers = len(break_points.position_px), len(rig.lasers.names)
    if lasers != known_lasers:
        found = f"they are of {lasers} lasers, the rig has {known_lasers}"
        raise DataError("break points", found, "use the rig that took the shots")
    try:
        with np.errstate(all="ignore"):  # solutions are checked for finite values
            if method is Method.ML:
                result = most_likely_pose(
                    break_points, rig, ring_edges, known, assumptions, lasers_on, rejected, camera, judged
                )
                if result.pose is NoPose.AMBIGUOUS and _fits_if_mirrored(break_points, rig, known, assumptions, camera):
                    return replace(result, pose=NoPose.MIRRORED)
                return result
            from ringpose.pose.closed_form import closed_form_pose  # not imported by method `ml`

            pose = closed_form_pose(break_points, with_stability(rig, assumptions.stability), method)
            if isinstance(pose, NoPose):
                return PoseResult(pose=pose, rejected=tuple(rejected))
            return PoseResult(pose=pose, flags=pose.flags, rejected=tuple(rejected))
    except np.linalg.LinAlgError:
        states = unused_lasers(rig, lasers_on, break_points.of_lasers)
        return PoseResult(pose=NoPose.SINGULAR, lasers=states, rejected=tuple(rejected))


def _fits_if_mirrored(
    break_points: BreakPoints,
    rig: Rig,
    known: KnownRadii | Sequence[Ring] | None,
    assumptions: Assumptions,
    camera: CameraMotion | None,
) -> bool:
    """Whether the mirror image of the break points is that of a ring, with all ends and without any contradiction.

    It holds for none of 107 drawn shots that have no pose because a stripe is on another surface.
    """
    if not break_points.seen.all():
        return False
    result = most_likely_pose(mirrored(break_points, rig.camera), rig, None, known, assumptions, camera=camera)
    return isinstance(result.pose, RingPose) and not result.rejected and not result.flags & ~HARMLESS_FLAGS
