"""study.yaml, the input of `ringpose bench study`; man/ringpose-study.5 documents its keys."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from math import degrees
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from ringpose.errors import DataError, UsageError
from ringpose.files.io import read_bytes
from ringpose.files.scenes.scene import read_scene
from ringpose.files.schema import Fields, hint
from ringpose.files.yaml import read_yaml
from ringpose.types.assumptions import MAX_TOLERANCE_M, AssumptionOptions
from ringpose.types.scene import Scene
from ringpose.types.session import parsed_sequence
from ringpose.types.study import CASE, LIMITS, NUMBERS, SWITCHES, TEXTS, Factor, ShotRun, Study, StudyMethod, Value

SCHEMA = "study/1"

PRESETS = Path(__file__).parent / "presets"

MAX_SHOTS = 100_000_000

_KEYS = (
    "ringpose", "title", "scene", "level", "count", "seed", "vary", "cases", "assume", "methods", "table", "calibrate",
    "track", "limits",
)  # fmt: skip

_FACTORS = (*TEXTS, *NUMBERS, *SWITCHES)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StudyFile:
    """A study as it was read."""

    study: Study
    files: tuple[Path, ...]
    """The files that it was read from."""
    sha256: str
    """Of their contents, with number of shots and seed: two studies with the same hash have the same shots."""


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


def read_study(path: Path, count: int | None = None, seed: int | None = None) -> StudyFile:
    """The study in a study.yaml; `count` and `seed` replace those of the file."""
    fields = read_yaml(path, _KEYS)
    fields.choice("ringpose", (SCHEMA,))
    scene_file = path.parent / fields.text("scene")
    scene = read_scene(scene_file)
    factors = _factors(fields.fields("vary", _FACTORS), scene)
    cases = _cases(fields, factors, scene) if "cases" in fields.values else {}
    if cases:
        factors = (Factor(name=CASE, values=tuple(cases)), *factors)
    grid = [factor.name for factor in factors if not factor.drawn]
    table = fields.text("table") if fields.has("table") else next(iter(grid), "")
    if table and table not in grid:
        raise fields.problem("table", f"is {table!r}, must be a factor of the grid", hint(table, grid))
    methods = _methods(fields)
    level = fields.choice("level", ("images", "features"))
    study = Study(
        title=fields.text("title"),
        scene=scene,
        level=cast(Literal["images", "features"], level),
        count=count if count is not None else fields.integer("count", least=1, most=MAX_SHOTS),
        seed=seed if seed is not None else fields.integer("seed", least=0, most=2**32 - 1),
        factors=factors,
        methods=methods,
        table=table,
        cases=cases,
        assumed=_assumed(fields) if "assume" in fields.values else None,
        calibrate=fields.boolean("calibrate") if fields.has("calibrate") else False,
        run=_run(fields, methods),
        limits=_limits(fields, cases),
    )
    _check(fields, study)
    files = (path, scene_file, scene_file.parent / read_yaml(scene_file).text("rig"))
    contents = [hashlib.sha256(read_bytes(file)).hexdigest() for file in files]
    identity = json.dumps({"files": contents, "count": study.count, "seed": study.seed})
    return StudyFile(study=study, files=files, sha256=hashlib.sha256(identity.encode()).hexdigest())


def _methods(fields: Fields) -> tuple[StudyMethod, ...]:
    names = fields.texts("methods") if fields.has("methods") else ("ml", "paper")
    known = [method.value for method in StudyMethod]
    for name in names:
        if name not in known:
            raise fields.problem("methods", f"has {name!r}, must be of {', '.join(known)}", hint(name, known))
    if not names or len(set(names)) < len(names):
        raise fields.problem("methods", "must name each method once, and at least one")
    return tuple(StudyMethod(name) for name in names)


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
    factors = tuple(_factor(vary, str(name), scene) for name in vary.values if not str(name).startswith("x_"))
    if "distance_m" not in [factor.name for factor in factors]:
        raise vary.problem("", "has no distance_m", "give the distances of the ring")
    return factors


def _cases(fields: Fields, factors: tuple[Factor, ...], scene: Scene) -> dict[str, tuple[Factor, ...]]:
    """The factors that each case replaces, by the name of the case; each has one value or is drawn."""
    single = [factor.name for factor in factors if factor.drawn or len(factor.values) == 1]
    entries, cases = fields.fields("cases"), {}
    for name in entries.values:
        if not isinstance(name, str) or not name.isprintable() or not name.strip():
            raise fields.problem("cases", f"has the name {name!r}", "give a text of one line")
        entry = entries.fields(name, _FACTORS)
        own = [str(key) for key in entry.values if not str(key).startswith("x_")]
        for key in own:
            if key not in single:
                raise entry.problem(key, "has not one value in vary", "give it one there, the one of the other cases")
            given = entry.raw(key)
            if isinstance(given, list) and len(given) != 1:
                raise entry.problem(key, "has several values", "give one, or {choice: [...]}")
        cases[name] = tuple(_factor(entry, key, scene) for key in own)
    if not cases:
        raise fields.problem("cases", "names no case")
    return cases


def _assumed(fields: Fields) -> AssumptionOptions:
    """What the estimator assumes; keys that are not given have the defaults of `ringpose pose`."""
    entry = fields.fields("assume", ("still", "max_speed_m_s", "max_rate_rad_s", "ring_tolerance_m", "rig_stability"))
    still = entry.boolean("still") if entry.has("still") else False
    if still and (entry.has("max_speed_m_s") or entry.has("max_rate_rad_s")):
        raise entry.problem("still", "excludes max_speed_m_s and max_rate_rad_s", "give one of them")
    rate_rad_s = entry.optional("max_rate_rad_s", partial(entry.number, least=0.0, most=10.0))
    return AssumptionOptions(
        still=still,
        max_speed_m_s=entry.optional("max_speed_m_s", partial(entry.number, least=0.0, most=10.0)),
        max_rate_deg_s=None if rate_rad_s is None else degrees(rate_rad_s),
        ring_tolerance_m=entry.optional("ring_tolerance_m", partial(entry.number, least=0.0, most=MAX_TOLERANCE_M)),
        rig_stability=entry.number("rig_stability", least=0.0, most=1000.0) if entry.has("rig_stability") else 1.0,
    )


def _factor(vary: Fields, name: str, scene: Scene) -> Factor:
    """A value, a list of values to combine, or `{uniform: [a, b]}` or `{choice: [...]}`, of which each shot draws."""
    given = vary.raw(name)
    if not isinstance(given, dict):
        values = given if isinstance(given, list) else [given]
        return Factor(name=name, values=_values(vary, name, values, scene))
    entry = vary.fields(name, ("uniform", "choice"))
    if entry.has("uniform") == entry.has("choice"):
        raise vary.problem(name, "must have either uniform or choice")
    if entry.has("choice"):
        choices = entry.raw("choice")
        return Factor(
            name=name,
            values=_values(entry, "choice", choices if isinstance(choices, list) else [choices], scene, name),
            drawn=True,
        )
    if name not in NUMBERS:
        raise vary.problem(name, "is not a number, and cannot be uniform", "give choice: [...]")
    least, most = entry.vector("uniform", 2).tolist()
    if not least < most:
        raise entry.problem("uniform", f"is [{least:g}, {most:g}], must ascend")
    _check_number(entry, "uniform", name, least)
    _check_number(entry, "uniform", name, most)
    return Factor(name=name, uniform=(least, most), drawn=True)


def _values(fields: Fields, key: str, values: list[Any], scene: Scene, name: str = "") -> tuple[Value, ...]:
    if not values:
        raise fields.problem(key, "has no value")
    checked = tuple(_value(fields, key, name or key, value, scene) for value in values)
    if len(set(checked)) < len(checked):
        raise fields.problem(key, "has a value twice")
    return checked


def _value(fields: Fields, key: str, name: str, value: Any, scene: Scene) -> Value:
    if name in SWITCHES:
        if not isinstance(value, bool):
            raise fields.problem(key, f"has {value!r}, must be true or false")
        return value
    if name in TEXTS:
        return _text(fields, key, name, value, scene)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise fields.problem(key, f"has {value!r}, must be a number")
    _check_number(fields, key, name, float(value))
    return float(value)


def _text(fields: Fields, key: str, name: str, value: Any, scene: Scene) -> str:
    if not isinstance(value, str):
        raise fields.problem(key, f"has {value!r}, must be a text")
    if name == "sequence":
        _check_sequence(fields, key, value, scene)
        return value
    known = tuple(scene.lights) if name == "light" else ("ring", "body")
    if value not in known:
        raise fields.problem(key, f"has {value!r}, must be of {', '.join(known)}", hint(value, known))
    return value


def _check_sequence(fields: Fields, key: str, text: str, scene: Scene) -> None:
    try:
        masks = [step.mask(len(scene.rig.lasers.names)) for step in parsed_sequence(text)]
    except UsageError as error:
        raise fields.problem(key, f"has {text!r}: {error.found}", error.remedy) from error
    if not any(masks):
        raise fields.problem(key, f"has {text!r}, in which no laser is on")


def _check_number(fields: Fields, key: str, name: str, value: float) -> None:
    bounds = NUMBERS[name]
    if not np.isfinite(value) or not bounds.least <= value <= bounds.most:
        remedy = "a ring at or behind the camera cannot be seen" if name == "distance_m" and value <= 0 else ""
        raise fields.problem(key, f"has {value:g}, must be from {bounds.least:g} to {bounds.most:g}", remedy)


def _check(fields: Fields, study: Study) -> None:
    """Reject factors that do not fit the level or the rig."""
    if study.shots > MAX_SHOTS:
        raise fields.problem(
            "", f"has {study.shots} shots, must have at most {MAX_SHOTS}", "give a smaller grid or count"
        )
    for factor in study.factors:
        _check_factor(fields, "vary", factor, study)
    for name, own in study.cases.items():
        for factor in own:
            if factor.name == study.table:
                raise fields.problem("table", f"is {study.table!r}, which a case changes", "give table: case")
            _check_factor(fields, f"cases.{name}", factor, study)
    if study.calibrate and study.level == "features":
        raise fields.problem("calibrate", "needs images", "give level: images")
    if study.calibrate and (study.scene.camera_boards is None or study.scene.plane_boards is None):
        raise fields.problem("calibrate", "needs board views, and the scene has none", "add boards to the scene")


def _check_factor(fields: Fields, place: str, factor: Factor, study: Study) -> None:
    key, scene = f"{place}.{factor.name}", study.scene
    if factor.name in NUMBERS and NUMBERS[factor.name].only_features and study.level == "images":
        raise fields.problem(key, "is not rendered in images", "give level: features")
    if factor.name == "rig_errors" and True in factor.values and scene.rig.covariance is None:
        remedy = "give a rig.yaml with a covariance, as calibrate-planes writes it"
        raise fields.problem(key, "needs the rig's covariance, and the scene's rig has none", remedy)
    if factor.name == "stripe_dn" and study.level == "features":
        largest_dn = max(cast(tuple[float, ...], factor.uniform or factor.values))
        if largest_dn > 2**scene.sensor.bits - 1:
            raise fields.problem(key, f"has {largest_dn:g}; drawn features do not saturate", "give level: images")
    if factor.name == "radius_outer_m":
        smallest_m = min(cast(tuple[float, ...], factor.uniform or factor.values))
        inward_m = scene.ring.radius_outer_m - float(scene.ring.profile_m[:, 0].min())
        if smallest_m <= inward_m:
            found = f"has {smallest_m:g}, must be greater than {inward_m:g}, the width of the cross-section"
            raise fields.problem(key, found)


def require_same(recorded: dict[str, Any], current: dict[str, Any], place: str) -> None:
    """Reject results of another study or version; the message names the difference."""
    for key, what in (("study_sha256", "another study"), ("code_sha256", "another version of ringpose")):
        if recorded.get(key) != current[key]:
            found = f"holds results of {what} ({recorded.get('title')}, version {recorded.get('version')})"
            raise DataError(place, found, "choose another folder, or --force to discard them")
