"""The target of a scene: the keys `target` and `body`, the parts, and the models in the package."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import cv2
import numpy as np

import ringpose
from ringpose.files.records.codec import OF_FILE, definition_of
from ringpose.files.scenes import rings
from ringpose.files.schema import Fields
from ringpose.files.yaml import read_yaml
from ringpose.types import plausible, target
from ringpose.types.arrays import Array, Float64
from ringpose.types.plausible import PART_M
from ringpose.types.record import Form, Key, Presence

MODELS = Path(ringpose.__file__).parent / "simulate" / "target" / "models"
"""The models in the package, `NAME.yaml`."""

MODEL_SCHEMA = "target/1"
"""The value of a model's key `ringpose`."""

MODEL_KEYS = ("state", "assumed", "cited")
"""Keys of the parts of models: the state in which a part is there, and where its numbers are from."""

PANEL_M = 0.02
"""Thickness of a panel that states none."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PartEntry:
    """What parts of every shape have.

    A box and a panel are centred on the origin of the part frame; the others stand on it and are symmetric about its
    z axis.
    """

    name: Annotated[str, Key("Name of the part.")]
    position_m: Annotated[
        Float64[Array, "xyz=3"],
        Key("Its place in the target frame.", plausible=PART_M, presence=Presence.IF_KNOWN),
    ] = field(default_factory=lambda: np.zeros(3))
    rotation_rad: Annotated[
        Float64[Array, "xyz=3"],
        Key(
            "Its rotation vector.",
            form=Form.BOUNDED_LENGTH,
            plausible=plausible.ANGLE_RAD,
            presence=Presence.IF_KNOWN,
        ),
    ] = field(default_factory=lambda: np.zeros(3))
    material: Annotated[target.Material, Key("Its material, or that of a ring's face.", words=target.MATERIAL_NAMES)]
    foil: Annotated[target.Foil | None, Key("Crinkles of a box or panel.", presence=Presence.IF_KNOWN)] = None
    mass_kg: Annotated[
        float | Mapping[str, Annotated[float, Key(least=0)]],
        Key("Its mass; in models also by the filling of the tanks.", least=0, presence=Presence.IF_KNOWN),
    ] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoxEntry(PartEntry):
    """A box."""

    shape: Annotated[Literal["box"], Key()]
    size_m: Annotated[Float64[Array, "xyz=3"], Key("Lengths of its edges.", plausible=PART_M, positive=True)]

    @property
    def solid(self) -> target.Box:
        """Its shape."""
        return target.Box(low_m=-self.size_m / 2, high_m=self.size_m / 2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PanelEntry(PartEntry):
    """A thin box."""

    shape: Annotated[Literal["panel"], Key()]
    size_m: Annotated[Float64[Array, "xy=2"], Key("Its width and height.", plausible=PART_M, positive=True)]
    thickness_m: Annotated[
        float, Key("Its thickness.", plausible=PART_M, positive=True, presence=Presence.IF_KNOWN)
    ] = PANEL_M
    back: Annotated[
        target.Material | None,
        Key("Material of all faces but the front.", words=target.MATERIAL_NAMES, presence=Presence.IF_KNOWN),
    ] = None

    @property
    def solid(self) -> target.Box:
        """Its shape."""
        size_m = np.append(self.size_m, self.thickness_m)
        return target.Box(low_m=-size_m / 2, high_m=size_m / 2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CylinderEntry(PartEntry):
    """A cylinder."""

    shape: Annotated[Literal["cylinder"], Key()]
    radius_m: Annotated[float, Key("Its radius.", plausible=PART_M, positive=True)]
    height_m: Annotated[float, Key("Its height.", plausible=PART_M, positive=True)]

    @property
    def solid(self) -> target.Revolution:
        """Its shape."""
        return target.Revolution(profile_m=_cone_m(self.radius_m, self.radius_m, self.height_m))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ConeEntry(PartEntry):
    """A cone, or a truncated one."""

    shape: Annotated[Literal["cone"], Key()]
    radius_m: Annotated[float, Key("Radius of its foot.", plausible=PART_M, positive=True)]
    top_radius_m: Annotated[float, Key("Radius of its top, 0 for a tip.", least=0, most=PART_M.highest)]
    height_m: Annotated[float, Key("Its height.", plausible=PART_M, positive=True)]

    @property
    def solid(self) -> target.Revolution:
        """Its shape."""
        return target.Revolution(profile_m=_cone_m(self.radius_m, self.top_radius_m, self.height_m))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DiscEntry(PartEntry):
    """A disc, or a ring without thickness."""

    shape: Annotated[Literal["disc"], Key()]
    radius_m: Annotated[float, Key("Its radius.", plausible=PART_M, positive=True)]
    inner_radius_m: Annotated[
        float | None, Key("Radius of its hole.", plausible=PART_M, positive=True, presence=Presence.IF_KNOWN)
    ] = None

    @property
    def solid(self) -> target.Revolution:
        """Its shape."""
        return target.Revolution(profile_m=np.array([[self.inner_radius_m or 0.0, 0.0], [self.radius_m, 0.0]]))


@dataclass(frozen=True, slots=True, kw_only=True)
class FaceEdges:
    """Points of a profile between which the face of the interface ring lies."""

    inner: Annotated[int, Key("Point of the inner edge, from 0.", least=0)]
    outer: Annotated[int, Key("Point of the outer edge.", least=0)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RevolutionEntry(PartEntry):
    """A surface of revolution; the interface ring if its `edges` are given."""

    shape: Annotated[Literal["revolution"], Key()]
    profile_m: Annotated[
        Float64[Array, "point radius_height=2"], Key("Points of a polyline: radius and height.", plausible=PART_M)
    ]
    edges: Annotated[
        FaceEdges | None, Key("Of the interface ring: points of the profile.", presence=Presence.IF_KNOWN)
    ] = None
    wall: Annotated[
        target.Material | None,
        Key(
            "Of the interface ring: material of the other pieces; that of the face without it.",
            words=target.MATERIAL_NAMES,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    slope_rad: Annotated[
        float | None,
        Key("Of the interface ring, as of `ring`.", plausible=plausible.SLOPE_RAD, presence=Presence.IF_KNOWN),
    ] = None
    gaps: Annotated[
        tuple[target.Gap, ...] | None, Key("Of the interface ring, as of `ring`.", presence=Presence.IF_KNOWN)
    ] = None
    form: Annotated[rings.FormEntry | None, Key("Of the interface ring, as of `ring`.", presence=Presence.IF_KNOWN)] = (
        None
    )
    chamfer_m: Annotated[
        float | None,
        Key(
            "Of the interface ring, as of `ring`.",
            plausible=PART_M,
            positive=True,
            presence=Presence.IF_KNOWN,
        ),
    ] = None

    @property
    def solid(self) -> target.Revolution:
        """Its shape."""
        return target.Revolution(profile_m=self.profile_m)


ShapeEntry = BoxEntry | PanelEntry | CylinderEntry | ConeEntry | DiscEntry | RevolutionEntry


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TargetEntry:
    """The key `target` of a scene: a model, parts, or a model with further parts."""

    model: Annotated[str | None, Key("Name of a model.", presence=Presence.IF_KNOWN)] = None
    state: Annotated[str | None, Key("State of the model; its first without it.", presence=Presence.IF_KNOWN)] = None
    mass: Annotated[
        str | None, Key("Filling of the model's tanks; its first without it.", presence=Presence.IF_KNOWN)
    ] = None
    parts: Annotated[
        tuple[ShapeEntry, ...] | None, Key("Parts of simple shape.", tag="shape", presence=Presence.IF_KNOWN)
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Target:
    """The parts of a target other than its ring, and the ring."""

    parts: tuple[target.Part, ...]
    ring: target.RingShape | None


def target_of(fields: Fields, entry: TargetEntry) -> Target:
    """The target of an entry: a model, parts, or a model with further parts; `fields` has the places for messages."""
    model = Target(parts=(), ring=None)
    if entry.model is not None:
        model = _model(fields, entry.model)
    elif entry.parts is None:
        raise fields.problem("", "has neither model nor parts", "give one of them")
    else:
        for key in filter(fields.has, ("state", "mass")):
            raise fields.problem(key, "is a key of models", "remove it, or give model")
    given = Target(parts=(), ring=None)
    if entry.parts is not None:
        given = _parts(zip(fields.each("parts"), entry.parts, strict=True))
    if given.ring is not None and model.ring is not None:
        raise fields.problem("parts", "has a ring, and so has the model", "remove `edges`")
    return Target(parts=(*model.parts, *given.parts), ring=given.ring or model.ring)


def parts_of(fields: Fields, key: str, entries: Sequence[BoxEntry]) -> tuple[target.Part, ...]:
    """Boxes that are not parts of the target."""
    return _parts(zip(fields.each(key), entries, strict=True)).parts if entries else ()


def _model(fields: Fields, name: str) -> Target:
    names = sorted(path.stem for path in MODELS.glob("*.yaml"))
    model = read_yaml(
        MODELS / f"{fields.choice('model', names)}.yaml", ("ringpose", "about", "states", "masses", "parts")
    )
    model.choice("ringpose", (MODEL_SCHEMA,))
    chosen = {}
    for key, choices in (("state", "states"), ("mass", "masses")):
        allowed = model.texts(choices) if model.has(choices) else ()
        if fields.has(key) and not allowed:
            raise fields.problem(key, f"is given, but the model {name!r} has no {choices}", "remove it")
        chosen[key] = fields.choice(key, allowed) if fields.has(key) else (allowed[0] if allowed else None)
    present = [part.values for part in model.each("parts") if part.values.get("state") in (None, chosen["state"])]
    parts = [{key: value for key, value in part.items() if key not in MODEL_KEYS} for part in present]
    own = Fields(model.file, {"parts": parts})
    entries = definition_of(TargetEntry).read(own, OF_FILE).parts or ()
    return _parts(zip(own.each("parts"), entries, strict=True), chosen["mass"])


def _parts(entries: Iterable[tuple[Fields, ShapeEntry]], mass: str | None = None) -> Target:
    """The parts, and the ring among them.

    Masses may be given for several fillings of the tanks; `mass` selects one of them.
    """
    parts, ring, names = [], None, set()
    for fields, entry in entries:
        if entry.name in names:
            raise fields.problem("name", f"{entry.name!r} occurs twice")
        names.add(entry.name)
        if isinstance(entry, RevolutionEntry) and entry.edges is not None:
            if ring is not None:
                raise fields.problem("edges", "are given for a second part", "a target has one interface ring")
            ring = _ring_of_part(fields, entry, entry.edges, mass)
        else:
            parts.append(_part(fields, entry, mass))
    return Target(parts=tuple(parts), ring=ring)


def _part(fields: Fields, entry: ShapeEntry, mass: str | None) -> target.Part:
    for key in filter(fields.has, ("slope_rad", "gaps", "form", "chamfer_m", "wall")):
        raise fields.problem(key, "is for the interface ring", "name its edges by `edges`")
    if entry.foil is not None and not isinstance(entry, BoxEntry | PanelEntry):
        raise fields.problem("foil", f"is not available for a {entry.shape}", "foil crinkles boxes and panels")
    if isinstance(entry, RevolutionEntry):
        rings.check_profile(fields, entry.profile_m)
    solid = entry.solid
    faces = 6 if isinstance(solid, target.Box) else len(solid.profile_m) - 1
    materials = (entry.material,) * faces
    if isinstance(entry, PanelEntry) and entry.back is not None:
        materials = (entry.material, *[entry.back] * 5)
    return target.Part(
        name=entry.name,
        shape=solid,
        materials=materials,
        rotation=np.asarray(cv2.Rodrigues(entry.rotation_rad)[0], dtype=np.float64),
        translation_m=entry.position_m,
        mass_kg=_mass_kg(fields, entry, mass),
        foil=entry.foil,
    )


def _cone_m(radius_m: float, top_radius_m: float, height_m: float) -> Float64[Array, "point radius_height=2"]:
    """The profile of a truncated cone with foot and top; of one with a tip if its top has the radius 0."""
    profile_m = np.array([[0.0, 0.0], [radius_m, 0.0], [top_radius_m, height_m], [0.0, height_m]])
    return profile_m if top_radius_m > 0 else profile_m[:3]


def _mass_kg(fields: Fields, entry: PartEntry, mass: str | None) -> float:
    if isinstance(entry.mass_kg, float):
        return entry.mass_kg
    return fields.number("mass_kg") if mass is None else fields.fields("mass_kg").number(mass)


# The interface ring


def _ring_of_part(fields: Fields, entry: RevolutionEntry, edges: FaceEdges, mass: str | None) -> target.RingShape:
    profile_m = entry.profile_m
    rings.check_profile(fields, profile_m)
    inner, outer = (fields.fields("edges").integer(key, least=0, most=len(profile_m) - 1) for key in ("inner", "outer"))
    if abs(inner - outer) != 1 or profile_m[inner, 1] != profile_m[outer, 1]:
        raise fields.problem("edges", "must be neighbouring points of the profile at one height")
    if profile_m[inner, 0] >= profile_m[outer, 0]:
        raise fields.problem("edges", "inner and outer are exchanged")
    for key in filter(fields.has, ("position_m", "rotation_rad")):
        raise fields.problem(key, "is given for the interface ring, which defines the target frame", "remove it")
    ring = target.RingShape(
        profile_m=profile_m,
        face=entry.material,
        wall=entry.wall or entry.material,
        face_edges=(inner, outer),
        mass_kg=_mass_kg(fields, entry, mass),
    )
    slope_rad = entry.slope_rad or 0.0
    return rings.with_details(fields, ring, slope_rad, entry.gaps or (), entry.form, entry.chamfer_m)
