"""study.yaml, the input of `ringpose bench study`; man/ringpose-study.5 documents its keys."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import degrees
from pathlib import Path
from typing import Annotated, Literal, cast

import numpy as np

from ringpose.errors import DataError, UsageError
from ringpose.files.io import read_bytes
from ringpose.files.records.codec import OF_FILE, RecordType, definition_of
from ringpose.files.scenes.scene import read_scene
from ringpose.files.schema import FREE_PREFIX, STUDY, Fields, hint
from ringpose.files.yaml import read_yaml
from ringpose.types import plausible
from ringpose.types.assumptions import RISK, AssumptionOptions, RigStability
from ringpose.types.capture import CaptureLoop
from ringpose.types.record import Key, Presence
from ringpose.types.rig import Rig
from ringpose.types.scene import Scene
from ringpose.types.session import parsed_sequence
from ringpose.types.study import (
    CAPTURE_LIMITS,
    CASE,
    DRAWN_FAULTS,
    FAULTS,
    LIMITS,
    NO_FAULT,
    NUMBERS,
    ONLY_CAPTURE,
    ONLY_FEATURES,
    RUN_FAULTS,
    SURFACES,
    SWITCHES,
    Drawn,
    Factor,
    Factors,
    Limits,
    ShotRun,
    Study,
    StudyMethod,
    Surface,
    Value,
)
from ringpose.types.target import FreeMotion

SCHEMA = "study/1"

PRESETS = Path(__file__).parent / "presets"

MAX_SHOTS = 100_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class AssumeEntry:
    """The key `assume` of a study; what is missing has the default of `ringpose pose`."""

    still: Annotated[bool, Key("Whether the target is known to be still.", presence=Presence.IF_KNOWN)] = False
    max_speed_m_s: Annotated[
        float | None,
        Key(
            "Two standard deviations per axis of the velocity of the ring's centre.",
            plausible=plausible.SPEED_M_S,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    max_rate_rad_s: Annotated[
        float | None,
        Key(
            "Two standard deviations per axis of the rates across the normal.",
            plausible=plausible.MAX_RATE_RAD_S,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    ring_tolerance_m: Annotated[
        float | None,
        Key(
            "Standard deviation of the ring's form.",
            plausible=plausible.RING_TOLERANCE_M,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    rig_stability: Annotated[
        float,
        Key("Factor on the rig's stability.", plausible=plausible.STABILITY_FACTOR, presence=Presence.IF_KNOWN),
    ] = 1.0
    risk: Annotated[
        float,
        Key("Risk of the protection levels.", plausible=plausible.RISK, presence=Presence.IF_KNOWN),
    ] = RISK


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackEntry:
    """The key `track` of a study."""

    shots: Annotated[int, Key("Number of shots of a run.", least=2, most=1000)]
    period_s: Annotated[float, Key("Time between them.", least=0.01, most=60.0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyFile:
    """study.yaml."""

    title: Annotated[str, Key("A text for the head of the tables.")]
    scene: Annotated[str, Key("A scene file, relative to the study; its trajectory is not used.")]
    level: Annotated[
        Literal["images", "features"],
        Key(
            "`images` renders every shot and detects its features; `features` draws the features from the ring's model "
            "with the errors that images have, a hundred times faster."
        ),
    ]
    count: Annotated[
        int | None,
        Key(
            "Shots of each cell of the grid, unless `--count` is given.",
            least=1,
            most=MAX_SHOTS,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    seed: Annotated[
        int | None,
        Key(
            "Seed of the shots, unless `--seed` is given; two seeds give independent shots.",
            least=0,
            most=2**32 - 1,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    vary: Annotated[
        Factors,
        Key(
            "The factors, of which `distance_m` is required. A list of values is a dimension of the grid, a single "
            "value holds for all shots; what is drawn differs between shots."
        ),
    ]
    cases: Annotated[
        Mapping[str, Factors],
        Key(
            "Names, each with the factors that it changes: a dimension of the grid, which is named `case`. A factor "
            "that a case changes has one value in `vary`, or is drawn. The shots of all cases have the same views and "
            "drawn values, except for what the case changes.",
            presence=Presence.IF_KNOWN,
        ),
    ] = field(default_factory=dict)
    surfaces: Annotated[
        Mapping[str, Surface],
        Key("Names, each with what it changes in the scene, for the factor `surfaces`.", presence=Presence.IF_KNOWN),
    ] = field(default_factory=dict)
    assume: Annotated[
        AssumeEntry | None,
        Key(
            "What the estimator assumes instead of the distributions from which the shots are drawn, as in the options "
            "of `ringpose pose`, but the rate in rad/s. A target that does not move is known to be still.",
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    methods: Annotated[
        tuple[StudyMethod, ...], Key("The methods, see below; `ml` and `paper` without it.", presence=Presence.IF_KNOWN)
    ] = (
        StudyMethod.ML,
        StudyMethod.PAPER,
    )
    table: Annotated[
        str | None,
        Key(
            "The factor in the columns of the first table, of the grid or with values that are drawn; the first of the "
            "grid without it.",
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    occurrence: Annotated[
        Mapping[str, Annotated[float, Key(least=0.0, most=1.0)]],
        Key(
            "How often each fault occurs outside of the study, in a study of `faults`: the share of misleading lines "
            "that follows is stated below the table of integrity. Faults occur independently of each other; those "
            "without an entry, whose lines count as those without them, are variants of what is usual.",
            presence=Presence.IF_KNOWN,
        ),
    ] = field(default_factory=dict)
    bounds: Annotated[
        bool,
        Key(
            "Whether each shot has its Cramér-Rao bound, and what it determines.",
            presence=Presence.IF_KNOWN,
        ),
    ] = True
    calibrate: Annotated[
        bool,
        Key(
            "Whether the rig that measures is calibrated from the scene's board views first.",
            presence=Presence.IF_KNOWN,
        ),
    ] = False
    track: Annotated[
        TrackEntry | None,
        Key(
            "Every shot of the study is the last of a run of shots. The method `track` needs it, the other methods "
            "measure the last shot.",
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    capture: Annotated[
        CaptureLoop | None,
        Key(
            "Every shot of the study is a run in which a robot, which carries the camera, guides a gripper to the "
            "ring; `distance_m` is that at its start. The scene needs a `motion` without a file, and its rig a mount.",
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    limits: Annotated[
        Limits,
        Key(
            "Limits on the first method in every cell of the grid; one to which no shot applies is missed. In a study "
            "with cases a limit may be stated for some of them.",
            presence=Presence.IF_KNOWN,
        ),
    ] = Limits()


RECORD = RecordType(
    cls=StudyFile,
    kind=STUDY,
    version=SCHEMA,
    description="study.yaml: which shots are simulated, how they are measured, and the limits of the errors. Metres, "
    "radians, seconds. Your own keys begin with x_.",
    is_file=True,
    strict=True,
)


def preset_names() -> list[str]:
    """Names of the studies that are shipped."""
    return sorted(file.stem for file in PRESETS.glob("*.yaml") if not file.stem.endswith(("-scene", "-rig")))


def study_path(name: str) -> Path:
    """The file of a preset, or the path itself."""
    if name in preset_names():
        return PRESETS / f"{name}.yaml"
    if "/" not in name and "." not in name and not Path(name).exists():
        remedy = hint(name, preset_names()) or f"give a study.yaml, or one of {', '.join(preset_names())}"
        raise UsageError("", f"{name!r} is neither a file nor a preset", remedy)
    return Path(name)


def read_study(path: Path, count: int | None = None, seed: int | None = None) -> Study:
    """The study in a study.yaml; `count` and `seed` replace those of the file."""
    fields = read_yaml(path, RECORD.keys)
    fields.choice("ringpose", (SCHEMA,))
    entry = definition_of(StudyFile).read(fields, OF_FILE)
    scene_file = path.parent / entry.scene
    scene = read_scene(scene_file)
    factors = _factors(fields.fields("vary"), entry.vary, scene)
    if "distance_m" not in [factor.name for factor in factors]:
        raise fields.problem("vary", "has no distance_m", "give the distances of the ring")
    cases = _cases(fields, entry, factors, scene) if "cases" in fields.values else {}
    if cases:
        factors = (Factor(name=CASE, values=tuple(cases)), *factors)
    grid = [factor.name for factor in factors if not factor.drawn]
    in_columns = [factor.name for factor in factors if factor.values]
    if not entry.methods or len(set(entry.methods)) < len(entry.methods):
        raise fields.problem("methods", "must name each method once, and at least one")
    study = Study(
        title=entry.title,
        scene=scene,
        level=entry.level,
        count=_given(fields, "count", count, entry.count),
        seed=_given(fields, "seed", seed, entry.seed),
        factors=factors,
        methods=entry.methods,
        table=fields.choice("table", in_columns) if entry.table is not None else next(iter(grid), ""),
        cases=cases,
        surfaces=entry.surfaces,
        occurrence=entry.occurrence,
        bounds=entry.bounds,
        assumed=_assumed(fields, entry.assume) if "assume" in fields.values else None,
        calibrate=entry.calibrate,
        run=_run(fields, entry),
        capture=entry.capture,
        limits=_limits(fields, entry.limits, cases),
    )
    _check(fields, study)
    files = (path, scene_file, scene_file.parent / read_yaml(scene_file).text("rig"))
    contents = [hashlib.sha256(read_bytes(file)).hexdigest() for file in files]
    identity = json.dumps({"files": contents, "count": study.count, "seed": study.seed})
    return replace(study, files=files, sha256=hashlib.sha256(identity.encode()).hexdigest())


def _given(fields: Fields, key: str, option: int | None, own: int | None) -> int:
    """The value of an option, else that of the file."""
    number = own if option is None else option
    if number is None:
        raise fields.missing(key)
    return number


def _run(fields: Fields, entry: StudyFile) -> ShotRun:
    if entry.capture is not None:
        if entry.track is not None:
            raise fields.problem("track", "excludes capture, which tracks every shot of a run", "remove one of them")
        return ShotRun()
    if (StudyMethod.TRACK in entry.methods) != (entry.track is not None):
        remedy = "give track: {shots: N, period_s: S} and the method track"
        raise fields.problem("track", "and the method track need each other", remedy)
    return ShotRun() if entry.track is None else ShotRun(shots=entry.track.shots, period_s=entry.track.period_s)


def _assumed(fields: Fields, entry: AssumeEntry | None) -> AssumptionOptions:
    """The assumptions of the estimator; keys that are not given have the defaults of `ringpose pose`."""
    if entry is None:
        raise fields.problem("assume", "is null, must have a value")
    if entry.still and not (entry.max_speed_m_s is None and entry.max_rate_rad_s is None):
        finding = "excludes max_speed_m_s and max_rate_rad_s"
        raise fields.fields("assume").problem("still", finding, "give one of them")
    return AssumptionOptions(
        still=entry.still,
        max_speed_m_s=entry.max_speed_m_s,
        max_rate_deg_s=None if entry.max_rate_rad_s is None else degrees(entry.max_rate_rad_s),
        ring_tolerance_m=entry.ring_tolerance_m,
        rig_stability=entry.rig_stability,
        risk=entry.risk,
    )


def _limits(fields: Fields, entry: Limits, cases: Iterable[str]) -> dict[str, float | Mapping[str, float]]:
    """The limits that are given; one that is a mapping has a value for each of the cases that it names."""
    given = {name: getattr(entry, name) for name in (*LIMITS, *CAPTURE_LIMITS)}
    for name, limit in given.items():
        if isinstance(limit, Mapping):
            fields.fields("limits").fields(name, tuple(cases))
    return {name: limit for name, limit in given.items() if limit is not None}


def _factors(vary: Fields, entry: Factors, scene: Scene) -> tuple[Factor, ...]:
    """The factors in the order of the file, in which they are combined."""
    names = [name for name in vary.values if not name.startswith(FREE_PREFIX)]
    return tuple(_factor(vary, name, getattr(entry, name), scene) for name in names)


def _cases(
    fields: Fields, study: StudyFile, factors: tuple[Factor, ...], scene: Scene
) -> dict[str, tuple[Factor, ...]]:
    """The factors that each case replaces, by the name of the case; each has one value or is drawn."""
    single = [factor.name for factor in factors if factor.drawn or len(factor.values) == 1]
    entries, cases = fields.fields("cases"), {}
    for name in entries.values:
        if not isinstance(name, str) or not name.isprintable() or not name.strip():
            raise fields.problem("cases", f"has the name {name!r}", "give a text of one line")
        entry = entries.fields(name)
        cases[name] = _factors(entry, study.cases[name], scene)
        for factor in cases[name]:
            if factor.name not in single:
                raise entry.problem(factor.name, "has not one value in vary", "give it one, that of the other cases")
            if not factor.drawn and len(factor.values) > 1:
                raise entry.problem(factor.name, "has several values", "give one, or {choice: [...]}")
    if not cases:
        raise fields.problem("cases", "names no case")
    return cases


def _factor(vary: Fields, name: str, given: Value | tuple[Value, ...] | Drawn | None, scene: Scene) -> Factor:
    """A value, a list of values to combine, or a mapping as `Drawn`, of which each shot draws."""
    if given is None:
        raise vary.problem(name, "is null, must have a value")
    if not isinstance(given, Drawn):
        values = given if isinstance(given, tuple) else (given,)
        return Factor(name=name, values=_checked(vary, name, name, values, scene))
    entry = vary.fields(name)
    if sum((given.choice is not None, given.uniform is not None, bool(given.shares))) != 1:
        raise vary.problem(name, "must have one of uniform, choice and shares")
    if given.uniform is not None:
        return _uniform(vary, name, given.uniform)
    key, choice = ("choice", given.choice) if given.choice is not None else ("shares", tuple(given.shares))
    if given.shares and (name in NUMBERS or name in SWITCHES):
        raise vary.problem(name, "is not a text, and cannot have shares", "give choice: [...]")
    if given.shares and abs(sum(given.shares.values()) - 1.0) > SHARES_SUM:
        raise entry.problem("shares", f"have the sum {sum(given.shares.values()):g}, must be 1")
    values = _checked(entry, key, name, tuple(_drawn(entry, key, name, value) for value in choice), scene)
    return Factor(name=name, values=values, drawn=True, shares=tuple(given.shares.values()))


def _uniform(vary: Fields, name: str, ends: tuple[float, float]) -> Factor:
    entry = vary.fields(name)
    if name not in NUMBERS:
        raise vary.problem(name, "is not a number, and cannot be uniform", "give choice: [...]")
    least, most = ends
    if not least < most:
        raise entry.problem("uniform", f"is [{least:g}, {most:g}], must ascend")
    entry.check("uniform", np.array(ends), NUMBERS[name])
    return Factor(name=name, uniform=ends, drawn=True)


SHARES_SUM = 1e-6
"""Largest difference of the sum of shares from 1."""


def _drawn(fields: Fields, key: str, name: str, value: Value) -> Value:
    """A value among those of which each shot draws one, checked as the single value of a factor."""
    alone = Fields(fields.file, {name: value})
    try:
        read: Value = definition_of(Factors).value(name, alone)
    except DataError as error:
        raise fields.problem(key, error.finding, error.remedy) from error
    return read


def _checked(fields: Fields, key: str, name: str, values: tuple[Value, ...], scene: Scene) -> tuple[Value, ...]:
    """The values of the factor `name`: at least one, different ones, and such as the scene allows."""
    if not values or len(set(values)) < len(values):
        raise fields.problem(key, "has a value twice" if values else "has no value")
    for value in values:
        if name == "light" and value not in scene.lights:
            finding = f"is {value!r}, must be one of {', '.join(scene.lights)}"
            raise fields.problem(key, finding, hint(str(value), scene.lights))
        if name == "sequence":
            _check_sequence(fields, key, str(value), scene)
    return values


def _check_sequence(fields: Fields, key: str, text: str, scene: Scene) -> None:
    try:
        masks = [step.mask(len(scene.rig.lasers.names)) for step in parsed_sequence(text)]
    except UsageError as error:
        raise fields.problem(key, f"is {text!r}: {error.finding}", error.remedy) from error
    if not any(masks):
        raise fields.problem(key, f"is {text!r}, in which no laser is on")


def _check(fields: Fields, study: Study) -> None:
    """Reject factors that do not fit the level or the rig."""
    if study.shots > MAX_SHOTS:
        finding = f"has {study.shots} shots, must have at most {MAX_SHOTS}"
        raise fields.problem("", finding, "give a smaller grid or count")
    _check_capture(fields, study)
    _check_occurrence(fields, study)
    for factor in study.factors:
        _check_factor(fields, f"vary.{factor.name}", factor, study)
    for name, own in study.cases.items():
        for factor in own:
            if factor.name == study.table:
                raise fields.problem("table", f"is {study.table!r}, which a case changes", "give table: case")
            _check_factor(fields, f"cases.{name}.{factor.name}", factor, study)
    if study.level == "features":
        _check_without_images(fields, study)
    if study.calibrate and (study.scene.camera_boards is None or study.scene.plane_boards is None):
        raise fields.problem("calibrate", "needs board views, and the scene has none", "add boards to the scene")


def _check_occurrence(fields: Fields, study: Study) -> None:
    """Reject names that are not a fault of any shot."""
    if study.occurrence and study.table != FAULTS:
        raise fields.problem("occurrence", "is of faults", "give table: faults")
    values = [str(value) for factor in study.factors if factor.name == FAULTS for value in factor.values]
    drawn = sorted({name for value in values for name in value.split("+")} - {NO_FAULT})
    for name in study.occurrence:
        if name not in drawn:
            remedy = hint(name, drawn) or f"give names of {', '.join(drawn)}"
            raise fields.fields("occurrence").problem(name, "is not a fault of any shot", remedy)


def _check_capture(fields: Fields, study: Study) -> None:
    """Reject what a study of captures lacks, and what others must not have."""
    drawn = [*study.factors, *(factor for own in study.cases.values() for factor in own)]
    names = {factor.name for factor in drawn}
    excluded: tuple[str, ...] = ONLY_CAPTURE if study.capture is None else UNUSED_IN_CAPTURE
    other = "is of captures" if study.capture is None else "is not of captures"
    if used := [name for name in excluded if name in names]:
        raise fields.problem(f"vary.{used[0]}", other, "give capture, or leave it out")
    excluded = tuple(CAPTURE_LIMITS if study.capture is None else LIMITS)
    if used := [name for name in study.limits if name in excluded]:
        raise fields.problem(f"limits.{used[0]}", other, "give another limit")
    if study.capture is not None and not isinstance(study.scene.motion, FreeMotion):
        remedy = "give its motion an angular_velocity_rad_s, whose place the study's factors take"
        raise fields.problem("scene", "has no free motion, which gives the target its inertia", remedy)
    if study.capture is not None and study.scene.rig.mount is None:
        raise fields.problem("scene", "has a rig without mount", "add tool_from_camera to its rig file")


UNUSED_IN_CAPTURE = ("speed_sd_m_s", "rate_sd_rad_s", "target", "surfaces")
"""Factors that a run of a capture has no use for: its target has a motion of its own."""


def _check_without_images(fields: Fields, study: Study) -> None:
    """Reject what needs images in a study of drawn features."""
    if study.calibrate:
        raise fields.problem("calibrate", "needs images", "give level: images")
    if StudyMethod.PAPER_DETECTOR in study.methods:
        raise fields.problem("methods", "has paper-detector, which needs images", "give level: images")


def _check_factor(fields: Fields, key: str, factor: Factor, study: Study) -> None:
    scene, given = study.scene, factor.uniform or factor.values
    if factor.name in ONLY_FEATURES and study.level == "images":
        raise fields.problem(key, "is not rendered in images", "give level: features")
    checks = {SURFACES: _check_surfaces, FAULTS: _check_faults}
    if factor.name in checks:
        checks[factor.name](fields, key, factor, study)
    if factor.name == "rig_errors" and True in factor.values and _is_exact(scene.rig):
        remedy = "give a rig.yaml with one of them, as calibrate-planes writes it"
        raise fields.problem(key, "needs the rig's covariance or stability, and the scene's rig has neither", remedy)
    if factor.name == "stripe_dn" and study.level == "features":
        largest_dn = max(cast(tuple[float, ...], given))
        if largest_dn > 2**scene.sensor.bits - 1:
            raise fields.problem(key, f"has {largest_dn:g}; drawn features do not saturate", "give level: images")
    if factor.name == "ring_radius_outer_m":
        smallest_m = min(cast(tuple[float, ...], given))
        inward_m = scene.ring.radius_outer_m - float(scene.ring.profile_m[:, 0].min())
        if smallest_m <= inward_m:
            finding = f"has {smallest_m:g}, must be greater than {inward_m:g}, the width of the cross-section"
            raise fields.problem(key, finding)


def _is_exact(rig: Rig) -> bool:
    """Whether a rig has no errors that could be drawn."""
    return rig.covariance is None and rig.stability == RigStability()


def _check_faults(fields: Fields, key: str, factor: Factor, study: Study) -> None:
    """Reject names that are no faults."""
    known = (NO_FAULT, *DRAWN_FAULTS, *RUN_FAULTS)
    for name in (name for value in factor.values for name in str(value).split("+")):
        if name not in known:
            remedy = hint(name, known) or f"give names of {', '.join(known)}"
            raise fields.problem(key, f"names {name!r}, which is not a fault", remedy)


def _check_surfaces(fields: Fields, key: str, factor: Factor, study: Study) -> None:
    """Reject surfaces that the study does not describe, and those of drawn features."""
    if study.level == "features":
        raise fields.problem(key, "has no model of its features", "give level: images")
    for name in (name for value in factor.values for name in str(value).split("+")):
        if name not in study.surfaces:
            remedy = (
                hint(name, study.surfaces) or f"give it under surfaces, with {', '.join(study.surfaces) or 'others'}"
            )
            raise fields.problem(key, f"names {name!r}, which is not one of the study's surfaces", remedy)
