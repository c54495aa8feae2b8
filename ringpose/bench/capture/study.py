"""One run of a study of captures: its world is drawn, each method guides the gripper, and the outcome is scored.

A run depends only on the study and its index. All methods see the same target, robot and errors, until the ways of
their grippers differ.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from ringpose.bench.capture.guidance import GuidedRing, ring_of_pose, ring_of_track
from ringpose.bench.capture.loop import Measure, run_loop
from ringpose.bench.capture.score import CaptureOutcome, outcome_of
from ringpose.bench.capture.world import World, tumbling
from ringpose.bench.study.baselines import BASELINES
from ringpose.bench.study.shots import POSE_METHODS, failed_rows, radii_of, scene_of, setting_of, with_turned_plane
from ringpose.errors import DataError
from ringpose.measure.stream import Setup, Stream, track_options
from ringpose.pose.transform import pose_in_frame
from ringpose.simulate.appearance import expected_appearance
from ringpose.simulate.features import Deviations, draw_detection, looks_like, run_errors
from ringpose.simulate.pipeline import shot_of_view
from ringpose.types.assumptions import USUAL
from ringpose.types.capture import CaptureLine, GripperState, TrueRing
from ringpose.types.detection import Detection
from ringpose.types.image import Shot
from ringpose.types.options import Method, PoseFrame
from ringpose.types.pose import KnownRadii, PoseLine, RingPose
from ringpose.types.scene import RingView
from ringpose.types.study import CAPTURE_VECTORS, Row, Study, StudyMethod, Value, columns
from ringpose.types.target import FreeMotion

_WORLD, _COMMON, _SHOTS, _LOST, _PLANE, _RADII = 20, 21, 22, 23, 24, 25
"""First numbers of the seeds of a run: its world, its true rig and ring, its shots, those that are lost, a turned plane
and assumed radii."""

_DEVIATIONS = ("ring_tolerance_m", "displaced_share", "background_share", "missing_share")

Source = Callable[[int, float], Shot | Detection]
"""The shot of this number, which begins at this time of the run."""


def capture_rows(study: Study, index: int) -> list[Row]:
    """The rows of a run, one for each method; a run that cannot be computed gives rows with the reason."""
    try:
        return [_row(study, index, method) for method in study.methods]
    except DataError as error:
        return failed_rows(study, index, str(error))
    except Exception as error:  # a study must not end because of one run
        return failed_rows(study, index, f"{type(error).__name__}: {error}")


def _row(study: Study, index: int, method: StudyMethod) -> Row:
    begun_s, setting = perf_counter(), setting_of(study, index)
    world, source = drawn_world(study, index)
    lost_share = float(setting.get("lost_share", 0.0))
    lost = np.random.default_rng([_LOST, study.seed, index]).uniform(size=100_000) < lost_share
    assert study.capture is not None
    latency_s = float(setting.get("latency_s", study.capture.latency_s))
    radii = radii_of(world.scene, np.random.default_rng([_RADII, study.seed, index]))
    measure = measured_by(method, world, source, study, radii)
    run = run_loop(world, measure, latency_s, lambda number: bool(lost[number]))
    line = run.line(f"{index:06d}", method.value, setting)
    row: Row = {**dict.fromkeys(columns(study)), "shot": index, **setting, **row_of(line)}
    return row | {"shots": run.shots, "rings": run.rings, "run_s": perf_counter() - begun_s}


def row_of(line: CaptureLine) -> Row:
    """The cells of a run's record, with its outcome and errors."""
    scored = outcome_of(line)
    row: Row = {
        "method": line.method,
        "outcome": scored.outcome.value,
        "status": "none" if not line.is_closed else "ok",
        "reason": line.reason or None,
        "capture_probability": line.capture_probability,
    }
    if line.gripper is None or line.ring is None:
        return row
    vectors = (line.gripper.grasp_m, line.gripper.approach, line.ring.center_m, line.ring.normal)
    for name, vector in zip(CAPTURE_VECTORS, vectors, strict=True):
        row |= {f"{name}_{axis}": float(part) for axis, part in zip("xyz", vector, strict=True)}
    return row | {
        "closed_s": line.closed_s,
        "radial_error_m": scored.radial_m,
        "tilt_error_rad": scored.tilt_rad,
        "ring_radius_inner_m": line.ring.radius_inner_m,
        "ring_radius_outer_m": line.ring.radius_outer_m,
        "window_m": line.gripper.radial_m,
        "window_rad": line.gripper.tilt_rad,
    }


def line_of_row(row: Row, factors: Sequence[str]) -> CaptureLine:
    """The record of a run from its row."""
    cells: Mapping[str, Any] = row
    common: Mapping[str, Any] = {
        "run": f"{cells['shot']:06d}",
        "method": cells["method"],
        "groups": {name: cells[name] for name in factors if cells.get(name) is not None},
        "reason": cells["reason"] or "",
    }
    if cells["outcome"] in (CaptureOutcome.NO_CLOSING, CaptureOutcome.ERROR):
        return CaptureLine(**common, closed_s=math.nan)
    gripper, approach, center, normal = (
        np.array([cells[f"{name}_{axis}"] for axis in "xyz"]) for name in CAPTURE_VECTORS
    )
    return CaptureLine(
        **common,
        closed_s=cells["closed_s"],
        gripper=GripperState(
            grasp_m=gripper, approach=approach, radial_m=cells["window_m"], tilt_rad=cells["window_rad"]
        ),
        ring=TrueRing(
            center_m=center,
            normal=normal,
            radius_inner_m=cells["ring_radius_inner_m"],
            radius_outer_m=cells["ring_radius_outer_m"],
        ),
        capture_probability=cells["capture_probability"],
    )


def drawn_world(study: Study, index: int) -> tuple[World, Source]:
    """The world of a run, and the shots that its camera takes."""
    setting, loop = setting_of(study, index), study.capture
    numbers: Mapping[str, Any] = setting
    scene = scene_of(study, index, setting)
    assert loop is not None
    assert isinstance(study.scene.motion, FreeMotion)  # as read_study checks
    rng = np.random.default_rng([_WORLD, study.seed, index])
    (view,) = scene.views
    view = replace(view, roll_rad=float(rng.uniform(0.0, 2.0 * math.pi)))
    motion = tumbling(
        study.scene.motion,
        float(numbers.get("target_rate_rad_s", 0.0)),
        float(numbers.get("nutation_rad", 0.0)),
        float(numbers.get("drift_m_s", 0.0)),
        rng,
    )
    scene = replace(scene, motion=None, shots=1, period_s=loop.period_s, views=(view,))
    base = loop.base if setting.get("floating_base", False) else None
    world = World(scene, view, motion, loop, base, rng)
    return world, _source(study, index, setting, world)


def _source(study: Study, index: int, setting: Mapping[str, Value], world: World) -> Source:
    """Draws features, or renders images, with the true rig and the true form of the ring."""
    stated: Mapping[str, Any] = {name: setting[name] for name in _DEVIATIONS if name in setting}
    deviations = Deviations(rig_errors=bool(setting.get("rig_errors", False)), **stated)
    turned = with_turned_plane(world.scene.rig, setting, np.random.default_rng([_PLANE, study.seed, index]))
    scene = replace(world.scene, rig=turned)
    common = run_errors(scene, np.random.default_rng([_COMMON, study.seed, index]), deviations)
    form = common.form if common.form.any() else None
    true_scene = replace(scene, rig=common.rig, ring=replace(scene.ring, form=form))
    shown: list[RingView] = []

    def drawn(number: int, time_s: float) -> Detection:
        view = world.view_at(time_s, f"r{index:06d}_{number:04d}")
        if not shown or not looks_like(view, shown[0]):
            shown[:] = [view]
        rng = np.random.default_rng([_SHOTS, study.seed, index, number])
        appearance = expected_appearance(scene, shown[0])
        return draw_detection(scene, view, rng, deviations, common, scene.start_s + time_s, appearance).detection

    def rendered(number: int, time_s: float) -> Shot:
        view = world.view_at(time_s, f"r{index:06d}_{number:04d}")
        return shot_of_view(true_scene, view, number)[0]

    return drawn if study.level == "features" else rendered


def measured_by(method: StudyMethod, world: World, source: Source, study: Study, radii: KnownRadii) -> Measure:
    """What a method makes of the shots, as the ring that guides the gripper, at times of the run."""
    rig, start_s, options = world.scene.rig, world.scene.start_s, study.assumed or USUAL
    if method is StudyMethod.TRACK:
        stream = Stream(Setup(rig=rig, options=options), track_options(options), motion_until=world.camera_motion)

        def tracked(number: int, time_s: float) -> GuidedRing | None:
            track = stream.measure(source(number, time_s)).track
            ring = None if track is None else ring_of_track(track)
            return None if ring is None else ring.earlier(start_s)

        return tracked

    def by_itself(number: int, time_s: float) -> GuidedRing | None:
        ring = ring_of_pose(_line_in_base(method, source(number, time_s), world, study, radii))
        return None if ring is None else ring.earlier(start_s)

    return by_itself


def _line_in_base(
    method: StudyMethod, shot: Shot | Detection, world: World, study: Study, radii: KnownRadii
) -> PoseLine:
    """The line of one shot by itself, in the base frame.

    Other methods than `ml` do not know that the camera moves; their pose holds where it was at the shot's stamp.
    """
    of_pose, known = POSE_METHODS.get(method, (Method.ML, False))
    camera = world.camera_motion()
    setup = Setup(rig=world.scene.rig, method=of_pose, known=radii if known else None, options=study.assumed or USUAL)
    if of_pose is Method.ML and method in POSE_METHODS:
        return replace(setup, frame=PoseFrame.BASE, camera=camera).measure(shot)
    if method in POSE_METHODS:
        line = setup.measure(shot)
        pose: RingPose | str = line.pose or str(line.reason)
    else:
        detection = shot if isinstance(shot, Detection) else setup.detection(shot)
        line = PoseLine(shot=detection.shot, stamp_s=detection.stamp_s, pose=None)
        found = BASELINES[method](detection, setup.rig, radii_of(world.scene))
        pose = found if isinstance(found, RingPose) else str(found)
    where = camera.at(line.stamp_s)
    if not isinstance(pose, RingPose) or where is None:
        return replace(line, pose=None, reason=str(pose))
    in_base = pose_in_frame(pose, where.base_from_camera)
    return replace(line, pose=in_base, pose_stamp_s=line.stamp_s, frame=PoseFrame.BASE)
