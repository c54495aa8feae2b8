"""What is drawn in three dimensions of a rig, its measurements and a simulated target, as data.

The pages of the console and of recorded data draw these elements live (`ringpose.console.live_scene`), the replay in
one file (`ringpose.console.replay`). Lengths are in metres in the camera frame, colours are red, green, blue.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from itertools import product
from typing import Any, Literal, NamedTuple

import numpy as np

from ringpose.geometry.ring import predicted_break_points, ring_arcs
from ringpose.geometry.rotations import tilt_basis
from ringpose.report.overlay import color_of
from ringpose.simulate.placement import Placement
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.image import ALL_LASERS
from ringpose.types.points import PointCloud
from ringpose.types.pose import RingPose
from ringpose.types.rig import Camera, Rig
from ringpose.types.scene import Earth, Light, Scene
from ringpose.types.target import MATERIALS, Box, Part
from ringpose.types.truth import Truth

Color = tuple[int, int, int]
Dash = Literal["solid", "dashed", "dotted"]

# Elements


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Path:
    """A line through points."""

    points_m: Float64[Array, "point xyz=3"]
    color: Color
    dash: Dash = "solid"
    """Lines of the live scene are solid."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Circle:
    """A circle."""

    center_m: Float64[Array, "xyz=3"]
    axes_m: Float64[Array, "axis=2 xyz=3"]
    """Two radii at right angles."""
    color: Color
    dash: Dash = "solid"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lines:
    """Lines of one width."""

    name: str
    strokes: tuple[Path | Circle, ...]
    width_px: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surface:
    """Triangles; of a convex one that is not opaque, the vertices are its outline."""

    name: str
    vertices_m: Float64[Array, "vertex xyz=3"]
    triangles: Int64[Array, "triangle corner=3"]
    color: Color
    opacity: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ellipsoid:
    """An ellipsoid by its half axes, at right angles."""

    name: str
    center_m: Float64[Array, "xyz=3"]
    half_axes_m: Float64[Array, "axis=3 xyz=3"]
    color: Color
    opacity: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ball:
    """A sphere."""

    name: str
    center_m: Float64[Array, "xyz=3"]
    radius_m: float
    color: Color


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arrow:
    """A thick arrow."""

    name: str
    ends_m: Float64[Array, "end=2 xyz=3"]
    color: Color


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Label:
    """A word at a place."""

    name: str
    position_m: Float64[Array, "xyz=3"]
    text: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frustum:
    """The pyramid of view of a camera at the origin, to a depth of 1 m: its corners from the top left, clockwise."""

    name: str
    corners_m: Float64[Array, "corner=4 xyz=3"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Points:
    """Points of one colour."""

    name: str
    points_m: Float64[Array, "point xyz=3"]
    color: Color


Element = Lines | Surface | Ellipsoid | Ball | Arrow | Label | Frustum | Points


# The rig


def camera_frustum(camera: Camera) -> Frustum:
    """The pyramid of view, without the lens's distortion."""
    width, height = camera.image_width, camera.image_height
    corners_px = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.float64)
    (fx, _, cx), (_, fy, cy) = camera.camera_matrix[:2]
    slopes = (corners_px - [cx, cy]) / [fx, fy]
    return Frustum(name="camera", corners_m=np.column_stack([slopes, np.ones(4)]))


PLANE_OPACITY, PLANE_DEPTH = 0.35, 1.1
"""Opacity of light planes, and their depth over the distance of the target."""


def rig_elements(rig: Rig, mask: int, target_m: Float64[Array, "xyz=3"]) -> tuple[Element, ...]:
    """The camera, and the light planes of the lasers of a mask up to beyond the target."""
    return camera_frustum(rig.camera), *light_planes(rig, mask, PLANE_DEPTH * float(np.linalg.norm(target_m)))


def light_planes(rig: Rig, mask: int, depth_m: float) -> tuple[Surface, ...]:
    """The light planes of the lasers of a mask up to a depth."""
    return tuple(
        Surface(
            name=name,
            vertices_m=_light_plane(rig, laser, depth_m),
            triangles=np.array([[0, 1, 2]]),
            color=laser_color(laser),
            opacity=PLANE_OPACITY,
        )
        for laser, name in enumerate(rig.lasers.names)
        if mask >> laser & 1
    )


def _light_plane(rig: Rig, laser: int, depth_m: float) -> Float64[Array, "3 3"]:
    """A triangle in a light plane: the projector, and the ends of its line across the view at a depth."""
    camera, lasers = rig.camera, rig.lasers
    normal, distance_m = lasers.normal[laser], lasers.distance_m[laser]
    half_m = camera.image_width / 2 / camera.camera_matrix[0, 0] * depth_m
    if abs(normal[1]) > abs(normal[0]):
        ends = [[x, (distance_m - normal[0] * x - normal[2] * depth_m) / normal[1], depth_m] for x in (-half_m, half_m)]
    else:
        ends = [[(distance_m - normal[1] * y - normal[2] * depth_m) / normal[0], y, depth_m] for y in (-half_m, half_m)]
    projector = lasers.projector_m[laser]
    start = projector if np.isfinite(projector).all() else np.zeros(3)
    return np.array([start, *ends])


def laser_color(laser: int) -> Color:
    """The colour of a laser's stripe, as in the pictures."""
    blue, green, red = color_of(laser)
    return red, green, blue


# The ring, as it is, measured and followed


class RingStyle(NamedTuple):
    """How a ring is drawn, and its colour in a word."""

    color: Color
    word: str
    dash: Dash


RING_STYLES = {
    "pose": RingStyle((31, 95, 191), "blue", "solid"),
    "track": RingStyle((225, 120, 0), "orange", "dotted"),
    "truth": RingStyle((70, 160, 60), "green", "dashed"),
}


def legend_html(rig: Rig, names: Sequence[str] = tuple(RING_STYLES)) -> str:
    """What the colours of the scene mean, as HTML."""
    entries = [(RING_TITLES[name], RING_STYLES[name].color) for name in names]
    entries += [("grasp point", GRASP_COLOR), (f"centre, {CENTER_SIGMAS:g} sigma", CENTER_COLOR)]
    entries += [(f"laser {name}", laser_color(laser)) for laser, name in enumerate(rig.lasers.names)]
    marks = [
        f'<span style="white-space:nowrap"><b style="color:rgb{color}">&#9632;</b> {escape(text)}</span>'
        for text, color in entries
    ]
    style = "display:flex;flex-wrap:wrap;gap:0 0.9em;padding:0 0.6em;font-size:0.85em"
    return f'<div style="{style}">{"".join(marks)}</div>'


RING_TITLES = {"pose": "estimate", "track": "track", "truth": "truth"}


NORMAL_M = 0.15
"""Length of a drawn normal."""

GRASP_COLOR, GRASP_RADIUS_M = (192, 57, 43), 0.006

CENTER_COLOR, CENTER_SIGMAS = (176, 48, 144), 3.0
"""Colour and half axes, in standard deviations, of the ellipsoid about a measured centre."""

MIN_VARIANCE_M2 = 1e-12
"""Minimum variance of the ellipsoid along an axis, so that it has a direction."""

PALE = 0.4
"""Share of its colour that a ring keeps, the rest is grey, and opacity of the ellipsoid, once they are outdated."""

GREY = 110


def rings(
    pose: RingPose | None, truth: Truth | None, track: RingPose | None, *, is_outdated: bool = False
) -> tuple[Element, ...]:
    """The rings as far as they are known, the measured grasp point, and the error ellipsoid of the measured centre.

    Outdated ones are pale.
    """
    share = PALE if is_outdated else 1.0
    strokes = [
        stroke
        for (name, style), ring in zip(RING_STYLES.items(), (pose, track, truth), strict=True)
        for stroke in _ring_strokes(ring, pale(style.color, share), style.dash)
    ]
    elements: list[Element] = [Lines(name="rings", strokes=tuple(strokes), width_px=2.0)]
    if pose is None:
        return tuple(elements)
    if pose.grasp_m is not None and np.isfinite(pose.grasp_m).all():
        color = pale(GRASP_COLOR, share)
        elements.append(Ball(name="grasp", center_m=pose.grasp_m, radius_m=GRASP_RADIUS_M, color=color))
    covariance = pose.covariance_center_m2
    if pose.center_m is not None and covariance is not None and np.isfinite(covariance).all():
        variance, axes = np.linalg.eigh(covariance)
        sigma_m = np.sqrt(np.maximum(variance, MIN_VARIANCE_M2))
        elements.append(
            Ellipsoid(
                name="center",
                center_m=pose.center_m,
                half_axes_m=(CENTER_SIGMAS * sigma_m * axes).T,
                color=CENTER_COLOR,
                opacity=share,
            )
        )
    return tuple(elements)


def pale(color: Color, share: float) -> Color:
    """A colour of which a share is left; the rest is grey."""
    red, green, blue = (round(share * part + (1 - share) * GREY) for part in color)
    return red, green, blue


def _ring_strokes(ring: RingPose | Truth | None, color: Color, dash: Dash) -> list[Path | Circle]:
    """Both edges and the normal, as far as they are known."""
    center_m, normal = (None, None) if ring is None else (ring.center_m, ring.normal)
    if ring is None or center_m is None or normal is None or not np.isfinite([*center_m, *normal]).all():
        return []
    radii = [
        radius for radius in (ring.radius_inner_m, ring.radius_outer_m) if radius is not None and np.isfinite(radius)
    ]
    basis = np.array(tilt_basis(normal))
    circles = [Circle(center_m=center_m, axes_m=radius * basis, color=color, dash=dash) for radius in radii]
    return [*circles, Path(points_m=np.array([center_m, center_m + NORMAL_M * normal]), color=color, dash=dash)]


def stripes(
    rig: Rig,
    mask: int,
    center_m: Float64[Array, "xyz=3"],
    normal: Float64[Array, "xyz=3"],
    radii_m: tuple[float, float],
) -> Lines:
    """Where the light planes of the lasers of a mask meet the face of a ring of these radii, inner and outer."""
    near_m = np.array([0.0, 0.0, float(center_m[2])])
    arcs = ring_arcs(center_m, normal, np.array(radii_m), near_m)
    strokes = [
        Path(points_m=ends_m, color=laser_color(laser))
        for laser, ends_m in enumerate(predicted_break_points(arcs, rig.lasers.normal, rig.lasers.distance_m))
        if mask >> laser & 1 and np.isfinite(ends_m).all()
    ]
    return Lines(name="stripes", strokes=tuple(strokes), width_px=5.0)


def recorded_elements(
    rig: Rig, pose: RingPose | None, truth: Truth | None, track: RingPose | None
) -> tuple[Element, ...]:
    """The rings of a recorded shot, and the stripes on the measured one, else on the true one, if it is known."""
    ring = pose if pose is not None else truth
    elements = rings(pose, truth, track)
    if ring is None or ring.center_m is None or ring.normal is None:
        return elements
    radii_m = (ring.radius_inner_m or np.nan, ring.radius_outer_m or np.nan)
    if not np.isfinite([*ring.center_m, *ring.normal, *radii_m]).all():
        return elements
    return *elements, stripes(rig, ALL_LASERS, ring.center_m, ring.normal, radii_m)


def cloud_points(cloud: PointCloud, shot: int | None = None) -> tuple[Points, ...]:
    """The points of a cloud, or of one of its shots, in its frame and in the colours of their lasers."""
    of_shot = np.full(len(cloud.shot), True) if shot is None else cloud.shot == shot
    return tuple(
        Points(
            name=f"laser_{laser}",
            points_m=cloud.position_m[of_shot & (cloud.laser == laser)],
            color=laser_color(laser),
        )
        for laser in np.unique(cloud.laser).tolist()
    )


NOTHING = np.zeros((0, 3))

MOST = (5.0, 50.0, 95.0)
"""Percentiles of points between which most are: what is far behind the target would make it small."""


class Bounds(NamedTuple):
    """A sphere about the camera and what it sees."""

    target_m: Float64[Array, "xyz=3"]
    """Centre of the first ring."""
    middle_m: Float64[Array, "xyz=3"]
    radius_m: float


def bounds(shown: Sequence[RingPose | Truth | None], points_m: Float64[Array, "point xyz=3"] = NOTHING) -> Bounds:
    """The sphere about the camera and these rings, as far as they are known; without any, about most of the points."""
    target_m, box_m = None, [np.zeros(3)]
    for ring in shown:
        if ring is not None and ring.center_m is not None and np.isfinite(ring.center_m).all():
            target_m = ring.center_m if target_m is None else target_m
            reach_m = ring.radius_outer_m or 0.0
            box_m += [ring.center_m + reach_m, ring.center_m - reach_m]
    if target_m is None and len(points_m):
        low_m, target_m, high_m = np.percentile(points_m, MOST, axis=0)
        box_m += [low_m, high_m]
    target_m = np.array([0.0, 0.0, 1.0]) if target_m is None else target_m
    low_m, high_m = np.min([*box_m, target_m], axis=0), np.max([*box_m, target_m], axis=0)
    return Bounds(target_m, (low_m + high_m) / 2, float(np.linalg.norm(high_m - low_m)) / 2)


def bounds_of_target(surfaces: Sequence["Surface"], placement: Placement) -> Bounds:
    """The sphere about the camera and a target whose surfaces are in its own frame."""
    vertices_m = np.concatenate([placement.points_camera(surface.vertices_m) for surface in surfaces])
    low_m, high_m = np.minimum(vertices_m.min(axis=0), 0.0), np.maximum(vertices_m.max(axis=0), 0.0)
    middle_m = (low_m + high_m) / 2
    radius_m = max(float(np.linalg.norm(vertices_m - middle_m, axis=1).max()), float(np.linalg.norm(middle_m)))
    return Bounds(placement.translation_m, middle_m, radius_m)


# The simulated target, in its own frame

SIDES = 90
"""Sides of a polygon that is drawn for a circle."""

COLORS = {"foil": (180, 150, 90), "white": (225, 225, 220), "black": (50, 50, 55), "solar-cells": (40, 50, 100)}
"""Colours of the target's materials; others are grey."""

OTHER_COLOR = (150, 155, 165)


def target_surfaces(scene: Scene) -> tuple[Surface, ...]:
    """All parts, in the target frame; those of a colour are one surface: few meshes are drawn faster than many."""
    from ringpose.simulate.target.parts import body_part, ring_part

    body = () if scene.body is None else (body_part(scene.body),)
    meshes: dict[Color, list[tuple[Any, Any]]] = {}
    for part in (*body, *scene.parts, ring_part(scene.ring)):
        vertices_m, triangles = _box(part.shape) if isinstance(part.shape, Box) else _revolution(part.shape.profile_m)
        same = meshes.setdefault(_color(part), [])
        known = sum(len(before_m) for before_m, _ in same)
        same.append((vertices_m @ part.rotation.T + part.translation_m, triangles + known))
    return tuple(
        Surface(
            name=f"{number}",
            vertices_m=np.concatenate([of_part_m for of_part_m, _ in same]),
            triangles=np.concatenate([of_part for _, of_part in same]),
            color=color,
        )
        for number, (color, same) in enumerate(meshes.items())
    )


EDGE_SHARE = 0.45
"""Brightness of an edge over that of its surface."""

MIN_EDGE_RADIUS_M = 0.02
"""Radius of a circular edge from which it is drawn; smaller ones are dots."""


def target_edges(scene: Scene) -> Lines:
    """The edges of all parts, in the target frame: of boxes all twelve, of bodies of revolution their circles."""
    from ringpose.simulate.target.parts import body_part, ring_part

    body = () if scene.body is None else (body_part(scene.body),)
    strokes: list[Path | Circle] = []
    for part in (*body, *scene.parts, ring_part(scene.ring)):
        red, green, blue = (round(EDGE_SHARE * each) for each in _color(part))
        color = red, green, blue
        if isinstance(part.shape, Box):
            corners_m = np.array(list(product(*zip(part.shape.low_m, part.shape.high_m, strict=True))))
            ends = [(a, a | bit) for a in range(8) for bit in (1, 2, 4) if not a & bit]
            outlines_m = [corners_m[list(pair)] @ part.rotation.T + part.translation_m for pair in ends]
            strokes += [Path(points_m=points_m, color=color) for points_m in outlines_m]
            continue
        for radius_m, height_m in dict.fromkeys(map(tuple, part.shape.profile_m.tolist())):
            if radius_m >= MIN_EDGE_RADIUS_M:
                center_m = part.rotation @ np.array([0.0, 0.0, height_m]) + part.translation_m
                axes_m = radius_m * part.rotation.T[:2]
                strokes.append(Circle(center_m=center_m, axes_m=axes_m, color=color))
    return Lines(name="edges", strokes=tuple(strokes), width_px=1.5)


def _color(part: Part) -> Color:
    return next((COLORS[name] for name in COLORS if MATERIALS[name] == part.materials[0]), OTHER_COLOR)


def _box(box: Box) -> tuple[Any, Any]:
    """Vertices and triangles; each side has vertices of its own, and so a sharp edge."""
    corners_m = np.array(list(product(*zip(box.low_m, box.high_m, strict=True))))
    sides = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    first = 4 * np.arange(6)[:, None]
    return corners_m[sides.ravel()], np.concatenate([first + np.array(each) for each in ((0, 1, 2), (0, 2, 3))])


def _revolution(profile_m: Float64[Array, "point 2"]) -> tuple[Any, Any]:
    """Vertices and triangles; each segment of the profile has vertices of its own, and so a sharp edge."""
    angle = np.linspace(0.0, 2 * np.pi, SIDES, endpoint=False)[:, None]
    radius, height = np.repeat(profile_m, 2, axis=0)[1:-1].T
    height = np.broadcast_to(height, (SIDES, len(height)))
    vertices = np.stack([np.cos(angle) * radius, np.sin(angle) * radius, height], axis=-1)
    here = np.arange(height.size).reshape(SIDES, -1, 2)
    onward = np.roll(here, -1, axis=0)
    quads = [(here[..., 0], here[..., 1], onward[..., 1]), (here[..., 0], onward[..., 1], onward[..., 0])]
    return vertices.reshape(-1, 3), np.concatenate([np.stack(each, axis=-1).reshape(-1, 3) for each in quads])


# Its sky

SUN_COLOR, EARTH_COLOR = (240, 180, 40), (70, 110, 180)

EARTH_MARGIN_M = 0.5
"""Gap between the target and the Earth, which is drawn beyond all parts, as large as it appears from the ring."""


def sky(scene: Scene, center_m: Float64[Array, "xyz=3"], light: Light) -> tuple[Element, ...]:
    """An arrow from the sun, and the Earth in its direction from the ring's centre, beyond all parts of the target."""
    elements: list[Element] = []
    if light.sun_w_m2 > 0:
        sun_m = center_m + 0.8 * light.sun_direction
        ends_m = np.array([sun_m, sun_m - 0.4 * light.sun_direction])
        elements += [
            Arrow(name="sun", ends_m=ends_m, color=SUN_COLOR),
            Label(name="sun_name", position_m=sun_m, text="sun"),
        ]
    if light.earth is not None:
        distance_m, radius_m = drawn_earth_m(scene, light.earth)
        earth_m = center_m + distance_m * light.earth.direction / np.linalg.norm(light.earth.direction)
        elements += [
            Ball(name="earth", center_m=earth_m, radius_m=radius_m, color=EARTH_COLOR),
            Label(name="earth_name", position_m=earth_m, text="Earth"),
        ]
    return tuple(elements)


def drawn_earth_m(scene: Scene, earth: Earth) -> tuple[float, float]:
    """Distance (from the ring) and radius of a drawn Earth: as large as it appears from there, beyond all parts."""
    center_m = np.array([0.0, 0.0, scene.ring.height_m])
    vertices_m = np.concatenate([surface.vertices_m for surface in target_surfaces(scene)])
    reach_m = float(np.linalg.norm(vertices_m - center_m, axis=1).max())
    sine = float(np.sin(earth.angular_radius_rad))
    distance_m = (reach_m + EARTH_MARGIN_M) / (1 - sine)
    return distance_m, distance_m * sine
