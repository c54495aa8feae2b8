"""The page of the console, by viser: controls, the scene in three dimensions, the live image, plots and text.

The controls belong to all browsers together, which therefore show the same state, also after a reload.
"""

import io
import threading
from collections import deque
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import replace
from typing import Any

import numpy as np
import viser
import viser.transforms
from viser import uplot

from ringpose.console.engine import ConsolePicture, Engine
from ringpose.console.state import ConsoleState, Trajectory, first_state
from ringpose.errors import DataError, RingposeError
from ringpose.pose.record import remarks_on
from ringpose.report.overlay import color_of, pose_texts
from ringpose.simulate.pipeline import illuminated_ring
from ringpose.simulate.placement import Placement, ring_views
from ringpose.types.arrays import Array, Float64
from ringpose.types.scene import RingView, Scene

PERIOD_S = 0.1
"""Time between two states while the motion plays."""

SHOWN_MEASUREMENTS = 300
"""Measurements in the plots."""

PLOTS = (
    ("error of the centre (mm)", "center_m", "covariance_center_m2", 1e3),
    ("error of the grasp point (mm)", "grasp_m", "covariance_grasp_m2", 1e3),
)

RING_POINTS = 90
"""Vertices of a circle in the scene."""


class ConsolePage:
    """The page, within its context.

    `record` is called with each measured picture while recording is switched on, and `save` with the state when its
    button is pressed; what it returns is shown. `load` makes a trajectory of the contents and the name of a file.
    """

    def __init__(
        self,
        scene: Scene,
        host: str,
        port: int,
        width: int,
        record: Callable[[ConsolePicture], None] | None = None,
        save: Callable[[ConsoleState], str] | None = None,
        load: Callable[[bytes, str], Trajectory] | None = None,
    ) -> None:
        self._scene = scene
        self._views = tuple(view for view in ring_views(scene) if view.target == "ring")
        if not self._views:
            raise DataError("the scene", "has no view of a ring", "add one to its trajectory")
        self._state = first_state(scene, self._views[0])
        self._record, self._save, self._load = record, save, load
        self._lock = threading.RLock()
        self._ended = threading.Event()
        self._history: deque[tuple[float, ...]] = deque(maxlen=SHOWN_MEASUREMENTS)
        self._measured = 0
        with redirect_stdout(io.StringIO()):  # viser announces its address; stdout is for records
            self._server = viser.ViserServer(host=host, port=port, label="ringpose", verbose=False)
        self._engine = Engine(scene, width, self._show)
        self._engine.is_watched = lambda: bool(self._server.get_clients())

    def __enter__(self) -> "ConsolePage":
        server = self._server
        server.gui.configure_theme(
            show_share_button=False, show_logo=False, control_layout="fixed", control_width="large"
        )
        center = self._state.center_m
        server.scene.set_up_direction("-y")
        server.initial_camera.position = tuple(np.array([-1.9, -1.1, -1.4]) * max(np.linalg.norm(center), 0.5))
        server.initial_camera.look_at = tuple(0.7 * center)
        self._add_scene()
        self._add_gui()
        self._engine.__enter__()
        self._change()
        self._player = threading.Thread(target=self._play, name="console player", daemon=True)
        self._player.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._player.join()
        self._engine.__exit__()
        self._server.stop()

    @property
    def port(self) -> int:
        """The port of the page."""
        return int(self._server.get_port())

    def serve(self) -> None:
        """Serve until the engine fails."""
        self._engine.wait_for_failure()
        if self._engine.failure is not None:
            raise self._engine.failure

    # Controls

    def _add_gui(self) -> None:
        gui = self._server.gui
        blank = np.zeros((120, 160, 3), np.uint8)
        self._image = gui.add_image(blank, label="measurement camera", format="jpeg", jpeg_quality=85)
        self._text = gui.add_markdown("waiting for the first picture")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Controls"):
            self._add_controls()
        with tabs.add_tab("Errors"):
            self._add_plots()
        self._preset.on_update(lambda _: self._apply_preset())
        self._step.on_click(lambda _: self._advance(PERIOD_S))
        handles: list[Any] = [
            *self._center, *self._angles, self._spin, self._tumble, *self._drift, self._time, self._focal, self._auto,
            self._exposure, *self._on, self._switched, *self._tilts, self._ambient, self._sun,
        ]  # fmt: skip
        for handle in handles:
            handle.on_update(lambda _: self._change())

    def _add_controls(self) -> None:
        gui, state = self._server.gui, self._state
        with gui.add_folder("Target"):
            names = [view.name for view in self._views]
            self._preset = gui.add_dropdown("view of the scene", names, initial_value=names[0])
            self._center: list[Any] = [
                gui.add_slider(f"centre {name} (m)", *limits, 0.001, round(float(value), 3))
                for name, value, limits in zip(
                    "xyz", state.center_m, ((-1.5, 1.5), (-1.5, 1.5), (0.2, 3.0)), strict=True
                )
            ]
            self._angles: list[Any] = [
                gui.add_slider(f"{name} (deg)", -60.0, 60.0, 0.1, round(float(np.degrees(value)), 1))
                for name, value in (("pitch", state.pitch_rad), ("yaw", state.yaw_rad), ("roll", state.roll_rad))
            ]
        with gui.add_folder("Motion"):
            self._spin = gui.add_slider("spin (deg/s)", -10.0, 10.0, 0.1, 0.0)
            self._tumble = gui.add_slider("tumble (deg/s)", -10.0, 10.0, 0.1, 0.0)
            self._drift = [gui.add_slider(f"drift {name} (mm/s)", -50.0, 50.0, 1.0, 0.0) for name in "xyz"]
            self._playing = gui.add_checkbox("play", False)
            self._speed = gui.add_dropdown("speed", ["0.25", "0.5", "1", "2", "4"], initial_value="1")
            self._time: Any = gui.add_slider("time (s)", 0.0, 60.0, PERIOD_S, 0.0)
            self._step = gui.add_button("step")
            if self._load is not None:
                self._loading: Any = gui.add_upload_button("load trajectory", mime_type="application/json,.jsonl")
                self._loading.on_upload(lambda _: self._load_trajectory())
                self._loaded = gui.add_markdown("")
                gui.add_button("leave trajectory").on_click(lambda _: self._follow(None, ""))
        with gui.add_folder("Camera"):
            self._focal = gui.add_slider("focal length (%)", 50.0, 200.0, 1.0, 100.0)
            self._auto = gui.add_checkbox("exposure by the scene", True)
            self._exposure = gui.add_slider("exposure (ms)", 0.05, 50.0, 0.05, 5.0)
        with gui.add_folder("Lasers and light"):
            lasers = self._scene.rig.lasers.names
            self._on = [gui.add_checkbox(f"laser {name}", True) for name in lasers]
            self._switched = gui.add_checkbox("one after the other", True)
            self._tilts = [gui.add_slider(f"tilt of {name} (deg)", -10.0, 10.0, 0.1, 0.0) for name in lasers]
            self._ambient: Any = gui.add_slider("ambient light (W/m2)", 0.0, 50.0, 0.1, state.light.ambient_w_m2)
            self._sun: Any = gui.add_slider("sun (W/m2)", 0.0, 100.0, 0.5, state.light.sun_w_m2)
        if self._record is not None:
            self._recording = gui.add_checkbox("record shots with their truth", False)
        if self._save is not None:
            self._saving = gui.add_button("save scene and rig")
            self._saving.on_click(lambda _: self._save_state())

    def _add_plots(self) -> None:
        """Errors of the running measurement."""
        gui = self._server.gui
        self._plots = [
            gui.add_uplot(
                (np.zeros(1), np.zeros(1), np.zeros(1)),
                (
                    uplot.Series(label="number"),
                    uplot.Series(label="error", stroke="#1f5fbf"),
                    uplot.Series(label="sigma", stroke="#c0392b"),
                ),
                title=title,
                scales={"x": uplot.Scale(time=False)},
                aspect=2.2,
            )
            for title, *_ in PLOTS
        ]

    def _change(self) -> None:
        """Take over the positions of all controls."""
        with self._lock:
            pitch, yaw, roll = (float(np.radians(handle.value)) for handle in self._angles)
            self._state = replace(
                self._state,
                center_m=np.array([handle.value for handle in self._center], dtype=np.float64),
                pitch_rad=pitch,
                yaw_rad=yaw,
                roll_rad=roll,
                spin_rad_s=float(np.radians(self._spin.value)),
                tumble_rad_s=float(np.radians(self._tumble.value)),
                drift_m_s=1e-3 * np.array([handle.value for handle in self._drift], dtype=np.float64),
                time_s=float(self._time.value),
                focal_scale=self._focal.value / 100,
                exposure_s=None if self._auto.value else 1e-3 * self._exposure.value,
                laser_tilt_rad=tuple(float(np.radians(handle.value)) for handle in self._tilts),
                mask=sum(1 << laser for laser, handle in enumerate(self._on) if handle.value),
                is_switched=self._switched.value,
                light=replace(
                    self._state.light, ambient_w_m2=float(self._ambient.value), sun_w_m2=float(self._sun.value)
                ),
                number=self._state.number + 1,
            )
            self._engine.show(self._state)
            if not self._playing.value:  # while time runs, the target moves with the pictures
                self._place_target(self._state)

    def _apply_preset(self) -> None:
        view: RingView = next(each for each in self._views if each.name == self._preset.value)
        state = first_state(self._scene, view)
        for handle, value in zip(self._center, state.center_m.tolist(), strict=True):
            handle.value = round(value, 4)
        for handle, value in zip(self._angles, (state.pitch_rad, state.yaw_rad, state.roll_rad), strict=True):
            handle.value = round(float(np.degrees(value)), 3)
        self._ambient.value, self._sun.value, self._time.value = state.light.ambient_w_m2, state.light.sun_w_m2, 0.0
        with self._lock:
            self._state = replace(self._state, light=state.light)
        self._change()

    def _load_trajectory(self) -> None:
        if self._load is None:
            return
        uploaded = self._loading.value
        try:
            trajectory = self._load(uploaded.content, uploaded.name)
        except RingposeError as problem:
            self._loaded.content = f"not loaded: {problem}"
            return
        self._follow(trajectory, f"{uploaded.name}: {len(trajectory.time_s)} poses, {trajectory.time_s[-1]:.1f} s")

    def _follow(self, trajectory: Trajectory | None, text: str) -> None:
        """Show the poses of a trajectory from its beginning; None for those that the controls set."""
        with self._lock:
            self._state = replace(self._state, trajectory=trajectory)
        self._loaded.content = text
        self._time.value = 0.0
        self._change()

    def _save_state(self) -> None:
        if self._save is None:
            return
        try:
            self._saving.label = f"save scene and rig (saved as {self._save(self._state)})"
        except RingposeError as problem:
            self._saving.label = f"save scene and rig (not saved: {problem})"

    def _play(self) -> None:
        while not self._ended.wait(PERIOD_S):
            if self._playing.value and self._server.get_clients():
                self._advance(PERIOD_S * float(self._speed.value))

    def _advance(self, step_s: float) -> None:
        self._time.value = float((self._time.value + step_s) % 60.0)  # calls _change

    # The scene

    def _add_scene(self) -> None:
        scene, server = self._scene, self._server.scene
        camera = scene.rig.camera
        fov = 2 * np.arctan(camera.image_height / 2 / camera.camera_matrix[1, 1])
        aspect = camera.image_width / camera.image_height
        self._frustum = server.add_camera_frustum(
            "/camera", float(fov), aspect, scale=0.07, color=(40, 40, 40), thickness=2.0, thickness_units="screen"
        )
        self._target = server.add_frame("/target", show_axes=False)
        if (body := scene.body) is not None:
            width, height, depth = (float(size) for size in body.size_m)
            middle = (float(body.offset_m[0]), float(body.offset_m[1]), -depth / 2)
            server.add_box("/target/body", (170, 150, 110), (width, height, depth), position=middle, opacity=0.6)
        vertices, faces = _surface(scene.ring.profile_m)
        server.add_mesh_simple("/target/ring", vertices, faces, color=(150, 155, 165), side="double", flat_shading=True)

    def _place_target(self, state: ConsoleState) -> None:
        """Move the target, the light planes and the sun to where they are in this state."""
        scene = state.scene_of(self._scene)
        placement = illuminated_ring(scene, state.view).placement
        server, rig = self._server.scene, scene.rig
        with self._server.atomic():
            self._target.wxyz = viser.transforms.SO3.from_matrix(placement.rotation).wxyz
            self._target.position = placement.translation_m
            depth_m = float(np.linalg.norm(state.view.center_m)) * 1.1
            for laser, name in enumerate(rig.lasers.names):
                corners = _light_plane(rig, laser, depth_m)
                server.add_mesh_simple(
                    f"/light/{name}", corners, np.array([[0, 1, 2]]), color=color_of(laser)[::-1],
                    opacity=0.35, side="double", visible=bool(state.mask >> laser & 1),
                )  # fmt: skip
            sun = state.view.center_m + 0.8 * state.light.sun_direction
            arrow = np.array([[sun, sun - 0.4 * state.light.sun_direction]])
            server.add_arrows("/sun", arrow, (240, 180, 40), visible=state.light.sun_w_m2 > 0)
            self._draw_stripes(state, placement)

    def _draw_stripes(self, state: ConsoleState, placement: Placement) -> None:
        """Where the light planes meet the ring's face."""
        from ringpose.geometry.ring import predicted_break_points, ring_arcs

        scene = state.scene_of(self._scene)
        radii = np.array([scene.ring.radius_inner_m, scene.ring.radius_outer_m])
        view = state.view
        near = np.array([0.0, 0.0, float(view.center_m[2])])
        points = predicted_break_points(
            ring_arcs(view.center_m, view.normal, radii, near), scene.rig.lasers.normal, scene.rig.lasers.distance_m
        )
        seen = np.isfinite(points).all(axis=(1, 2)) & np.array([state.mask >> k & 1 == 1 for k in range(len(points))])
        segments = points[seen] if seen.any() else np.zeros((1, 2, 3))
        drawn = [color_of(int(laser))[::-1] for laser in np.flatnonzero(seen)] or [(0, 0, 0)]
        colors = np.repeat(np.array(drawn, dtype=np.uint8)[:, None], 2, axis=1)
        self._server.scene.add_line_segments(
            "/stripes", segments, colors, thickness=5.0, thickness_units="screen", visible=bool(seen.any())
        )

    # Pictures

    def _show(self, picture: ConsolePicture) -> None:
        """Show a picture; called by the engine."""
        image = picture.image[:, :, ::-1]
        self._image.image = image
        self._frustum.image = image[:: max(1, len(image) // 120), :: max(1, len(image) // 120)]
        if picture.line is None:
            return
        self._measured += 1
        if self._playing.value:
            self._place_target(picture.state)
        self._draw_estimate(picture)
        self._text.content = _text(picture)
        self._plot(picture)
        if self._record is not None and self._recording.value:
            self._record(picture)

    def _draw_estimate(self, picture: ConsolePicture) -> None:
        pose = None if picture.line is None else picture.line.pose
        server = self._server.scene
        radii = [] if pose is None else [r for r in (pose.radius_inner_m, pose.radius_outer_m) if np.isfinite(r)]
        if pose is None or not radii or not np.isfinite([*pose.center_m, *pose.normal]).all():
            server.add_line_segments("/estimate/ring", np.zeros((1, 2, 3)), (0, 0, 0), visible=False)
            return
        segments = np.concatenate([_circle(pose.center_m, pose.normal, radius) for radius in radii])
        server.add_line_segments("/estimate/ring", segments, (31, 95, 191), thickness=2.0, thickness_units="screen")
        if pose.covariance_center_m2 is not None and np.isfinite(pose.covariance_center_m2).all():
            variance, axes = np.linalg.eigh(pose.covariance_center_m2)
            axes = axes * np.sign(np.linalg.det(axes))
            first, second, third = (3 * np.sqrt(np.maximum(variance, 1e-12))).tolist()
            rotation = viser.transforms.SO3.from_matrix(axes).wxyz
            server.add_icosphere(
                "/estimate/center",
                1.0,
                (176, 48, 144),
                scale=(first, second, third),
                wxyz=rotation,
                position=pose.center_m,
            )

    def _plot(self, picture: ConsolePicture) -> None:
        """Append a measurement to the plots."""
        pose = None if picture.line is None else picture.line.pose
        values = [float(self._measured)]
        for _, name, covariance_name, factor in PLOTS:
            covariance = None if pose is None else getattr(pose, covariance_name)
            sigma = np.nan if covariance is None else float(np.sqrt(np.trace(covariance)))
            values += [factor * (picture.errors or {}).get(name, np.nan), factor * sigma]
        self._history.append(tuple(values))
        table = np.array(self._history)
        for plot, column in zip(self._plots, range(1, table.shape[1], 2), strict=True):
            plot.data = (table[:, 0], table[:, column], table[:, column + 1])


def _text(picture: ConsolePicture) -> str:
    """Status, flags, reason, pose and errors of the measurement; the number of the state that the picture shows."""
    line = picture.line
    if line is None:
        return ""
    rows = [f"**{line.status}** (state {picture.state.number}, {picture.state.time_s:.1f} s)", remarks_on(line)]
    if line.pose is not None:
        rows += [text.replace("+-", "±") for text in pose_texts(line.pose)]
    errors = picture.errors or {}
    shown = [
        f"{name} {1e3 * errors[key]:.3f} mm"
        for name, key in (("centre", "center_m"), ("grasp", "grasp_m"))
        if key in errors
    ]
    if "normal_rad" in errors:
        shown.append(f"normal {np.degrees(errors['normal_rad']):.3f} deg")
    return "  \n".join([*rows, f"errors: {', '.join(shown)}" if shown else "no errors: nothing to compare"])


def _circle(center_m: Float64[Array, "3"], normal: Float64[Array, "3"], radius_m: float) -> Float64[Array, "n 2 3"]:
    from ringpose.geometry.rotations import tilt_basis

    angle = np.linspace(0.0, 2 * np.pi, RING_POINTS + 1)
    first, second = tilt_basis(normal)
    points = center_m + radius_m * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second)
    segments: Float64[Array, "n 2 3"] = np.stack([points[:-1], points[1:]], axis=1)
    return segments


def _surface(profile_m: Float64[Array, "point 2"]) -> tuple[Any, Any]:
    """Vertices and triangles of a surface of revolution."""
    angle = np.linspace(0.0, 2 * np.pi, RING_POINTS, endpoint=False)
    radius, height = profile_m.T
    vertices = np.stack(
        [
            np.outer(np.cos(angle), radius),
            np.outer(np.sin(angle), radius),
            np.broadcast_to(height, (len(angle), len(height))),
        ],
        axis=-1,
    )
    index = np.arange(vertices.shape[0] * vertices.shape[1]).reshape(vertices.shape[:2])
    here, onward = index, np.roll(index, -1, axis=0)
    quads = [(here[:, :-1], here[:, 1:], onward[:, 1:]), (here[:, :-1], onward[:, 1:], onward[:, :-1])]
    faces = np.concatenate([np.stack([each.ravel() for each in triangle], axis=-1) for triangle in quads])
    return vertices.reshape(-1, 3), faces


def _light_plane(rig: Any, laser: int, depth_m: float) -> Float64[Array, "3 3"]:
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
