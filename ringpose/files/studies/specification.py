"""study.yaml, the input of `ringpose bench study`; man/ringpose-study.5 documents its keys."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from math import degrees
from pathlib import Path
from typing import Any, Literal, cast

from ringpose.errors import UsageError
from ringpose.files.io import read_bytes
from ringpose.files.scenes.scene import read_scene
from ringpose.files.schema import FREE_PREFIX, Fields, hint
from ringpose.files.yaml import read_yaml
from ringpose.types.assumptions import AssumptionOptions
from ringpose.types.plausible import MAX_RATE_RAD_S, RING_TOLERANCE_M, SPEED_M_S, STABILITY_FACTOR
from ringpose.types.scene import Scene
from ringpose.types.session import parsed_sequence
from ringpose.types.study import (
    CASE,
    LIMITS,
    NUMBERS,
    ONLY_FEATURES,
    SWITCHES,
    TEXTS,
    Factor,
    ShotRun,
    Study,
    StudyMethod,
    Value,
)

SCHEMA = "study/1"

PRESETS = Path(__file__).parent / "presets"

MAX_SHOTS = 100_000_000

_KEYS = (
    "ringpose", "title", "scene", "level", "count", "seed", "vary", "cases", "assume", "methods", "table", "calibrate",
    "track", "limits",
)  # fmt: skip

_FACTORS = (*TEXTS, *NUMBERS, *SWITCHES)


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
    fields = read_yaml(path, _KEYS)
    fields.choice("ringpose", (SCHEMA,))
    scene_file = path.parent / fields.text("scene")
    scene = read_scene(scene_file)
    factors = _factors(fields.fields("vary", _FACTORS), scene)
    if "distance_m" not in [factor.name for factor in factors]:
        raise fields.problem("vary", "has no distance_m", "give the distances of the ring")
    cases = _cases(fields, factors, scene) if "cases" in fields.values else {}
    if cases:
        factors = (Factor(name=CASE, values=tuple(cases)), *factors)
    grid = [factor.name for factor in factors if not factor.drawn]
    names = fields.texts("methods") if fields.has("methods") else ("ml", "paper")
    methods = tuple(StudyMethod(_alone(fields, "methods", each).choice("methods", StudyMethod)) for each in names)
    if not methods or len(set(methods)) < len(methods):
        raise fields.problem("methods", "must name each method once, and at least one")
    study = Study(
        title=fields.text("title"),
        scene=scene,
        level=cast(Literal["images", "features"], fields.choice("level", ("images", "features"))),
        count=count if count is not None else fields.integer("count", least=1, most=MAX_SHOTS),
        seed=seed if seed is not None else fields.integer("seed", least=0, most=2**32 - 1),
        factors=factors,
        methods=methods,
        table=fields.choice("table", grid) if fields.has("table") else next(iter(grid), ""),
        cases=cases,
        assumed=_assumed(fields) if "assume" in fields.values else None,
        calibrate=bool(fields.optional("calibrate", fields.boolean)),
        run=_run(fields, methods),
        limits=_limits(fields, cases),
    )
    _check(fields, study)
    files = (path, scene_file, scene_file.parent / read_yaml(scene_file).text("rig"))
    contents = [hashlib.sha256(read_bytes(file)).hexdigest() for file in files]
    identity = json.dumps({"files": contents, "count": study.count, "seed": study.seed})
    return replace(study, files=files, sha256=hashlib.sha256(identity.encode()).hexdigest())


def _alone(fields: Fields, key: str, value: Any) -> Fields:
    """A mapping in which the key has this single value, so that the methods of `Fields` can read it."""
    return Fields(fields.file, {key: value}, path=fields.path)


def _run(fields: Fields, methods: tuple[StudyMethod, ...]) -> ShotRun:
    if (StudyMethod.TRACK in methods) != fields.has("track"):
        remedy = "give track: {shots: N, period_s: S} and the method track"
        raise fields.problem("track", "and the method track need each other", remedy)
    if not fields.has("track"):
        return ShotRun()
    track = fields.fields("track", ("shots", "period_s"))
    return ShotRun(
        shots=track.integer("shots", least=2, most=1000), period_s=track.number("period_s", least=0.01, most=60.0)
    )


def _assumed(fields: Fields) -> AssumptionOptions:
    """The assumptions of the estimator; keys that are not given have the defaults of `ringpose pose`."""
    plausible = {
        "max_speed_m_s": SPEED_M_S,
        "max_rate_rad_s": MAX_RATE_RAD_S,
        "ring_tolerance_m": RING_TOLERANCE_M,
        "rig_stability": STABILITY_FACTOR,
    }
    entry = fields.fields("assume", ("still", *plausible))
    still = bool(entry.optional("still", entry.boolean))
    if still and (entry.has("max_speed_m_s") or entry.has("max_rate_rad_s")):
        raise entry.problem("still", "excludes max_speed_m_s and max_rate_rad_s", "give one of them")
    given = entry.given(plausible, lambda key: entry.quantity(key, plausible[key]))
    if "max_rate_rad_s" in given:
        given["max_rate_deg_s"] = degrees(given.pop("max_rate_rad_s"))
    return AssumptionOptions(still=still, **given)


def _limits(fields: Fields, cases: Iterable[str]) -> dict[str, float | Mapping[str, float]]:
    """The limits; one that is a mapping has a value for each of the cases that it names."""
    if not fields.has("limits"):
        return {}
    limits, found = fields.fields("limits", tuple(LIMITS)), dict[str, float | Mapping[str, float]]()
    for name in map(str, limits.values):
        if isinstance(limits.raw(name), dict):
            by_case = limits.fields(name, tuple(cases))
            found[name] = {str(case): by_case.number(str(case), least=0) for case in by_case.values}
        else:
            found[name] = limits.number(name, least=0)
    return found


def _factors(vary: Fields, scene: Scene) -> tuple[Factor, ...]:
    return tuple(_factor(vary, name, scene) for name in vary.values if not name.startswith(FREE_PREFIX))


def _cases(fields: Fields, factors: tuple[Factor, ...], scene: Scene) -> dict[str, tuple[Factor, ...]]:
    """The factors that each case replaces, by the name of the case; each has one value or is drawn."""
    single = [factor.name for factor in factors if factor.drawn or len(factor.values) == 1]
    entries, cases = fields.fields("cases"), {}
    for name in entries.values:
        if not isinstance(name, str) or not name.isprintable() or not name.strip():
            raise fields.problem("cases", f"has the name {name!r}", "give a text of one line")
        entry = entries.fields(name, _FACTORS)
        cases[name] = _factors(entry, scene)
        for factor in cases[name]:
            if factor.name not in single:
                raise entry.problem(factor.name, "has not one value in vary", "give it one, that of the other cases")
            if not factor.drawn and len(factor.values) > 1:
                raise entry.problem(factor.name, "has several values", "give one, or {choice: [...]}")
    if not cases:
        raise fields.problem("cases", "names no case")
    return cases


def _factor(vary: Fields, name: str, scene: Scene) -> Factor:
    """A value, a list of values to combine, or `{uniform: [a, b]}` or `{choice: [...]}`, of which each shot draws."""
    given = vary.raw(name)
    if not isinstance(given, dict):
        return Factor(name=name, values=_values(vary, name, name, scene))
    entry = vary.fields(name, ("uniform", "choice"))
    if entry.has("uniform") == entry.has("choice"):
        raise vary.problem(name, "must have either uniform or choice")
    if entry.has("choice"):
        return Factor(name=name, values=_values(entry, "choice", name, scene), drawn=True)
    if name not in NUMBERS:
        raise vary.problem(name, "is not a number, and cannot be uniform", "give choice: [...]")
    least, most = entry.vector("uniform", 2).tolist()
    if not least < most:
        raise entry.problem("uniform", f"is [{least:g}, {most:g}], must ascend")
    for end in (least, most):
        _value(_alone(entry, "uniform", end), "uniform", name, scene)
    return Factor(name=name, uniform=(least, most), drawn=True)


def _values(fields: Fields, key: str, name: str, scene: Scene) -> tuple[Value, ...]:
    """The values of the factor `name` at a key: one, or a list of different ones."""
    given = fields.raw(key)
    listed = given if isinstance(given, list) else [given]
    values = tuple(_value(_alone(fields, key, each), key, name, scene) for each in listed)
    if not values or len(set(values)) < len(values):
        raise fields.problem(key, "has a value twice" if values else "has no value")
    return values


def _value(fields: Fields, key: str, name: str, scene: Scene) -> Value:
    """A value of the factor `name`."""
    if name in SWITCHES:
        return fields.boolean(key)
    if name in NUMBERS:
        return fields.quantity(key, NUMBERS[name])
    if name != "sequence":
        return fields.choice(key, scene.lights if name == "light" else ("ring", "body"))
    text = fields.text(key)
    try:
        masks = [step.mask(len(scene.rig.lasers.names)) for step in parsed_sequence(text)]
    except UsageError as error:
        raise fields.problem(key, f"is {text!r}: {error.found}", error.remedy) from error
    if not any(masks):
        raise fields.problem(key, f"is {text!r}, in which no laser is on")
    return text


def _check(fields: Fields, study: Study) -> None:
    """Reject factors that do not fit the level or the rig."""
    if study.shots > MAX_SHOTS:
        found = f"has {study.shots} shots, must have at most {MAX_SHOTS}"
        raise fields.problem("", found, "give a smaller grid or count")
    for factor in study.factors:
        _check_factor(fields, f"vary.{factor.name}", factor, study)
    for name, own in study.cases.items():
        for factor in own:
            if factor.name == study.table:
                raise fields.problem("table", f"is {study.table!r}, which a case changes", "give table: case")
            _check_factor(fields, f"cases.{name}.{factor.name}", factor, study)
    if study.calibrate and study.level == "features":
        raise fields.problem("calibrate", "needs images", "give level: images")
    if study.calibrate and (study.scene.camera_boards is None or study.scene.plane_boards is None):
        raise fields.problem("calibrate", "needs board views, and the scene has none", "add boards to the scene")


def _check_factor(fields: Fields, key: str, factor: Factor, study: Study) -> None:
    scene, given = study.scene, factor.uniform or factor.values
    if factor.name in ONLY_FEATURES and study.level == "images":
        raise fields.problem(key, "is not rendered in images", "give level: features")
    if factor.name == "rig_errors" and True in factor.values and scene.rig.covariance is None:
        remedy = "give a rig.yaml with a covariance, as calibrate-planes writes it"
        raise fields.problem(key, "needs the rig's covariance, and the scene's rig has none", remedy)
    if factor.name == "stripe_dn" and study.level == "features":
        largest_dn = max(cast(tuple[float, ...], given))
        if largest_dn > 2**scene.sensor.bits - 1:
            raise fields.problem(key, f"has {largest_dn:g}; drawn features do not saturate", "give level: images")
    if factor.name == "radius_outer_m":
        smallest_m = min(cast(tuple[float, ...], given))
        inward_m = scene.ring.radius_outer_m - float(scene.ring.profile_m[:, 0].min())
        if smallest_m <= inward_m:
            found = f"has {smallest_m:g}, must be greater than {inward_m:g}, the width of the cross-section"
            raise fields.problem(key, found)
