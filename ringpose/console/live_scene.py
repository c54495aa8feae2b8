"""The scene in three dimensions on a live page, by viser."""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import cv2
import numpy as np
import viser
import viser.transforms

from ringpose.console import drawing
from ringpose.types.arrays import Array, Float64

FRUSTUM_PX = 160
"""Width of the picture in the frustum; without a GPU, that of the panel would take as long as the rest of the scene."""

CHEAP: Any = {"material": "toon5", "cast_shadow": False, "receive_shadow": False}
"""Material of meshes, in five tones: without a GPU, viser's usual material takes half as long again for each frame."""

VIEW_DIRECTION = (-1.0, -0.8, -1.7)
"""From the scene to the eye at the start: from behind the camera, on its left and above it."""

VIEW_RADII = 1.75
"""Distance of the eye from the middle of the scene, in radii of the scene, which then fills the view of 75 degrees."""

BALL_SUBDIVISIONS = 4

ARROW: Any = {"shaft_radius": 0.008, "head_radius": 0.02, "head_length": 0.05}

POINT_M = 0.001
"""Size of a drawn point."""

FRUSTUM: Any = {"scale": 0.12, "color": (200, 200, 200), "thickness": 2.0, "thickness_units": "screen"}


class LiveScene:
    """Draws elements in groups; what is drawn of a group is replaced by what is shown next of it."""

    def __init__(self, server: viser.ViserServer, shown: drawing.Bounds) -> None:
        self._server = server
        self._handles: dict[str, Any] = {}
        distance_m = VIEW_RADII * max(shown.radius_m, 0.1)
        self._position_m = shown.middle_m + distance_m * np.array(VIEW_DIRECTION) / np.linalg.norm(VIEW_DIRECTION)
        self._middle_m = shown.middle_m
        server.initial_camera.position = tuple(self._position_m)
        server.initial_camera.look_at = tuple(self._middle_m)

    def reset_view(self) -> None:
        """Show all of the scene in every browser, as at the start."""
        for client in self._server.get_clients().values():
            client.camera.position = self._position_m
            client.camera.look_at = self._middle_m
            client.camera.up_direction = (0.0, -1.0, 0.0)

    def place(self, group: str, rotation: Float64[Array, "3 3"], translation_m: Float64[Array, "xyz=3"]) -> None:
        """Draw a group, which has not been shown before, in a frame with this pose, or move that frame."""
        name = f"/{group}"
        if name not in self._handles:
            self._handles[name] = self._server.scene.add_frame(name, show_axes=False)
        self._handles[name].wxyz = viser.transforms.SO3.from_matrix(rotation).wxyz
        self._handles[name].position = translation_m

    def show(self, group: str, elements: Iterable[drawing.Element]) -> None:
        """Draw the elements of a group, and hide those that it had before."""
        shown = {f"/{group}/{element.name}": element for element in elements}
        for name in self._handles.keys() - shown.keys():
            if name.startswith(f"/{group}/"):
                self._handles[name].visible = False
        for name, element in shown.items():
            draw = _DRAWN_BY[type(element)]
            self._handles[name] = draw(self._server.scene, name, self._handles.get(name), element)

    def show_image(self, camera: str, jpeg: bytes) -> None:
        """Show the image of a camera in its frustum, which is drawn already, in the size in which it is seen there."""
        image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_REDUCED_COLOR_4)
        assert image is not None
        size = FRUSTUM_PX, round(FRUSTUM_PX * image.shape[0] / image.shape[1])
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        self._handles[camera].image = small[:, :, ::-1]


# One function for each kind of element: it changes the handle, or creates it if there is none


def _lines(scene: viser.SceneApi, name: str, handle: Any, lines: drawing.Lines) -> Any:
    if handle is None:
        blank = np.zeros((1, 2, 3))
        width: Any = {"thickness": lines.width_px, "thickness_units": "screen"}
        handle = scene.add_line_segments(name, blank, blank.astype(np.uint8), **width)
    handle.visible = bool(lines.strokes)
    if lines.strokes:
        segments = [_segments(stroke) for stroke in lines.strokes]
        colors = np.repeat([stroke.color for stroke in lines.strokes], [len(each) for each in segments], axis=0)
        linear = 255 * (colors / 255) ** 2.2  # viser takes the colours of lines for linear ones
        handle.colors = np.repeat(linear.astype(np.uint8)[:, None], 2, axis=1)
        handle.points = np.concatenate(segments)
    return handle


def _segments(stroke: drawing.Path | drawing.Circle) -> Float64[Array, "n 2 xyz=3"]:
    points_m = stroke.points_m if isinstance(stroke, drawing.Path) else _polygon(stroke)
    return np.stack([points_m[:-1], points_m[1:]], axis=1)


def _polygon(circle: drawing.Circle) -> Float64[Array, "n xyz=3"]:
    angle = np.linspace(0.0, 2 * np.pi, drawing.SIDES + 1)
    offset_m = np.stack([np.cos(angle), np.sin(angle)], axis=1) @ circle.axes_m
    return np.asarray(circle.center_m + offset_m)


def _surface(scene: viser.SceneApi, name: str, handle: Any, surface: drawing.Surface) -> Any:
    if handle is None:
        triangles, look = surface.triangles, {"side": "double", **CHEAP}
        if surface.opacity < 1:  # side="double" would draw a transparent mesh twice
            triangles = np.concatenate([triangles, triangles[:, ::-1]])
            look = {"opacity": surface.opacity, **CHEAP}
        handle = scene.add_mesh_simple(name, surface.vertices_m, triangles, color=surface.color, **look)
    handle.vertices, handle.visible = surface.vertices_m, True
    return handle


def _ellipsoid(scene: viser.SceneApi, name: str, handle: Any, ellipsoid: drawing.Ellipsoid) -> Any:
    if handle is None:
        handle = scene.add_icosphere(name, 1.0, ellipsoid.color, **CHEAP)
    lengths_m = np.linalg.norm(ellipsoid.half_axes_m, axis=1)
    axes = (ellipsoid.half_axes_m / lengths_m[:, None]).T
    handle.scale = tuple(lengths_m.tolist())
    handle.wxyz = viser.transforms.SO3.from_matrix(axes * np.sign(np.linalg.det(axes))).wxyz
    handle.position, handle.opacity, handle.visible = ellipsoid.center_m, ellipsoid.opacity, True
    return handle


def _ball(scene: viser.SceneApi, name: str, handle: Any, ball: drawing.Ball) -> Any:
    if handle is None:
        handle = scene.add_icosphere(name, 1.0, ball.color, subdivisions=BALL_SUBDIVISIONS, **CHEAP)
    handle.radius, handle.color = ball.radius_m, ball.color
    handle.position, handle.visible = ball.center_m, True
    return handle


def _arrow(scene: viser.SceneApi, name: str, handle: Any, arrow: drawing.Arrow) -> Any:
    if handle is None:
        handle = scene.add_arrows(name, arrow.ends_m[None], arrow.color, **ARROW)
    handle.points, handle.visible = arrow.ends_m[None], True
    return handle


def _label(scene: viser.SceneApi, name: str, handle: Any, label: drawing.Label) -> Any:
    if handle is None:
        handle = scene.add_label(name, label.text)
    handle.position, handle.visible = label.position_m, True
    return handle


def _frustum(scene: viser.SceneApi, name: str, handle: Any, frustum: drawing.Frustum) -> Any:
    width, height = (frustum.corners_m[2] - frustum.corners_m[0])[:2].tolist()
    angle_rad, aspect = 2 * math.atan(height / 2), width / height
    if handle is None:
        handle = scene.add_camera_frustum(name, angle_rad, aspect, **FRUSTUM)
    handle.fov, handle.aspect, handle.visible = angle_rad, aspect, True
    return handle


def _points(scene: viser.SceneApi, name: str, handle: Any, points: drawing.Points) -> Any:
    if handle is None:
        handle = scene.add_point_cloud(name, points.points_m, points.color, point_size=POINT_M)
    else:
        handle.points = points.points_m
    handle.visible = bool(len(points.points_m))
    return handle


_DRAWN_BY: Mapping[type, Callable[..., Any]] = {
    drawing.Lines: _lines,
    drawing.Surface: _surface,
    drawing.Ellipsoid: _ellipsoid,
    drawing.Ball: _ball,
    drawing.Arrow: _arrow,
    drawing.Label: _label,
    drawing.Frustum: _frustum,
    drawing.Points: _points,
}
