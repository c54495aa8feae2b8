"""One shot of a study: simulated, measured by every method, scored (ringpose-bench(1)).

This is the only module of `bench` that simulates shots and estimates their poses. A shot depends only on the study and
its index. Before it, a run has shots of the same target: it has a constant velocity and constant rates across its
normal in the camera frame, as `ringpose pose` assumes within a shot, and is in the pose of the study's factors at the
beginning of the last shot.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import isfinite
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ringpose.bench.design.bounds import Bound, cramer_rao, determined_quantities
from ringpose.bench.design.rig_changes import with_changes, with_surface
from ringpose.bench.score import FLAGS_OF_QUANTITY, Judgement, Score, estimate_of, score
from ringpose.bench.study.baselines import BASELINES
from ringpose.errors import DataError
from ringpose.estimate.covariance import standard_deviation
from ringpose.geometry.rotations import tilt_basis, tilted
from ringpose.measure.stream import Measured, Setup, Stream, pose_line, track_options
from ringpose.pose.advice import RADIUS_SD_M
from ringpose.simulate.features import Deviations, drawn_features, run_errors
from ringpose.simulate.motion import SteadyPath, moved_view
from ringpose.simulate.pipeline import simulated_shot
from ringpose.simulate.placement import ring_rotation, ring_views
from ringpose.types.arrays import Array, Float64
from ringpose.types.assumptions import NOISE_ONLY, AssumptionOptions, MotionPrior
from ringpose.types.detection import BreakPoints, Detection
from ringpose.types.image import Shot
from ringpose.types.options import Method
from ringpose.types.pose import HARMLESS_FLAGS, KnownRadii, NoPose, PoseLine, RingPose
from ringpose.types.rig import Rig
from ringpose.types.scene import Approach, Scene
from ringpose.types.study import (
    CASE,
    DRAWN_FAULTS,
    FAULTS,
    NO_FAULT,
    SURFACES,
    Factor,
    Row,
    ShotRun,
    Study,
    StudyMethod,
    Value,
    columns,
)
from ringpose.types.truth import Truth

_FACTORS, _SCENE, _RIG, _RADII, _MOTION, _PLANE, _CASE, _FAULT = 10, 11, 12, 13, 14, 15, 16, 17
"""First numbers of the seeds of a shot's factors, scene, true rig, assumed radii, motion, plane, case, faults."""

POSE_METHODS = {
    StudyMethod.ML: (Method.ML, False),
    StudyMethod.ML_KNOWN: (Method.ML, True),
    StudyMethod.PAPER: (Method.PAPER, False),
    StudyMethod.PAPER_CONSTRAINED: (Method.PAPER_CONSTRAINED, False),
    StudyMethod.PAPER_DETECTOR: (Method.PAPER_DETECTOR, False),
}
"""The methods of `ringpose pose`, and whether they are given the radii."""

PLANE_TILT_RAD, FORM_M, FASTER, RADIUS_SHARE = (0.0017, 0.0175), 1e-3, 4.0, (0.01, 0.1)
"""What is wrong in shots with the faults `plane`, `form`, `motion` and `radius`."""

_DEVIATIONS = ("rig_errors", "ring_tolerance_m", "displaced_share", "background_share", "missing_share")
"""Factors that are attributes of `Deviations`."""

WITH_RADII = (StudyMethod.ML_KNOWN, StudyMethod.ELLIPSE, StudyMethod.ELLIPSE_REFINED)
"""The methods that are given the radii, to which the bound for known radii applies."""

WITH_OWN_DETECTION = (StudyMethod.TRACK, StudyMethod.PAPER_DETECTOR)
"""The methods that detect for themselves."""

ERROR = "error"
"""Outcome of a shot whose computation failed."""


class StudyShot(NamedTuple):
    """A simulated shot with its truth, as the last one of its run of shots."""

    setting: Mapping[str, Value]
    scene: Scene
    """The scene with the rig that measures; the shot itself may have been taken by another one, of other surfaces."""
    run: tuple[Shot | Detection, ...]
    """Shots of the run, this one last."""
    truth: Truth
    """Truth of the last shot of the run."""
    simulate_s: float
    """Time that the simulation of all shots of the run took."""


def study_rows(study: Study, index: int) -> list[Row]:
    """The rows of a shot, one for each method; a shot that cannot be computed gives rows with the reason."""
    setting = setting_of(study, index)
    try:
        return list(_rows(study, index, study_shot(study, index, setting)))
    except DataError as error:
        return failed_rows(study, index, str(error))
    except Exception as error:  # a study of 10^5 shots must not end because of one
        return failed_rows(study, index, f"{type(error).__name__}: {error}")


def failed_rows(study: Study, index: int, reason: str) -> list[Row]:
    """The rows of a shot that could not be computed, with the reason."""
    empty: Row = dict.fromkeys(columns(study))
    common = {"shot": index, **setting_of(study, index), "outcome": ERROR, "status": "none", "reason": reason}
    return [{**empty, **common, "method": method.value} for method in study.methods]


def setting_of(study: Study, index: int) -> dict[str, Value]:
    """The values of the factors of a shot; shots go through the cells of the grid in turn, the last factor fastest.

    With cases, the shots of one turn have the same drawn values, except for those of the case.
    """
    cell = index % study.cells
    values: dict[str, Value] = {}
    for factor in reversed(study.grid):
        cell, place = divmod(cell, len(factor.values))
        values[factor.name] = factor.values[place]
    rng = np.random.default_rng([_FACTORS, study.seed, _turn(study, index)])
    values |= {factor.name: _drawn(factor, rng) for factor in study.factors if factor.drawn}
    rng = np.random.default_rng([_CASE, study.seed, index])
    values |= {factor.name: _drawn(factor, rng) for factor in study.cases.get(str(values.get(CASE)), ())}
    return {factor.name: values[factor.name] for factor in study.factors}


def _turn(study: Study, index: int) -> int:
    """The number that shots with the same drawn values and the same random view have in common, for their seeds."""
    return index // study.cells if study.cases else index


def _drawn(factor: Factor, rng: np.random.Generator) -> Value:
    if factor.uniform is not None:
        return float(rng.uniform(*factor.uniform))
    if factor.shares:
        return factor.values[int(rng.choice(len(factor.values), p=factor.shares))]
    return factor.values[int(rng.integers(len(factor.values)))]


def study_shot(study: Study, index: int, setting: Mapping[str, Value]) -> StudyShot:
    """Simulate a shot of a study: its images are rendered, or its features drawn."""
    start_s = perf_counter()
    drawn = _with_faults(setting, np.random.default_rng([_FAULT, study.seed, index]))
    scene = scene_of(study, index, drawn)
    stated: Mapping[str, Any] = {name: drawn[name] for name in _DEVIATIONS if name in drawn}
    deviations = Deviations(faults=tuple(each for each in faults_in(setting) if each in DRAWN_FAULTS), **stated)
    turned = with_turned_plane(scene.rig, drawn, np.random.default_rng([_PLANE, study.seed, index]))
    taken_by = replace(scene, rig=turned)
    for name in str(drawn[SURFACES]).split("+") if SURFACES in drawn else ():
        taken_by = with_surface(taken_by, study.surfaces[name])
    run: list[tuple[Shot | Detection, Truth]]
    if study.level == "features":
        run = [(one.detection, one.truth) for one in drawn_features(taken_by, deviations)]
    else:
        rig, form = run_errors(taken_by, np.random.default_rng([_RIG, study.seed, index]), deviations)
        taken_by = replace(taken_by, rig=rig, ring=replace(taken_by.ring, form=form if form.any() else None))
        run = [simulated_shot(taken_by, taken_by.views, number) for number in range(len(taken_by.views))]
    measured_by = scene if study.rig is None else replace(scene, rig=study.rig)
    sources, truths = zip(*run, strict=True)
    return StudyShot(setting, measured_by, sources, truths[-1], perf_counter() - start_s)


def faults_in(setting: Mapping[str, Value]) -> list[str]:
    """Names of the faults of a shot."""
    return [name for name in str(setting.get(FAULTS, NO_FAULT)).split("+") if name != NO_FAULT]


def _with_faults(setting: Mapping[str, Value], rng: np.random.Generator) -> Mapping[str, Value]:
    """The setting of a shot with the faults of its run, of which the estimator does not know."""
    faults, numbers = faults_in(setting), dict[str, Any](setting)
    if "plane" in faults:
        numbers["plane_tilt_rad"] = float(np.exp(rng.uniform(*np.log(PLANE_TILT_RAD))))
    if "form" in faults:
        numbers["ring_tolerance_m"] = FORM_M
    if "motion" in faults:
        numbers |= {name: FASTER * numbers[name] for name in ("speed_sd_m_s", "rate_sd_rad_s") if name in numbers}
    return numbers


def scene_of(study: Study, index: int, setting: Mapping[str, Value]) -> Scene:
    """The scene of one shot: a random view, with a seed of its own, or a run of views that ends in it."""
    seed = int(np.random.SeedSequence([_SCENE, study.seed, _turn(study, index)]).generate_state(1)[0])
    numbers: Mapping[str, Any] = setting
    scene = with_changes(study.scene, setting)
    approach = Approach(
        count=1,
        distances_m=(numbers["distance_m"],),
        lights=(str(setting.get("light", next(iter(scene.lights)))),),
        seed=0,
        name=f"s{index:06d}_z",
        target="body" if setting.get("target") == "body" else "ring",
        **{name: numbers[name] for name in ("tilt_rad", "clock_rad", "offset", "whole") if name in setting},
    )
    scene = replace(scene, seed=seed, views=(), approaches=(approach,), camera_boards=None, plane_boards=None)
    # as a view of its own, whose appearance is then computed once for the shot and its bound
    rng = np.random.default_rng([_MOTION, study.seed, index])
    return with_run(replace(scene, views=ring_views(scene)[:], approaches=()), study.run, _motion(setting), rng)


def with_turned_plane(rig: Rig, setting: Mapping[str, Value], rng: np.random.Generator) -> Rig:
    """The rig with one light plane, drawn, turned by the setting's `plane_tilt_rad` about its projector."""
    tilt_rad = float(setting.get("plane_tilt_rad", 0.0))
    if not tilt_rad:
        return rig
    laser, direction_rad = int(rng.integers(len(rig.lasers.names))), rng.uniform(0.0, 2.0 * math.pi)
    normal, distance_m = rig.lasers.normal.copy(), rig.lasers.distance_m.copy()
    direction = np.array([math.cos(direction_rad), math.sin(direction_rad)])
    normal[laser] = tilted(rig.lasers.normal[laser], math.tan(tilt_rad) * direction)
    distance_m[laser] += (normal[laser] - rig.lasers.normal[laser]) @ rig.lasers.projector_m[laser]
    return replace(rig, lasers=replace(rig.lasers, normal=normal, distance_m=distance_m))


def _motion(setting: Mapping[str, Value]) -> MotionPrior | None:
    """The distribution of the target's motion; None if it is still."""
    numbers: Mapping[str, Any] = setting
    speed, rate = float(numbers.get("speed_sd_m_s", 0.0)), float(numbers.get("rate_sd_rad_s", 0.0))
    return MotionPrior(speed_sd_m_s=speed, rate_sd_rad_s=rate) if speed or rate else None


def options_of(study: Study, setting: Mapping[str, Value]) -> AssumptionOptions:
    """What the estimator assumes about a shot of this setting: by default the distributions that it was drawn from."""
    if study.assumed is not None:
        return study.assumed
    numbers: Mapping[str, Any] = setting
    motion = _motion(setting)
    return AssumptionOptions(
        still=motion is None,
        max_speed_m_s=None if motion is None else 2.0 * motion.speed_sd_m_s,
        max_rate_deg_s=None if motion is None else math.degrees(2.0 * motion.rate_sd_rad_s),
        ring_tolerance_m=float(numbers.get("ring_tolerance_m", 0.0)),
        rig_stability=1.0 if setting.get("rig_errors", False) else 0.0,
    )


def _rows(study: Study, index: int, shot: StudyShot) -> Iterator[Row]:
    rig, truth, options = shot.scene.rig, shot.truth, options_of(study, shot.setting)
    rng = np.random.default_rng([_RADII, study.seed, index])
    radii = radii_of(shot.scene, rng)
    if "radius" in faults_in(shot.setting):
        radii = replace(radii, radius_m=radii.radius_m * (1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(*RADIUS_SHARE)))
    result = run_result(shot.run, rig, study.methods, radii, options)
    known = {method in WITH_RADII for method in study.methods}
    shown = shown_by(shot.scene, known) if study.bounds else shown_in(truth, known)
    points, edges = result.detection.break_points, result.detection.ring_edges
    common: Row = {
        "shot": index,
        **shot.setting,
        "expect": truth.expect,
        "stripes": shown.stripes,
        "break_points": int(points.seen.sum()) if isinstance(points, BreakPoints) else 0,
        "edge_points": 0 if edges is None else len(edges.edge),
        **_by_axis("true_center_{}_m", truth.center_m),
        **_by_axis("true_normal_{}", truth.normal),
        "simulate_s": shot.simulate_s,
        "detect_s": result.detect_s,
    }
    empty: Row = dict.fromkeys(columns(study))
    for method in study.methods:
        line = result.lines[method]
        estimate = replace(estimate_of(line, truth.shot), method=method.value)
        # the grasp point of a track moves with the ring, also out of the arc that the stripes of the last shot span
        scored = score(truth, estimate, method.value, None if method is StudyMethod.TRACK else rig.camera)
        row = {**empty, **common, **_scored(scored, line, truth), "pose_s": result.pose_s[method]}
        row["determined"] = " ".join(shown.determined[method in WITH_RADII])
        bound = None if method is StudyMethod.TRACK else shown.bounds[method in WITH_RADII]
        if bound is not None:
            row |= {f"bound_{name}": value for name, value in bound.standard_deviations.items()}
        yield {name: None if isinstance(value, float) and not isfinite(value) else value for name, value in row.items()}


class RunResult(NamedTuple):
    """What the methods make of a run of shots."""

    lines: Mapping[StudyMethod, PoseLine]
    """Their lines of the last shot."""
    pose_s: Mapping[StudyMethod, float]
    """Time that each method took for the run after its detection."""
    detection: Detection
    """Detection of the last shot."""
    detect_s: float
    """Time that the detection of the run took."""


def run_result(
    run: Sequence[Shot | Detection],
    rig: Rig,
    methods: Sequence[StudyMethod],
    radii: KnownRadii,
    options: AssumptionOptions,
) -> RunResult:
    """The lines of a run of shots by each method.

    The methods of `ringpose pose` measure the run as a stream: the line of the last shot is by the rig that the earlier
    ones have corrected. The first of them detects for the others, but for a track, which predicts what the shots show,
    and for `paper-detector`, which has break points of its own.
    """
    shared = [method for method in methods if method in POSE_METHODS and method not in WITH_OWN_DETECTION]
    detecting = next(iter(shared), StudyMethod.ML)
    detections: list[Detection] = []
    lines, pose_s, detect_s = {}, {}, 0.0
    for method in dict.fromkeys([detecting, *methods]):
        start_s = perf_counter()
        if method in BASELINES:
            lines[method] = _baseline_line(method, detections[-1], rig, radii)
            pose_s[method] = perf_counter() - start_s
            continue
        of_pose, known = POSE_METHODS.get(method, (Method.ML, False))
        setup = Setup(rig=rig, method=of_pose, known=radii if known else None, options=options)
        is_track, has_own = method is StudyMethod.TRACK, method in WITH_OWN_DETECTION
        stream = Stream(setup, track_options(options) if is_track else None)
        measured = [stream.measure(source) for source in (run if has_own or not detections else detections)]
        detection_s = sum(result.line.stage_s.get("detect", 0.0) for result in measured)
        lines[method] = _line_of_track(measured[-1]) if is_track else measured[-1].line
        pose_s[method] = perf_counter() - start_s - detection_s
        if method is detecting:
            detections = [result.detection for result in measured if result.detection is not None]
            detect_s = detection_s
    return RunResult(lines, pose_s, detections[-1], detect_s)


def _baseline_line(method: StudyMethod, detection: Detection, rig: Rig, radii: KnownRadii) -> PoseLine:
    """The line of one of the older methods."""
    pose = BASELINES[method](detection, rig, radii)
    of_shot = partial(PoseLine, shot=detection.shot, stamp_s=detection.stamp_s, pose_stamp_s=detection.stamp_s)
    if isinstance(pose, RingPose):
        return of_shot(pose=pose)
    return of_shot(pose=None, reason=pose.value if isinstance(pose, NoPose) else pose)


def _line_of_track(measured: Measured) -> PoseLine:
    """The line of a shot with the pose of the track through the stream instead of its own."""
    line, track = measured.line, measured.track
    if track is None:
        return replace(line, pose=None, reason=str(measured.problem))
    return PoseLine(
        shot=line.shot,
        stamp_s=line.stamp_s,
        pose_stamp_s=track.stamp_s,
        pose=track.pose,
        reason=None if track.pose is not None else f"the track is {track.validity}",
        flags=track.flags,
        velocity=track.velocity,
        protection=track.protection,
    )


class Shown(NamedTuple):
    """What the image of a view shows of its ring, in features without errors."""

    stripes: int
    """Number of lasers of whose stripe on the face an end is in view."""
    bounds: Mapping[bool, Bound | None]
    """Cramér-Rao bounds without and with known radii; None where the ring is not determined."""
    determined: Mapping[bool, tuple[str, ...]]
    """Names of the quantities that are determined within the limits of their flags, without and with known radii."""


def shown_by(scene: Scene, with_radii: Iterable[bool]) -> Shown:
    """What the scene's last view shows by the break points and edges in its image, without motion."""
    if scene.views[-1].path is not None or len(scene.views) > 1:
        scene = replace(scene, views=(replace(scene.views[-1], path=None),))
    exact = next(drawn_features(scene, Deviations(noise=False))).detection
    points, radii = exact.break_points, {False: None, True: radii_of(scene)}
    arcs = points.arcs if isinstance(points, BreakPoints) else ()
    lines = {known: pose_line(exact, scene.rig, known=radii[known], options=NOISE_ONLY) for known in with_radii}
    bounds = {known: cramer_rao(line) for known, line in lines.items()}
    inner_m = scene.ring.radius_inner_m
    return Shown(
        stripes=int(np.any([arc.seen.any(axis=1) for arc in arcs], axis=0).sum()) if arcs else 0,
        bounds=bounds,
        determined={known: determined_quantities(exact, lines[known], bounds[known], inner_m) for known in lines},
    )


def shown_in(truth: Truth, with_radii: Iterable[bool]) -> Shown:
    """The same without bounds: the stripes of which the truth has an end in the image."""
    ends_px, known = truth.break_points_px, tuple(with_radii)
    stripes = 0 if ends_px is None else int(np.any(np.isfinite(ends_px).all(axis=-1), axis=1).sum())
    return Shown(stripes=stripes, bounds=dict.fromkeys(known), determined=dict.fromkeys(known, ()))


def radii_of(scene: Scene, rng: np.random.Generator | None = None) -> KnownRadii:
    """The radii of the scene's ring as a prior of the estimator; with `rng`, they have errors drawn from that prior."""
    radius_m, sd_m = np.array([scene.ring.radius_inner_m, scene.ring.radius_outer_m]), np.full(2, RADIUS_SD_M)
    return KnownRadii(radius_m=radius_m if rng is None else radius_m + sd_m * rng.standard_normal(2), sd_m=sd_m)


def _by_axis(name: str, vector: Float64[Array, "xyz=3"] | None) -> Row:
    """A column for each axis; none without a vector."""
    return {} if vector is None else {name.format(axis): float(part) for axis, part in zip("xyz", vector, strict=True)}


def _scored(scored: Score, line: PoseLine, truth: Truth) -> Row:
    """Outcome, errors and reported standard deviations of a method."""
    row: Row = {
        "method": scored.method,
        "outcome": str(scored.outcome),
        "status": scored.status,
        "reason": line.reason,
        "flags": " ".join(line.flag_names),
        "wrong": " ".join(scored.wrong),
        "gross": " ".join(scored.gross),
        "correct": " ".join(name for name, judgement in scored.judgements.items() if judgement is Judgement.CORRECT),
        "reported": " ".join(
            name for name in scored.judgements if not line.flags & FLAGS_OF_QUANTITY[name] & ~HARMLESS_FLAGS
        ),
        **{name: float(value) for name, value in scored.errors.items()},
        **{f"error_{name}": each.error for name, each in scored.levels.items()},
        **{f"level_{name}": each.level for name, each in scored.levels.items()},
    }
    pose = line.pose
    if pose is None:
        return row
    if truth.normal is not None and "normal_rad" in scored.errors:
        row["pitch_rad"] = pose.pitch_rad - math.atan2(-truth.normal[1], math.hypot(truth.normal[0], truth.normal[2]))
        row["yaw_rad"] = pose.yaw_rad - math.atan2(-truth.normal[0], -truth.normal[2])
    if pose.covariance_center_m2 is not None:
        row["sigma_center_m"] = _root(np.trace(pose.covariance_center_m2))
    if pose.covariance is not None:
        row["sigma_normal_rad"] = _root(np.trace(pose.covariance[:2, :2]))
        row["sigma_radius_outer_m"] = _root(pose.covariance[6, 6])
    if pose.covariance_grasp_m2 is not None and np.isfinite(pose.covariance_grasp_m2).all():
        row["sigma_grasp_m"] = standard_deviation(pose.covariance_grasp_m2)
    return row


def _root(variance: Any) -> float | None:
    return math.sqrt(variance) if math.isfinite(variance) and variance >= 0 else None


# Shots in succession: a target in steady motion, and its track


def with_run(scene: Scene, run: ShotRun, prior: MotionPrior | None, rng: np.random.Generator) -> Scene:
    """The scene of one view as a run of shots, the last of which begins in the pose of the view.

    The motion is drawn from `prior`; without one the target is still.
    """
    (view,) = scene.views
    if run.shots == 1 and prior is None:
        return scene
    names = [f"{view.name}_{number:04d}" for number in range(run.shots - 1)]
    in_run = partial(replace, scene, shots=run.shots, period_s=run.period_s)
    if prior is None:
        return in_run(views=(*(replace(view, name=name) for name in names), view))
    unit = rng.standard_normal(5)
    path = SteadyPath(
        center_m=view.center_m,
        rotation=ring_rotation(view.normal, view.roll_rad),
        face_m=np.array([0.0, 0.0, scene.ring.height_m]),
        velocity_m_s=prior.speed_sd_m_s * unit[:3],
        angular_velocity_rad_s=prior.rate_sd_rad_s * unit[3:] @ tilt_basis(view.normal),
    )
    begins_s = (run.period_s * np.arange(1 - run.shots, 0)).tolist()
    before = [moved_view(view, path, begin_s, path.face_m, name) for name, begin_s in zip(names, begins_s, strict=True)]
    return in_run(views=(*before, replace(view, path=path)))
