"""What the pages of the console and of recorded data have in common: controls, the scene, text and plots."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import cv2
import numpy as np
import viser
import viser.transforms
from viser import uplot

from ringpose.console.controls import Choice, Control, Number, Switch, Value
from ringpose.geometry.rotations import tilt_basis
from ringpose.pose.advice import remarks_on
from ringpose.report.overlay import color_of, pose_texts
from ringpose.simulate.target.parts import body_part, ring_part
from ringpose.types.arrays import Array, Float64
from ringpose.types.pose import PoseLine, RingPose, RingVelocity
from ringpose.types.rig import Camera, Rig
from ringpose.types.scene import Scene, Truth
from ringpose.types.target import MATERIALS, Box, Part

PLOTS = (
    ("error of the centre (mm)", "center_m", 1e3),
    ("error of the normal (deg)", "normal_rad", 180 / np.pi),
    ("error of the grasp point (mm)", "grasp_m", 1e3),
)
"""Title, error, and factor of its unit."""

RING_POINTS = 90
"""Vertices of a circle in the scene."""

RING_COLORS = (31, 95, 191), (70, 160, 60), (225, 120, 0)
"""Colours of the estimate, the truth and the track."""

COLORS = {"foil": (180, 150, 90), "white": (225, 225, 220), "black": (50, 50, 55), "solar-cells": (40, 50, 100)}
"""Colours of the target's materials; others are grey."""

FRUSTUM_PX = 160
"""Width of the picture in the frustum; without a GPU, that of the panel would take as long as the rest of the scene."""

CHEAP: Any = {"material": "toon3", "cast_shadow": False, "receive_shadow": False}
"""Material of meshes: without a GPU, viser's usual material takes half as long again for each frame."""

PALE = 0.4
"""Share of its color that a ring keeps, the rest is grey, and opacity of the ellipsoid, once they are outdated."""

GREY = 110


class Field:
    """A control, and a line below it that says why a value was not taken."""

    def __init__(self, server: viser.ViserServer, control: Control) -> None:
        self._control = control
        self._handle: Any = _handle_of(server, control)
        self._remark = server.gui.add_markdown("", visible=False)
        self.is_refused = False
        """Whether what was last in the field was not taken."""

    @property
    def value(self) -> object:
        """What is in the field, which need not be a value that the control takes."""
        return self._handle.value

    def show(self, value: Value) -> None:
        """Put a value into the field."""
        self._handle.value = value
        self.report("")

    def extended_to(self, high: float) -> Number:
        """The control with another end of its range of numbers, which the field now has, too."""
        assert isinstance(self._control, Number)
        self._control = replace(self._control, high=high)
        self._handle.max = high
        return self._control

    def on_update(self, action: Callable[[], None]) -> None:
        """Act when a browser has changed the value."""
        self._handle.on_update(lambda event: None if event.client is None else action())

    def report(self, refusal: str) -> None:
        """Show why what is in the field was not taken; empty if it was.

        A browser replaces a number out of range by the nearest limit when the field is left: then the range is shown.
        """
        control = self._control
        if not refusal and self.is_refused and isinstance(control, Number):
            is_limit = self.value in (control.low, control.high)
            refusal = f"limited to {control.low:g} to {control.high:g}" if is_limit else ""
        self.is_refused = bool(refusal)
        text = f"*{plain(refusal)}*" if refusal else ""
        if self._remark.content != text:
            self._remark.content, self._remark.visible = text, bool(text)


def _handle_of(server: viser.ViserServer, control: Control) -> Any:
    gui, label = server.gui, encodable(control.label)
    if isinstance(control, Number):
        return gui.add_slider(label, control.low, control.high, control.step, control.initial)
    if isinstance(control, Choice):
        return gui.add_dropdown(label, control.options, initial_value=control.initial)
    if isinstance(control, Switch):
        return gui.add_checkbox(label, control.initial)
    return gui.add_text(label, control.initial)


def plain(text: str) -> str:
    """Text that a page shows as it is: without Markdown, HTML and line breaks, whatever a file contains."""
    return re.sub(r"[!-/:-@\[-`{-~]", lambda found: f"&#{ord(found[0])};", " ".join(encodable(text).split()))


def encodable(text: str) -> str:
    """Text with a question mark for each lone surrogate, which would break the connection to every browser."""
    return text.encode("utf-8", "replace").decode("utf-8")


class ImagePanel:
    """An image in the panel, which is passed as JPEG."""

    def __init__(self, server: viser.ViserServer, label: str) -> None:
        self._handle = server.gui.add_image(np.zeros((120, 160, 3), np.uint8), label=label, format="jpeg")

    def show(self, jpeg: bytes, label: str | None = None) -> None:
        """Show this JPEG."""
        self._handle._data = jpeg  # the setter of `image` would encode again, and once for each place
        if label is not None:
            self._handle.label = encodable(label)


class SceneView:
    """Camera, light planes and rings in three dimensions; the frame is that of the camera."""

    def __init__(self, server: viser.ViserServer, rig: Rig, target_m: Float64[Array, "xyz=3"]) -> None:
        self._server, self._rig = server, rig
        distance_m = max(float(np.linalg.norm(target_m)), 0.5)
        server.initial_camera.position = tuple(np.array([-1.7, -1.1, -1.5]) * distance_m)
        server.initial_camera.look_at = tuple(0.8 * target_m)
        self._frustum = server.scene.add_camera_frustum(
            "/camera", *_field_of_view(rig.camera), scale=0.12, color=(200, 200, 200), thickness=2.0,
            thickness_units="screen",
        )  # fmt: skip
        both_sides = np.array([[0, 1, 2], [0, 2, 1]])  # side="double" would draw a transparent mesh twice
        self._planes = [
            server.scene.add_mesh_simple(
                f"/light/{name}", np.zeros((3, 3)), both_sides, color=color_of(laser)[::-1], opacity=0.35, **CHEAP
            )
            for laser, name in enumerate(rig.lasers.names)
        ]  # fmt: skip
        self._center = server.scene.add_icosphere("/estimate/center", 1.0, (176, 48, 144), visible=False, **CHEAP)
        self._lines: dict[str, viser.LineSegmentsHandle] = {}

    def show_image(self, jpeg: bytes) -> None:
        """Show the image of the measurement camera in its frustum, in the size in which it is seen there."""
        image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_REDUCED_COLOR_4)
        assert image is not None
        size = FRUSTUM_PX, round(FRUSTUM_PX * image.shape[0] / image.shape[1])
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        self._frustum.image = small[:, :, ::-1]

    def show_rig(self, rig: Rig, mask: int, depth_m: float) -> None:
        """The frustum, and the light planes of the lasers of the mask up to a depth."""
        self._frustum.fov, self._frustum.aspect = _field_of_view(rig.camera)
        for laser, plane in enumerate(self._planes):
            plane.vertices, plane.visible = _light_plane(rig, laser, depth_m), bool(mask >> laser & 1)

    def show_stripes(self, segments: Float64[Array, "laser 2 xyz=3"], mask: int) -> None:
        """Where the light planes of the lasers of the mask meet the ring's face; NaN where they do not."""
        seen = np.isfinite(segments).all(axis=(1, 2)) & np.array([mask >> k & 1 == 1 for k in range(len(segments))])
        self._show_lines("/stripes", segments[seen], [color_of(int(each))[::-1] for each in np.flatnonzero(seen)], 5.0)

    def show_rings(
        self, pose: RingPose | None, truth: Truth | None, track: RingPose | None, *, is_outdated: bool = False
    ) -> None:
        """The estimated ring with the error ellipsoid of its centre, the true one and that of the track.

        Outdated ones are pale.
        """
        segments = [_ring_segments(ring) for ring in (pose, truth, track)]
        share = PALE if is_outdated else 1.0
        shades = [tuple(round(share * part + (1 - share) * GREY) for part in color) for color in RING_COLORS]
        colors = [color for each, color in zip(segments, shades, strict=True) for _ in each]
        self._center.opacity = share
        self._show_lines("/rings", np.concatenate(segments), colors, 2.0)
        covariance = None if pose is None else pose.covariance_center_m2
        self._center.visible = is_known = covariance is not None and bool(np.isfinite(covariance).all())
        if is_known and pose is not None and covariance is not None:
            variance, axes = np.linalg.eigh(covariance)
            first, second, third = (3 * np.sqrt(np.maximum(variance, 1e-12))).tolist()
            self._center.scale = (first, second, third)
            self._center.wxyz = viser.transforms.SO3.from_matrix(axes * np.sign(np.linalg.det(axes))).wxyz
            self._center.position = pose.center_m

    def _show_lines(
        self, name: str, segments: Float64[Array, "n 2 xyz=3"], colors: Sequence[tuple[int, ...]], thickness_px: float
    ) -> None:
        """Replace the line segments of a name, with a color each; none hides them."""
        if name not in self._lines:
            blank = np.zeros((1, 2, 3))
            self._lines[name] = self._server.scene.add_line_segments(
                name, blank, blank.astype(np.uint8), thickness=thickness_px, thickness_units="screen"
            )
        lines = self._lines[name]
        lines.visible = len(segments) > 0
        if len(segments):
            linear = 255 * (np.array(colors) / 255) ** 2.2  # viser takes the colors of lines for linear ones
            lines.colors = np.repeat(linear.astype(np.uint8)[:, None], 2, axis=1)
            lines.points = segments


def _ring_segments(ring: RingPose | Truth | None) -> Float64[Array, "n 2 xyz=3"]:
    """Both edges and the normal, as far as they are known."""
    center_m, normal = (None, None) if ring is None else (ring.center_m, ring.normal)
    if ring is None or center_m is None or normal is None or not np.isfinite([*center_m, *normal]).all():
        return np.empty((0, 2, 3))
    radii = [each for each in (ring.radius_inner_m, ring.radius_outer_m) if each is not None and np.isfinite(each)]
    circles = [_circle(center_m, normal, radius) for radius in radii]
    return np.concatenate([*circles, np.array([[center_m, center_m + 0.15 * normal]])])


class Plots:
    """Errors of measurements with the standard deviations that they report."""

    def __init__(self, server: viser.ViserServer, x_label: str) -> None:
        blank = (np.zeros(1), np.zeros(1), np.zeros(1))
        self._plots = [
            server.gui.add_uplot(
                blank,
                (uplot.Series(label=x_label), _points("error", "#1f5fbf"), _points("sigma", "#c0392b")),
                title=title,
                scales={"x": uplot.Scale(time=False)},
                aspect=2.0,
            )
            for title, *_ in PLOTS
        ]

    def show(self, x: Sequence[float], rows: Sequence[tuple[float, ...]]) -> None:
        """Show a row for each measurement: error and standard deviation of each plot, as `plotted` returns them."""
        if not rows:
            return
        table, places = np.array(rows), np.array(x, dtype=np.float64)
        for number, plot in enumerate(self._plots):
            plot.data = (places, table[:, 2 * number], table[:, 2 * number + 1])


def _points(label: str, color: str) -> uplot.Series:
    """A plot series of points without lines, which would join the measurements on both sides of a missing one."""
    return uplot.Series(label=label, stroke=color, width=0, points={"show": True, "size": 4, "fill": color})


def plotted(pose: RingPose | None, errors: Mapping[str, float]) -> tuple[float, ...]:
    """Error and reported standard deviation of each plot, in its unit; NaN where there is none."""
    tilts = None if pose is None or pose.covariance is None else pose.covariance[:2, :2]
    covariances = {
        "center_m": None if pose is None else pose.covariance_center_m2,
        "normal_rad": tilts,
        "grasp_m": None if pose is None else pose.covariance_grasp_m2,
    }
    row: list[float] = []
    for _, name, factor in PLOTS:
        covariance = covariances[name]
        sigma = np.nan if covariance is None else float(np.sqrt(np.trace(covariance)))
        row += [factor * errors.get(name, np.nan), factor * sigma]
    return tuple(row)


def line_text(line: PoseLine | None, about: str, errors: Mapping[str, float], outdated: str = "") -> str:
    """Status, flags, reason, pose and errors of a measurement; `about` names what was measured.

    `outdated` says what has changed since, if it is no longer that of the target; its status then is what it was.
    """
    if line is None:
        return f"**not measured** ({plain(about)})"
    rows = [f"**outdated**: {plain(outdated)}", f"was {line.status} ({plain(about)})"] if outdated else []
    rows = rows or [f"**{line.status}** ({plain(about)})"]
    if (remarks := remarks_on(line)) != line.status:
        rows.append(plain(remarks))
    if line.pose is not None:
        rows += [plain(text.replace("+-", "±")) for text in pose_texts(line.pose)]
    shown = [
        f"{name} {factor * errors[key]:.3f}{unit}"
        for name, key, factor, unit in (
            ("centre", "center_m", 1e3, " mm"),
            ("grasp", "grasp_m", 1e3, " mm"),
            ("normal", "normal_rad", 180 / np.pi, "°"),
        )
        if key in errors
    ]
    return "  \n".join([*rows, f"errors: {', '.join(shown)}" if shown else "no errors: nothing to compare"])


def track_text(pose: RingPose | None, velocity: RingVelocity | None, status: str, error_m: float = np.nan) -> str:
    """One line on a track: its status, centre, speed and rate, and the error of its centre if it is known."""
    status = plain(status)
    if pose is None:
        return f"track: {status}"
    x, y, z = 1e3 * pose.center_m
    parts = [f"track: {status}, centre {x:.2f}, {y:.2f}, {z:.2f} mm"]
    if velocity is not None:
        rate_deg_s = np.degrees(np.linalg.norm(velocity.rate_rad_s))
        parts.append(f"{1e3 * np.linalg.norm(velocity.center_m_s):.1f} mm/s, {rate_deg_s:.2f} deg/s")
    if np.isfinite(error_m):
        parts.append(f"error of the centre {1e3 * error_m:.3f} mm")
    return ", ".join(parts)


def _field_of_view(camera: Camera) -> tuple[float, float]:
    """Vertical angle of view (rad), and ratio of width to height."""
    angle_rad = 2 * np.arctan(camera.image_height / 2 / camera.camera_matrix[1, 1])
    return float(angle_rad), camera.image_width / camera.image_height


def _circle(center_m: Float64[Array, "3"], normal: Float64[Array, "3"], radius_m: float) -> Float64[Array, "n 2 3"]:
    angle = np.linspace(0.0, 2 * np.pi, RING_POINTS + 1)
    first, second = tilt_basis(normal)
    points = center_m + radius_m * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second)
    segments: Float64[Array, "n 2 3"] = np.stack([points[:-1], points[1:]], axis=1)
    return segments


def target_surfaces(scene: Scene) -> dict[tuple[int, int, int], tuple[Float64[Array, "n xyz=3"], Any]]:
    """Vertices in the target frame, and triangles, of all parts of a color: few meshes are drawn faster than many."""
    body = () if scene.body is None else (body_part(scene.body),)
    meshes: dict[tuple[int, int, int], list[tuple[Any, Any]]] = {}
    for part in (*body, *scene.parts, ring_part(scene.ring)):
        vertices_m, faces = _box(part.shape) if isinstance(part.shape, Box) else _revolution(part.shape.profile_m)
        found = meshes.setdefault(_color(part), [])
        known = sum(len(each) for each, _ in found)
        found.append((vertices_m @ part.rotation.T + part.translation_m, faces + known))
    return {
        color: (np.concatenate([each for each, _ in found]), np.concatenate([each for _, each in found]))
        for color, found in meshes.items()
    }


def _color(part: Part) -> tuple[int, int, int]:
    return next((COLORS[name] for name in COLORS if MATERIALS[name] == part.materials[0]), (150, 155, 165))


def _box(box: Box) -> tuple[Any, Any]:
    """Vertices and triangles; each side has vertices of its own, and so a sharp edge."""
    corners_m = np.array(list(product(*zip(box.low_m, box.high_m, strict=True))))
    sides = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    first = 4 * np.arange(6)[:, None]
    return corners_m[sides.ravel()], np.concatenate([first + np.array(each) for each in ((0, 1, 2), (0, 2, 3))])


def _revolution(profile_m: Float64[Array, "point 2"]) -> tuple[Any, Any]:
    """Vertices and triangles; each segment of the profile has vertices of its own, and so a sharp edge."""
    angle = np.linspace(0.0, 2 * np.pi, RING_POINTS, endpoint=False)[:, None]
    radius, height = np.repeat(profile_m, 2, axis=0)[1:-1].T
    vertices = np.stack(
        [np.cos(angle) * radius, np.sin(angle) * radius, np.broadcast_to(height, (RING_POINTS, len(height)))], -1
    )
    here = np.arange(RING_POINTS * len(height)).reshape(RING_POINTS, -1, 2)
    onward = np.roll(here, -1, axis=0)
    quads = [(here[..., 0], here[..., 1], onward[..., 1]), (here[..., 0], onward[..., 1], onward[..., 0])]
    return vertices.reshape(-1, 3), np.concatenate([np.stack(each, axis=-1).reshape(-1, 3) for each in quads])


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
