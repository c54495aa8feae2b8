"""The target of a scene: the key `target`, its parts, and the models in the package."""

from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, replace
from dataclasses import fields as record_fields
from pathlib import Path
from typing import Any, TypeVar, cast

import cv2
import numpy as np

import ringpose
from ringpose.files.schema import Fields
from ringpose.files.yaml import read_yaml
from ringpose.types.arrays import Array, Float64
from ringpose.types.plausible import (
    ANGLE_RAD,
    BLUR_PX,
    DETAIL_M,
    DIVERGENCE_RAD,
    F_NUMBER,
    FAN_RAD,
    IRRADIANCE_W_M2,
    LASER_POWER_W,
    PART_M,
    PIXEL_M,
    RING_FORM_M,
    RING_TOLERANCE_M,
    SHEET_M,
    WAVELENGTH_M,
    Range,
)
from ringpose.types.target import MATERIALS, Box, Foil, Gap, Grid, Material, Part, Revolution, RingForm, RingShape

MODELS = Path(ringpose.__file__).parent / "simulate" / "target" / "models"
"""The models in the package, `NAME.yaml`."""

MODEL_SCHEMA = "target/1"
"""The value of a model's key `ringpose`."""

TARGET_KEYS = ("model", "state", "mass", "parts")

SHAPES: Mapping[str, tuple[str, ...]] = {
    "box": ("size_m",),
    "panel": ("size_m", "thickness_m", "back"),
    "cylinder": ("radius_m", "height_m"),
    "cone": ("radius_m", "top_radius_m", "height_m"),
    "disc": ("radius_m", "inner_radius_m"),
    "revolution": ("profile_m", "edges", "wall", "gaps", "form", "chamfer_m"),
}
"""The shapes of parts, and their keys. A box and a panel are centred on the origin of the part frame; the others stand
on it and are symmetric about its z axis."""

COMMON_KEYS = ("name", "shape", "position_m", "rotation_rad", "material", "foil", "mass_kg")

MODEL_KEYS = ("state", "assumed", "cited")
"""Keys of the parts of models: the state in which a part is there, and where its numbers are from."""

RING_KEYS = ("profile_m", "radius_inner_m", "radius_outer_m", "height_m", "face", "wall", "gaps", "form", "chamfer_m")

_DIVISORS = ("quantum_efficiency", "overall_system_gain_dn_per_e", "saturation_capacity_e", "on_s", "off_s")

_FRACTIONS = ("diffuse", "specular", "roughness", "transmission", "quantum_efficiency", "albedo")

_PLAUSIBLE = {
    "power_w": LASER_POWER_W,
    "sigma_m": SHEET_M,
    "divergence_rad": DIVERGENCE_RAD,
    "fan_rad": FAN_RAD,
    "ambient_w_m2": IRRADIANCE_W_M2,
    "f_number": F_NUMBER,
    "blur_px": BLUR_PX,
    "pixel_m": PIXEL_M,
    "wavelength_m": WAVELENGTH_M,
}
"""Plausible ranges of quantities by their keys; lengths that are not among them are details of the target."""

_MIN_VALUE = 1e-6
"""Minimum of the numbers in `_DIVISORS`."""

_Record = TypeVar("_Record")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Target:
    """The parts of a target other than its ring, and the ring."""

    parts: tuple[Part, ...]
    ring: RingShape | None


def read_target(fields: Fields) -> Target:
    """The target in a mapping: a model, parts, or a model with further parts."""
    parts, ring = [], None
    if fields.has("model"):
        model = _model(fields)
        parts, ring = list(model.parts), model.ring
    elif not fields.has("parts"):
        raise fields.problem("", "has neither model nor parts", "give one of them")
    else:
        for key in filter(fields.has, ("state", "mass")):
            raise fields.problem(key, "is a key of models", "remove it, or give model")
    given = _parts(fields, COMMON_KEYS) if fields.has("parts") else Target(parts=(), ring=None)
    if given.ring is not None and ring is not None:
        raise fields.problem("parts", "has a ring, and so has the model", "remove `edges`")
    return Target(parts=(*parts, *given.parts), ring=given.ring or ring)


def _model(fields: Fields) -> Target:
    names = sorted(path.stem for path in MODELS.glob("*.yaml"))
    model = read_yaml(
        MODELS / f"{fields.choice('model', names)}.yaml", ("ringpose", "about", "states", "masses", "parts")
    )
    model.choice("ringpose", (MODEL_SCHEMA,))
    chosen = {}
    for key, choices in (("state", "states"), ("mass", "masses")):
        allowed = model.texts(choices) if model.has(choices) else ()
        if fields.has(key) and not allowed:
            raise fields.problem(key, f"is given, but the model {fields.text('model')!r} has no {choices}", "remove it")
        chosen[key] = fields.choice(key, allowed) if fields.has(key) else (allowed[0] if allowed else None)
    return _parts(model, (*COMMON_KEYS, *MODEL_KEYS), chosen["state"], chosen["mass"])


def _parts(fields: Fields, keys: Iterable[str], state: str | None = None, mass: str | None = None) -> Target:
    """The parts in a list that the target has in a state, and its ring.

    Masses may be given for several fillings of the tanks; `mass` selects one of them.
    """
    parts, ring, names = [], None, set()
    for entry in fields.each("parts"):
        shape = entry.choice("shape", SHAPES)
        part = Fields(entry.file, entry.values, (*keys, *SHAPES[shape]), entry.path)
        if "state" in keys and part.has("state") and part.text("state") != state:
            continue
        name = part.text("name")
        if name in names:
            raise part.problem("name", f"{name!r} occurs twice")
        names.add(name)
        if part.has("edges"):
            if ring is not None:
                raise part.problem("edges", "are given for a second part", "a target has one interface ring")
            ring = _ring_of_part(part, mass)
        else:
            parts.append(_part(part, shape, name, mass))
    return Target(parts=tuple(parts), ring=ring)


def _part(part: Fields, shape: str, name: str, mass: str | None) -> Part:
    for key in filter(part.has, ("gaps", "form", "chamfer_m", "wall")):
        raise part.problem(key, "is for the interface ring", "name its edges by `edges`")
    material = read_material(part, "material")
    values: dict[str, Any] = part.given(("foil",), lambda key: numbers_of(part, key, Foil))
    if values and shape not in ("box", "panel"):
        raise part.problem("foil", f"is not available for a {shape}", "foil crinkles boxes and panels")
    solid, faces = _shape(part, shape)
    materials = (material,) * faces
    if part.has("back"):
        materials = (material, *[read_material(part, "back")] * 5)
    return Part(
        name=name,
        shape=solid,
        materials=materials,
        rotation=_rotation(part),
        translation_m=_position_m(part),
        mass_kg=_mass(part, mass),
        **values,
    )


def _shape(part: Fields, shape: str) -> tuple[Box | Revolution, int]:
    """The shape of a part, and the number of its faces."""
    if shape in ("box", "panel"):
        size_m = _lengths(part, "size_m", 3 if shape == "box" else 2)
        if shape == "panel":
            size_m = np.append(size_m, _length(part, "thickness_m") if part.has("thickness_m") else 0.02)
        return Box(low_m=-size_m / 2, high_m=size_m / 2), 6
    if shape == "revolution":
        profile_m = read_profile(part)
    elif shape == "disc":
        inner_m = _length(part, "inner_radius_m") if part.has("inner_radius_m") else 0.0
        profile_m = np.array([[inner_m, 0.0], [_length(part, "radius_m"), 0.0]])
    else:
        height_m, radius_m = _length(part, "height_m"), _length(part, "radius_m")
        top_m = radius_m if shape == "cylinder" else part.number("top_radius_m", least=0, most=PART_M.highest)
        profile_m = np.array([[0.0, 0.0], [radius_m, 0.0], [top_m, height_m], [0.0, height_m]])
        profile_m = profile_m if top_m > 0 else profile_m[:3]
    return Revolution(profile_m=profile_m), len(profile_m) - 1


def _rotation(part: Fields) -> Float64[Array, "3 3"]:
    if not part.has("rotation_rad"):
        return np.eye(3)
    vector = part.sized("rotation_rad", ANGLE_RAD)
    return np.asarray(cv2.Rodrigues(vector)[0], dtype=np.float64)


def _position_m(part: Fields) -> Float64[Array, "xyz=3"]:
    return part.quantities("position_m", 3, PART_M) if part.has("position_m") else np.zeros(3)


def _mass(part: Fields, mass: str | None) -> float:
    if not part.has("mass_kg"):
        return 0.0
    if isinstance(part.raw("mass_kg"), dict) and mass is not None:
        return part.fields("mass_kg").number(mass, least=0)
    return part.number("mass_kg", least=0)


# The interface ring


def _ring_of_part(part: Fields, mass: str | None) -> RingShape:
    edges = part.fields("edges", ("inner", "outer"))
    profile_m = read_profile(part)
    inner, outer = (edges.integer(key, least=0, most=len(profile_m) - 1) for key in ("inner", "outer"))
    if abs(inner - outer) != 1 or profile_m[inner, 1] != profile_m[outer, 1]:
        raise part.problem("edges", "must be neighbouring points of the profile at one height")
    if profile_m[inner, 0] >= profile_m[outer, 0]:
        raise part.problem("edges", "inner and outer are exchanged")
    for key in filter(part.has, ("position_m", "rotation_rad")):
        raise part.problem(key, "is given for the interface ring, which defines the target frame", "remove it")
    face = read_material(part, "material")
    wall = read_material(part, "wall") if part.has("wall") else face
    ring = RingShape(profile_m=profile_m, face=face, wall=wall, face_edges=(inner, outer), mass_kg=_mass(part, mass))
    return with_details(part, ring)


def with_details(fields: Fields, ring: RingShape) -> RingShape:
    """The ring with the gaps, the form and the chamfer in a mapping."""
    if fields.has("gaps"):
        ring = replace(
            ring, gaps=tuple(_gap(gap, ring) for gap in fields.each("gaps", ("angle_rad", "width_m", "depth_m")))
        )
    if fields.has("form"):
        ring = replace(
            ring, form=_form(fields.fields("form", ("inner_m", "outer_m", "axial_m", "tolerance_m", "seed")))
        )
    return _chamfered(fields, ring) if fields.has("chamfer_m") else ring


def _gap(gap: Fields, ring: RingShape) -> Gap:
    angle_rad = gap.quantity("angle_rad", ANGLE_RAD)
    width_m = _length(gap, "width_m")
    if width_m >= 2 * ring.radius_inner_m:
        raise gap.problem("width_m", f"is {width_m:g}, wider than the ring")
    return Gap(angle_rad=angle_rad, width_m=width_m, depth_m=_length(gap, "depth_m"))


def _form(form: Fields) -> RingForm:
    """Given coefficients, or random ones such that deviations have the tolerance as their standard deviation."""
    if form.has("tolerance_m"):
        for key in filter(form.has, ("inner_m", "outer_m", "axial_m")):
            raise form.problem(key, "cannot be combined with tolerance_m", "give one of them")
        generator = np.random.default_rng(form.integer("seed", least=0) if form.has("seed") else 1)
        scale_m = form.quantity("tolerance_m", RING_TOLERANCE_M) / np.sqrt(3)
        drawn = scale_m * generator.standard_normal((3, 3, 2))
        return RingForm(radial_m=drawn[:2], axial_m=drawn[2])
    inner, outer, axial = (
        form.array(key, (3, 2)) if form.has(key) else np.zeros((3, 2)) for key in ("inner_m", "outer_m", "axial_m")
    )
    for key, values in (("inner_m", inner), ("outer_m", outer), ("axial_m", axial)):
        form.check(key, values, RING_FORM_M)
    return RingForm(radial_m=np.stack([inner, outer]), axial_m=axial)


def _chamfered(fields: Fields, ring: RingShape) -> RingShape:
    """Both edges of the face cut at equal distances from them along face and wall."""
    chamfer_m, piece = _length(fields, "chamfer_m"), ring.face_piece
    points = ring.profile_m
    if piece == 0 or piece + 2 >= len(points):
        raise fields.problem("chamfer_m", "needs walls at both edges of the face")
    corners = []
    for before, at, after in ((piece - 1, piece, piece + 1), (piece, piece + 1, piece + 2)):
        for other in (before, after):
            along = points[other] - points[at]
            if 2 * chamfer_m >= np.linalg.norm(along):
                raise fields.problem("chamfer_m", f"is {chamfer_m:g}, too large for the face and its walls")
            corners.append(points[at] + chamfer_m * along / np.linalg.norm(along))
    chamfered = np.array([*points[:piece], *corners, *points[piece + 2 :]])
    edges = (piece + 1, piece + 2)
    return replace(ring, profile_m=chamfered, face_edges=edges)


def read_profile(fields: Fields) -> Float64[Array, "point 2"]:
    """A polyline of (radius, height)."""
    profile_m = fields.array("profile_m", (None, 2))
    fields.check("profile_m", profile_m, PART_M)
    if len(profile_m) < 2:
        raise fields.problem("profile_m", f"has {len(profile_m)} points, must have at least 2")
    if (profile_m[:, 0] < 0).any() or (np.abs(np.diff(profile_m, axis=0)).max(axis=1) == 0).any():
        raise fields.problem("profile_m", "has a negative radius or a point twice")
    return profile_m


# Values


def read_material(fields: Fields, key: str) -> Material:
    """A material, given by its name or by its parameters."""
    if isinstance(fields.raw(key), str):
        return MATERIALS[fields.choice(key, MATERIALS)]
    entry = fields.fields(key, ("diffuse", "specular", "roughness", "grid"))
    values = {name: _number(entry, name) for name in ("diffuse", "specular", "roughness")}
    if not entry.has("grid"):
        return Material(**values)
    grid = entry.fields("grid", ("cell_m", "line_m", "diffuse", "specular", "roughness"))
    cell_x, cell_y = _lengths(grid, "cell_m", 2).tolist()
    of_lines = {name: _number(grid, name) for name in ("line_m", "diffuse", "specular", "roughness")}
    if of_lines["line_m"] >= min(cell_x, cell_y):
        raise grid.problem("line_m", f"is {of_lines['line_m']:g}, must be less than a cell")
    return Material(**values, grid=Grid(cell_m=(cell_x, cell_y), **of_lines))


def numbers_of(fields: Fields, key: str, record: type[_Record]) -> _Record:
    """A record whose fields are non-negative numbers; optional fields that are absent keep their defaults."""
    known = record_fields(cast(Any, record))
    entry = fields.fields(key, [field.name for field in known])
    given = [field.name for field in known if field.name in entry.values or field.default is MISSING]
    return record(**{name: _number(entry, name) for name in given})


def _number(fields: Fields, key: str) -> Any:
    if key == "seed":
        return fields.integer(key, least=0)
    if key == "bits":
        bits = fields.integer(key)
        if bits not in (8, 12):
            raise fields.problem(key, f"is {bits}, must be 8 or 12")
        return bits
    if key in _PLAUSIBLE:
        return fields.quantity(key, _PLAUSIBLE[key])
    if key.endswith("_m"):
        return _positive_lengths(fields, key, np.array([fields.number(key)]), DETAIL_M).item()
    return fields.number(key, least=_MIN_VALUE if key in _DIVISORS else 0.0, most=1.0 if key in _FRACTIONS else np.inf)


def _length(fields: Fields, key: str) -> float:
    return _positive_lengths(fields, key, np.array([fields.number(key)])).item()


def _lengths(fields: Fields, key: str, count: int) -> Float64[Array, "n"]:
    return _positive_lengths(fields, key, fields.vector(key, count))


def _positive_lengths(
    fields: Fields, key: str, lengths_m: Float64[Array, "n"], plausible: Range = PART_M
) -> Float64[Array, "n"]:
    fields.check(key, lengths_m, plausible)
    if (lengths_m <= 0).any():
        raise fields.problem(key, "must be positive")
    return lengths_m
