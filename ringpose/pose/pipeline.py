"""Detection -> pose line: one shot by itself; `ringpose.measure.stream` measures streams of them.

The pose is estimated in closed form or by maximum likelihood (ringpose-method(7), sections 4 and 5).
"""

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite
from time import perf_counter
from types import MappingProxyType

import numpy as np

from ringpose.errors import DataError
from ringpose.estimate.covariance import standard_deviation
from ringpose.estimate.nuisance import with_stability
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.pose.maximum_likelihood import most_likely_pose
from ringpose.pose.visibility import unused_lasers
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.assumptions import IDEAL, USUAL, AssumptionOptions, Assumptions
from ringpose.types.detection import BreakPoints, Detection, JudgedRing, NoBreakPoints, Rejection, RingEdgePoints
from ringpose.types.image import Shot
from ringpose.types.options import Method, PoseFrame
from ringpose.types.pose import (
    HARMLESS_FLAGS,
    KnownRadii,
    LaserState,
    NoPose,
    PoseFlag,
    PoseLine,
    PoseResult,
    Ring,
    RingPose,
)
from ringpose.types.rig import Rig

RADIUS_SD_M = 0.0005
"""Standard deviation assumed for a radius that the user looks up."""


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
    ambient = PoseFlag.AMBIENT_CHANGED if source.ambient_changed else PoseFlag(0)
    if not isinstance(points, BreakPoints):
        return PoseLine(
            shot=source.shot,
            stamp_s=source.stamp_s,
            pose=None,
            flags=(PoseFlag.ASSIGNMENT_AMBIGUOUS if points in CONTRADICTED else PoseFlag(0)) | ambient,
            reason="; ".join(filter(None, [points.value, source.advice])),
            frame=frame,
            lasers=unused_lasers(rig, source.lasers_on, points not in WITHOUT_STRIPES),
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
    doubtful = PoseFlag.INCONSISTENT if edges_missing(source.rejected) else PoseFlag(0)
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
        flags=result.flags | flags_of(rejected) | ambient | doubtful,
        reason=_reason(result, source),
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
                return most_likely_pose(
                    break_points, rig, ring_edges, known, assumptions, lasers_on, rejected, camera, judged
                )
            from ringpose.pose.closed_form import closed_form_pose  # not imported by method `ml`

            pose = closed_form_pose(break_points, with_stability(rig, assumptions.stability), method)
            flags = PoseFlag(0) if isinstance(pose, NoPose) else pose.flags
            return PoseResult(pose=pose, flags=flags, rejected=tuple(rejected))
    except np.linalg.LinAlgError:
        states = unused_lasers(rig, lasers_on, break_points.of_lasers)
        return PoseResult(pose=NoPose.SINGULAR, lasers=states, rejected=tuple(rejected))


def _reason(result: PoseResult, source: Detection) -> str | None:
    """Why there is no pose, or what contradicts it, and what would improve the shot; None if there is neither."""
    why = result.pose.value if isinstance(result.pose, NoPose) else contradictions(result, source.rejected)
    limited = isinstance(result.pose, NoPose) or source.ambient_changed or result.flags & ~HARMLESS_FLAGS
    changed = "ambient light changed within the shot" if source.ambient_changed else ""
    return "; ".join(filter(None, [why, changed, source.advice if limited else ""])) or None


WITHOUT_STRIPES = (
    NoBreakPoints.NO_LASER_FRAME,
    NoBreakPoints.IMAGE_DARK,
    NoBreakPoints.IMAGE_SATURATED,
    NoBreakPoints.NO_STRIPE,
    NoBreakPoints.AMBIENT_CHANGED,
)
"""Reasons of shots in which no stripe was found or searched."""

CONTRADICTED = (
    NoBreakPoints.AMBIGUOUS_LABELS,
    NoBreakPoints.CONTRADICTED_MASKS,
    NoBreakPoints.CONTRADICTED_RIG,
    NoBreakPoints.UPSIDE_DOWN,
    NoBreakPoints.DARK_FRAME_LIT,
)
"""Reasons of shots whose stripes fit no ring as the rig and the lasers' masks assign them."""

FLAG_OF_REJECTION = MappingProxyType(
    {
        "point": PoseFlag.POINT_REJECTED,
        "stripe": PoseFlag.STRIPE_REJECTED,
        "edge": PoseFlag.EDGE_REJECTED,
        "assignment": PoseFlag.ASSIGNMENT_AMBIGUOUS,
        "radius": PoseFlag.RADIUS_INCONSISTENT,
    }
)
"""The flag that reports each kind of rejection."""


def flags_of(rejected: Sequence[Rejection]) -> PoseFlag:
    """The flags that report rejections."""
    flags = PoseFlag(0)
    for each in rejected:
        flags |= FLAG_OF_REJECTION[each.what]
    return flags


def edges_missing(rejected_by_detector: Sequence[Rejection]) -> bool:
    """Whether ambient light should show the ring's edges, but the detector found none.

    Then nothing shows that the stripes end at the edges of a ring.
    """
    return any(each.what == "edge" for each in rejected_by_detector)


REMARKS = MappingProxyType(
    {
        PoseFlag.BLUNT_EDGE: "the ring's edges are rounded or chamfered",
        PoseFlag.SATURATED: "a break point could not be measured, as its stripe is saturated",
        PoseFlag.TRUNCATED: "a break point could not be measured, as its stripe is cut off by the image's border",
    }
)
"""What a flag means, in words, for flags that do not come from a contradiction."""


def contradictions(result: PoseResult, rejected: Sequence[Rejection]) -> str | None:
    """What was rejected or is missing, in words; None if everything that should be in view was used and agreed."""
    missing = [name for name, state in result.lasers.items() if state is LaserState.NOT_SEEN]
    remarks = [result.remark, rejection_remark(rejected)]
    if edges_missing(rejected):
        remarks.append("the ambient light should show the ring's edges, but they were not found")
    remarks += [f"the stripe of laser {name} should be in view, but was not found" for name in missing]
    remarks += [remark for flag, remark in REMARKS.items() if flag in result.flags]
    return "; ".join(filter(None, remarks)) or None


def rejection_remark(rejected: Sequence[Rejection]) -> str:
    """The break points and stripes that the detector rejected, in words; empty if there are none."""
    names = [f"the {each.edge} break point of laser {each.laser}" for each in rejected if each.what == "point"]
    names += [f"the stripe of laser {each.laser}" for each in rejected if each.what == "stripe"]
    if not names:
        return ""
    verbs = ("contradict", "were") if len(names) > 1 else ("contradicts", "was")
    return f"{' and '.join(names)} {verbs[0]} the others and {verbs[1]} left out"


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
