"""The ring of a scene: the key `ring`, the profile of its cross-section, its deviations from circles and a plane."""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from ringpose.files.schema import Fields
from ringpose.types import plausible, target
from ringpose.types.arrays import Array, Float64
from ringpose.types.plausible import FACE_WIDTH_M, PART_M, RING_HEIGHT_M, RING_RADIUS_M
from ringpose.types.record import Key, Presence


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FormEntry:
    """Deviations of a ring from circles and a plane: Fourier coefficients, or a tolerance from which they are drawn."""

    inner_m: Annotated[
        Float64[Array, "order=3 wave=2"] | None,
        Key(
            "Radial deviation of the inner edge, orders 2, 3 and 4, cosine and sine.",
            plausible=plausible.RING_FORM_M,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    outer_m: Annotated[
        Float64[Array, "order=3 wave=2"] | None,
        Key(
            "Radial deviation of the outer edge.",
            plausible=plausible.RING_FORM_M,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    axial_m: Annotated[
        Float64[Array, "order=3 wave=2"] | None,
        Key("Axial deviation of the face.", plausible=plausible.RING_FORM_M, presence=Presence.IF_KNOWN),
    ] = None
    tolerance_m: Annotated[
        float | None,
        Key(
            "Standard deviation at any angle of deviations that are drawn, instead of the coefficients.",
            plausible=plausible.RING_TOLERANCE_M,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    seed: Annotated[int, Key("Seed of the drawn deviations.", least=0, presence=Presence.IF_KNOWN)] = 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingEntry:
    """The key `ring` of a scene: a profile of revolution, or radii and a height."""

    radius_inner_m: Annotated[
        float | None,
        Key("Radius of the inner edge; needed without profile_m.", plausible=RING_RADIUS_M, presence=Presence.IF_KNOWN),
    ] = None
    radius_outer_m: Annotated[
        float | None,
        Key("Radius of the outer edge; needed without profile_m.", plausible=RING_RADIUS_M, presence=Presence.IF_KNOWN),
    ] = None
    height_m: Annotated[
        float | None,
        Key(
            "Height of the ring's face above the body's front face; needed without profile_m.",
            plausible=RING_HEIGHT_M,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    profile_m: Annotated[
        Float64[Array, "point radius_height=2"] | None,
        Key(
            "Points of a polyline, whose highest flat piece is the face: radius and height.",
            plausible=PART_M,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    face: Annotated[
        target.Material, Key("Material of the face.", words=target.MATERIAL_NAMES, presence=Presence.IF_KNOWN)
    ] = target.MATERIALS["metal"]
    wall: Annotated[
        target.Material, Key("Material of the other pieces.", words=target.MATERIAL_NAMES, presence=Presence.IF_KNOWN)
    ] = target.MATERIALS["metal"]
    slope_rad: Annotated[
        float,
        Key(
            "Slope of the face: the angle by which it rises outwards; poses are those of the plane midway.",
            plausible=plausible.SLOPE_RAD,
            presence=Presence.IF_KNOWN,
        ),
    ] = 0.0
    gaps: Annotated[tuple[target.Gap, ...], Key("Slots across the ring.", presence=Presence.IF_KNOWN)] = ()
    form: Annotated[FormEntry | None, Key("How it is out of round and warped.", presence=Presence.IF_KNOWN)] = None
    chamfer_m: Annotated[
        float | None,
        Key(
            "Width of chamfers of 45 degrees at both edges of the face.",
            plausible=PART_M,
            positive=True,
            presence=Presence.IF_KNOWN,
        ),
    ] = None


def ring_of(fields: Fields, entry: RingEntry) -> target.RingShape:
    """The ring of a scene without a target of its own."""
    ring = target.RingShape(profile_m=_profile_m(fields, entry), face=entry.face, wall=entry.wall)
    width_m = ring.radius_outer_m - ring.radius_inner_m
    if not FACE_WIDTH_M.holds(width_m):
        finding, remedy = FACE_WIDTH_M.finding(width_m)
        raise fields.problem("", f"has a face whose width {finding}", remedy)
    return with_details(fields, ring, entry.slope_rad, entry.gaps, entry.form, entry.chamfer_m)


def _profile_m(fields: Fields, entry: RingEntry) -> Float64[Array, "point 2"]:
    profile_m = entry.profile_m
    if profile_m is None:
        inner, outer, height = (fields.number(key) for key in ("radius_inner_m", "radius_outer_m", "height_m"))
        if inner >= outer:
            raise fields.problem("radius_inner_m", f"is {inner:g}, must be smaller than radius_outer_m")
        return np.array([[inner, 0.0], [inner, height], [outer, height], [outer, 0.0]])
    check_profile(fields, profile_m)
    fields.check("profile_m", profile_m[:, 0], RING_RADIUS_M)
    fields.check("profile_m", profile_m[:, 1].max(keepdims=True), RING_HEIGHT_M)
    if (profile_m[:, 1] < 0).any():
        raise fields.problem("profile_m", "has a negative height")
    if not (np.diff(profile_m[:, 1]) == 0).any():
        raise fields.problem("profile_m", "has no flat piece", "the ring's face needs two points at one height")
    return profile_m


def check_profile(fields: Fields, profile_m: Float64[Array, "point 2"]) -> None:
    """Reject a polyline of (radius, height) that no surface of revolution has."""
    if len(profile_m) < 2:
        raise fields.problem("profile_m", f"has {len(profile_m)} points, must have at least 2")
    if (profile_m[:, 0] < 0).any() or (np.abs(np.diff(profile_m, axis=0)).max(axis=1) == 0).any():
        raise fields.problem("profile_m", "has a negative radius or a point twice")


def with_details(
    fields: Fields,
    ring: target.RingShape,
    slope_rad: float,
    gaps: tuple[target.Gap, ...],
    form: FormEntry | None,
    chamfer_m: float | None,
) -> target.RingShape:
    """The ring with the slope, the gaps, the form and the chamfer of an entry with these `fields`."""
    for number, gap in enumerate(gaps):
        if gap.width_m >= 2 * ring.radius_inner_m:
            raise fields.problem(f"gaps[{number}].width_m", f"is {gap.width_m:g}, wider than the ring")
    deviations = None if form is None else _form(fields.fields("form"), form)
    ring = replace(target.sloping(ring, slope_rad), gaps=gaps, form=deviations)
    return ring if chamfer_m is None else _chamfered(fields, ring, chamfer_m)


def _form(fields: Fields, entry: FormEntry) -> target.RingForm:
    """Given coefficients, or random ones such that deviations have the tolerance as their standard deviation."""
    if entry.tolerance_m is not None:
        for key in filter(fields.has, ("inner_m", "outer_m", "axial_m")):
            raise fields.problem(key, "cannot be combined with tolerance_m", "give one of them")
        scale_m = entry.tolerance_m / np.sqrt(3)
        drawn = scale_m * np.random.default_rng(entry.seed).standard_normal((3, 3, 2))
        return target.RingForm(radial_m=drawn[:2], axial_m=drawn[2])
    inner_m, outer_m, axial_m = (
        np.zeros((3, 2)) if given is None else given for given in (entry.inner_m, entry.outer_m, entry.axial_m)
    )
    return target.RingForm(radial_m=np.stack([inner_m, outer_m]), axial_m=axial_m)


def _chamfered(fields: Fields, ring: target.RingShape, chamfer_m: float) -> target.RingShape:
    """Both edges of the face cut at equal distances from them along face and wall."""
    piece, points = ring.face_piece, ring.profile_m
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
