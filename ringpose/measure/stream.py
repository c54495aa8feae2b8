"""Shots or detections -> lines: what ringpose measures, for commands, a live camera, the console, studies, notebooks.

stream = Stream(Setup(rig=rig), track=TrackOptions())
for shot in shots:
    measured = stream.measure(shot)
    print(measured.line.status, measured.track.grasp)

One shot gives one line. From shot to shot, a stream keeps what the earlier ones have shown: light planes that have
moved, a ring that is not round, and the track, which predicts where the next shot shows its stripes.

Set OPENBLAS_NUM_THREADS=1 in the environment, as the commands do: the matrices of a shot are too small for threads.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf, isfinite
from time import perf_counter
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ringpose.errors import DataError
from ringpose.estimate.nuisance import EXACT, with_stability
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.measure import status
from ringpose.pose.maximum_likelihood import most_likely_pose
from ringpose.pose.protection import overbound, protection_of, variances_by_source, with_covariance_scaled
from ringpose.pose.rig_monitor import DriftMonitor, FormMonitor
from ringpose.types.arrays import Array, Bool
from ringpose.types.assumptions import (
    IDEAL,
    MAX_RATE_DEG_S,
    MAX_SPEED_M_S,
    USUAL,
    AssumptionOptions,
    Assumptions,
    motion_prior,
)
from ringpose.types.detection import BreakPoints, Detection, JudgedRing, Rejection, RingEdgePoints, Stripes
from ringpose.types.image import Shot
from ringpose.types.options import Method, PoseFrame
from ringpose.types.pose import KnownRadii, NoPose, PoseFlag, PoseLine, PoseResult, Ring, RingPose
from ringpose.types.protection import turned
from ringpose.types.rig import NO_ROBOT_POSES, Rig
from ringpose.types.track import TrackLine

if TYPE_CHECKING:  # not imported to measure detections
    from ringpose.detect.difference_images import LaserImage
    from ringpose.detect.pipeline import Prior
    from ringpose.measure.warm_start import WarmStart
    from ringpose.track.explanations import TrackOptions

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Setup:
    """What a shot is measured with; worker processes receive it."""

    rig: Rig
    method: Method = Method.ML
    frame: PoseFrame = PoseFrame.CAMERA
    """Frame of the vectors; `tool` and `base` need the rig's mount."""
    known: KnownRadii | Sequence[Ring] | None = None
    """The ring's radii, or the catalogue that it belongs to."""
    options: AssumptionOptions = USUAL
    camera: CameraMotion | None = None
    """The camera's motion by the poses of the robot; None for a camera that counts as inertial."""
    with_budget: bool = False
    """Whether lines state the variances of their quantities by source."""
    grasp_near_px: tuple[float, float] | None = None
    """Place in the image to which the arc of the grasp point is nearest, if a shot shows both; None for its middle."""

    def detection(self, shot: Shot, prior: "Prior | None" = None) -> Detection:
        """What a shot shows; `prior`: what earlier shots have shown."""
        from ringpose.detect.pipeline import NOTHING_KNOWN, detect  # not needed for detections, and slow to import

        known = replace(prior or NOTHING_KNOWN, camera=_moving(self.camera))
        if known.assumptions is None:
            known = replace(known, assumptions=self.assumptions(shot))
        return detect(shot, self.rig, known, pixel_ends=self.method is Method.PAPER_DETECTOR)

    def assumptions(self, source: Shot | Detection) -> Assumptions:
        """What is assumed about a shot."""
        return assumptions_about(source, self.rig, self.known, self.options)

    def line(self, detection: Detection, assumptions: Assumptions | None = None) -> PoseLine:
        """The pose line of a detection by itself; `assumptions` if they are known already."""
        points = detection.break_points
        if self.grasp_near_px is not None and isinstance(points, BreakPoints):
            described = points.from_arc_near(self.grasp_near_px)
            if described is not points:
                detection = replace(detection, break_points=described, ring=None)  # it is described at the other arc
        return pose_line(
            detection,
            self.rig,
            self.method,
            self.frame,
            self.known,
            self.options,
            self.camera,
            assumptions,
            with_budget=self.with_budget,
        )

    def measure(self, source: Shot | Detection) -> PoseLine:
        """The pose line of a shot or detection by itself, whatever other shots show."""
        return self.measured(source).line

    def measured(self, source: Shot | Detection) -> "Measured":
        """The same, with shot and detection."""
        detection, line = _measured(self, source, lambda shot, _: self.detection(shot))
        return Measured(line=line, shot=source if isinstance(source, Shot) else None, detection=detection)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measured:
    """One shot of a stream."""

    line: PoseLine
    """Its pose line, with what the stream has shown about the rig and the ring."""
    track: TrackLine | None = None
    """The track after it; None in a stream without a track, or if the track cannot use the line."""
    problem: DataError | None = None
    """Why the track cannot use the line, such as a shot that was given twice."""
    warnings: tuple[str, ...] = ()
    """What the stream has shown with this shot for the first time."""
    shot: Shot | None = None
    """None if its detection was given, or another process has measured it."""
    detection: Detection | None = None
    """None if another process has measured it."""


class Stream:
    """Measures shots one after the other, each with what the earlier ones have shown.

    `track`: None for a stream without a track. `clock`: the host's clock, by which stamps in the future are noticed.
    `early`: the stripes of a frame that were found before its shot was complete. `motion_until`: the motion of the
    camera up to a stamp, for robot poses that arrive meanwhile.
    """

    def __init__(
        self,
        setup: Setup,
        track: "TrackOptions | None" = None,
        *,
        clock: Callable[[], float] = lambda: inf,
        early: "Callable[[LaserImage], Stripes | None] | None" = None,
        motion_until: Callable[[float], CameraMotion] | None = None,
    ) -> None:
        if track is not None and setup.grasp_near_px is None:  # one arc for all shots: the left one
            setup = replace(setup, grasp_near_px=(0.0, 0.5 * setup.rig.camera.image_height))
        self.setup = setup
        self._clock, self._early, self._motion_until = clock, early, motion_until
        self._drift = DriftMonitor(setup.rig, setup.rig.stability.scaled(setup.options.rig_stability))
        self._form = FormMonitor()
        self._warm = None if track is None else _warm_start(setup, track)

    @property
    def rig(self) -> Rig:
        """The rig, with the light planes that the stream has shown to have moved."""
        return self._drift.rig

    @property
    def is_tracking(self) -> bool:
        """Whether its lines have a track."""
        return self._warm is not None

    @property
    def assigns_lasers(self) -> bool:
        """Whether the track will assign the stripes of the next frame with all lasers on to their lasers."""
        return self._warm is not None and self._warm.assigns_lasers(self.rig)

    def measure(self, source: Shot | Detection) -> Measured:
        """The line of the next shot of the stream."""
        shot = source if isinstance(source, Shot) else None
        setup = replace(self.setup, rig=self.rig)
        if self._motion_until is not None:
            setup = replace(setup, camera=self._motion_until(_last_stamp_s(source)))
            if self._warm is not None:
                self._warm.tracker.camera = setup.camera
        known = None if self._warm is None else self._warm.ghost
        detection, line = _measured(setup, source, partial(self._detection, setup))
        measured = replace(self._next(line), shot=shot, detection=detection)
        ghost = None if self._warm is None else self._warm.ghost
        if ghost is known or setup.rig.ghosts.keys() >= set(setup.rig.lasers.names):
            return measured
        warning = f"the stripes have {ghost}; run ringpose calibrate-planes, so that the rig file states it"
        return replace(measured, warnings=(*measured.warnings, warning))

    def continue_after(self, line: PoseLine) -> None:
        """Take over what a line has shown about rig and ring that an earlier run of this stream has measured."""
        self._next(line)

    def outcomes(
        self,
        items: Iterable[Item],
        read: "Callable[[Item], Shot | Detection]",
        jobs: int = 1,
        *,
        with_sources: bool = False,
    ) -> Iterator[Measured | Exception]:
        """The lines of the shots that `read` reads, or why there is none, in the order of the items.

        A thread reads one shot ahead: decompressing a shot, without the interpreter's lock, takes as long as measuring
        it. Measuring holds that lock for most of its time, so that it stays in the calling thread. With several
        processes, each measures shots by themselves, and what goes from shot to shot is computed here, so that the
        lines do not depend on their number: once the stream shows that a light plane has moved, the following
        shots are measured again with the corrected rig. A track needs its shots one after the other.
        `with_sources`: with the shot and the detection of each line, also from another process.
        """
        from ringpose.processes import one_ahead, outcomes

        if jobs == 1:
            yield from map(self._outcome, one_ahead(read, items))
            return
        for outcome in outcomes(_ByItself(self.setup, read, with_sources), items, jobs):
            if isinstance(outcome, Exception):
                yield outcome
                continue
            item, alone = outcome
            if self.rig is self.setup.rig:
                yield replace(self._next(alone.line), shot=alone.shot, detection=alone.detection)
            else:
                yield from map(self._outcome, outcomes(read, [item], 1))

    def _outcome(self, source: Shot | Detection | Exception) -> Measured | Exception:
        """The line of what was read, or why there is none."""
        if isinstance(source, Exception):
            return source
        try:
            return self.measure(source)
        except Exception as error:  # as from another process; the writer of the lines raises what is no item's fault
            return error

    def _detection(self, setup: Setup, shot: Shot, assumptions: Assumptions) -> Detection:
        from ringpose.detect.pipeline import NOTHING_KNOWN

        prior = NOTHING_KNOWN if self._warm is None else self._warm.before(shot, setup.rig)
        known = setup if self._warm is None else replace(setup, rig=self._warm.with_ghost(setup.rig))
        detection = known.detection(shot, replace(prior, stripes_of=self._early, assumptions=assumptions))
        if self._warm is None:
            return detection
        self._warm.after(shot, detection, prior)
        return detection

    def _next(self, line: PoseLine) -> Measured:
        """The line with what the monitors add, and the track after it."""
        line, moved = self._drift.update(line)
        line, form = self._form.update(line)
        warnings = tuple(filter(None, [moved and f"{moved}; run ringpose calibrate-planes", form]))
        measured = Measured(line=line, warnings=warnings)
        if self._warm is None:
            return measured
        try:
            return replace(measured, track=self._warm.added(line, self._clock))
        except DataError as problem:
            return replace(measured, problem=problem)


def _last_stamp_s(source: Shot | Detection) -> float:
    """Mid exposure of the last frame of a shot, as far as a detection shows it."""
    if isinstance(source, Shot):
        return source.mid_exposure_s(-1)
    of_points = source.break_points.stamp_s if isinstance(source.break_points, BreakPoints) else None
    of_edges = None if source.ring_edges is None else source.ring_edges.stamp_s
    stamps_s = [each for each in (of_points, of_edges) if each is not None]
    return float(np.nanmax(np.concatenate([[source.stamp_s], *stamps_s])))


def _warm_start(setup: Setup, track: "TrackOptions") -> "WarmStart":
    from ringpose.measure.warm_start import WarmStart  # imports the detector
    from ringpose.track.pipeline import Tracker

    return WarmStart(Tracker(setup.rig, track, setup.camera))


@dataclass(frozen=True, slots=True, eq=False)
class _ByItself:
    """Measures a shot independently of the others; worker processes import this class."""

    setup: Setup
    read: Callable[[Any], Shot | Detection]
    with_sources: bool

    def __call__(self, item: Any) -> tuple[Any, Measured]:
        measured = self.setup.measured(self.read(item))
        return item, measured if self.with_sources else Measured(line=measured.line)


def _measured(
    setup: Setup, source: Shot | Detection, detect: Callable[[Shot, Assumptions], Detection]
) -> tuple[Detection, PoseLine]:
    """The detection and the pose line of a source, with the time that its stages took."""
    if isinstance(source, Detection):
        if setup.method is Method.PAPER_DETECTOR:
            finding = f"is a detection: method {setup.method.value} needs the pixels where the line detector ends"
            raise DataError(source.shot, finding, "give the shot")
        return source, setup.line(source)
    start_s = perf_counter()
    assumptions = setup.assumptions(source)
    detection = detect(source, assumptions)
    detect_s = perf_counter() - start_s
    line = setup.line(detection, assumptions)
    return detection, replace(line, latency_s=line.latency_s + detect_s, stage_s={"detect": detect_s, **line.stage_s})


def track_options(assumed: AssumptionOptions) -> "TrackOptions":
    """The options of a track that begins with the motion that is assumed within a shot, by default the usual one.

    A track never assumes that its target is still.
    """
    from ringpose.track.explanations import TrackOptions

    return TrackOptions(
        motion=motion_prior(assumed.max_speed_m_s or MAX_SPEED_M_S, assumed.max_rate_deg_s or MAX_RATE_DEG_S)
    )


# One shot by itself: the ring is estimated in closed form or by maximum likelihood (method(7), sections 4 and 5)


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
    assumptions: Assumptions | None = None,
    *,
    with_budget: bool = False,
) -> PoseLine:
    """The pose of one shot, or the reason why it has none, and the time that the computation took.

    `known` are the ring's radii, or the catalogue that it belongs to. `options` state what is assumed. The frames
    `tool` and `base` need the rig's mount, and the robot's poses unless that frame carries the camera; without these
    vectors and record are in the camera frame. `camera`: its motion by the robot's poses, which is removed within the
    shot; velocity and assumptions about the motion are then relative to the robot's base. None for a camera that counts
    as inertial. `assumptions`: what is assumed, if it has been derived from the options already.
    """
    assumptions = assumptions or assumptions_about(source, rig, known, options)
    located = camera or (None if rig.mount is None else CameraMotion(poses=NO_ROBOT_POSES, mount=rig.mount))
    if located is None or (camera is None and frame is not located.mount.carrier):
        frame = PoseFrame.CAMERA
    start_s = perf_counter()
    points = source.break_points
    if not isinstance(points, BreakPoints):
        return PoseLine(
            shot=source.shot,
            stamp_s=source.stamp_s,
            pose=None,
            flags=status.flags_of(status.findings_of(source)),
            reason="; ".join(filter(None, [points.value, source.advice])),
            frame=frame,
            lasers=status.unused_lasers(rig, source.lasers_on, points not in status.WITHOUT_STRIPES),
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
        _moving(camera),
        source.ring,
    )
    if located is not None and frame is not PoseFrame.CAMERA:
        result = _in_frame(result, located, frame)
    pose, rejected = result.pose, result.rejected or source.rejected
    flags = result.flags | status.flags_of(status.findings_of(source, rejected))
    protection, budget = None, dict[str, dict[str, float]]()
    if result.separation is not None and isinstance(pose, RingPose):
        separation = result.separation()
        checks_rig = PoseFlag.RIG_UNCHECKED not in flags and assumptions.stability != EXACT
        factor = overbound(separation, pose) if checks_rig else 1.0
        protection = replace(protection_of(separation, pose, options.risk, flags), sd_factor=factor)
        if with_budget and result.budget is not None:
            in_camera = frame is PoseFrame.CAMERA
            budget = variances_by_source(result.budget(), pose, separation, in_camera=in_camera, factor=factor)
        pose = with_covariance_scaled(pose, factor)
    end_s = perf_counter()
    return PoseLine(
        shot=source.shot,
        stamp_s=source.stamp_s,
        pose_stamp_s=result.stamp_s if isfinite(result.stamp_s) else source.stamp_s,
        pose=pose if isinstance(pose, RingPose) else None,
        flags=flags,
        reason=status.reason_of(result, source),
        frame=frame,
        velocity=result.velocity,
        protection=protection,
        budget=budget,
        measurement=result.measurement,
        priors=result.priors,
        lasers=result.lasers,
        rejected=rejected,
        plane_evidence=result.plane_evidence,
        latency_s=end_s - start_s,
        stage_s={"pose": end_s - start_s},
        rig=rig.sha256,
    )


def _moving(camera: CameraMotion | None) -> CameraMotion | None:
    """The motion of a camera that moves."""
    return None if camera is None or camera.is_at_rest else camera


def _in_frame(result: PoseResult, camera: CameraMotion, frame: PoseFrame) -> PoseResult:
    """The result in the frame of tool or base, with the errors of the camera's pose there."""
    if not isinstance(result.pose, RingPose):
        return result
    from ringpose.pose.transform import pose_in_frame, velocity_in_frame, with_camera_error

    where = camera.in_frame(frame, result.stamp_s)
    if where is None:
        return replace(result, pose=NoPose.NO_ROBOT_POSES, velocity=None)
    frame_from_camera, root = where
    velocity = None if result.velocity is None else velocity_in_frame(result.velocity, result.pose, frame_from_camera)
    pose = with_camera_error(pose_in_frame(result.pose, frame_from_camera), frame_from_camera[:3, 3], root)
    separation = None if result.separation is None else turned(result.separation, frame_from_camera[:3, :3])
    return replace(result, pose=pose, velocity=velocity, separation=separation)


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
        finding = f"they are of {lasers} lasers, the rig has {known_lasers}"
        raise DataError("break points", finding, "use the rig that took the shots")
    if rig.stripes_along_columns:
        from ringpose.geometry.quarter_turn import rig_along_rows, to_columns, to_rows  # for few rigs

        turn = to_rows(rig.camera)
        turned = pose_result(
            turn.break_points(break_points),
            rig_along_rows(rig),
            method,
            None if ring_edges is None else turn.edges(ring_edges),
            known,
            assumptions,
            lasers_on,
            rejected,
            turn.motion(camera),
            None if judged is None else turn.judged(judged),
        )
        return to_columns(rig.camera).result(turned)
    try:
        with np.errstate(all="ignore"):  # solutions are checked for finite values
            if method is Method.ML:
                result = most_likely_pose(
                    break_points, rig, ring_edges, known, assumptions, lasers_on, rejected, camera, judged
                )
                if result.pose is NoPose.AMBIGUOUS:
                    from ringpose.pose.mirrored import fits_if_mirrored

                    if fits_if_mirrored(break_points, rig, known, assumptions, camera):
                        return replace(result, pose=NoPose.MIRRORED)
                return result
            from ringpose.pose.closed_form import closed_form_pose  # not imported by method `ml`

            pose = closed_form_pose(break_points, with_stability(rig, assumptions.stability), method)
            if isinstance(pose, NoPose):
                return PoseResult(pose=pose, rejected=tuple(rejected))
            return PoseResult(pose=pose, flags=pose.flags, rejected=tuple(rejected))
    except np.linalg.LinAlgError:
        states = status.unused_lasers(rig, lasers_on, break_points.of_lasers)
        return PoseResult(pose=NoPose.SINGULAR, lasers=states, rejected=tuple(rejected))
