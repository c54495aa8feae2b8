"""The page of the console, by viser: controls, the scene in three dimensions, pictures, text and plots.

The controls belong to all browsers together, which therefore show the same state, also after a reload.
"""

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import viser.transforms

from ringpose.console.display import (
    CHEAP,
    ImagePanel,
    Plots,
    SceneView,
    line_text,
    opened_server,
    plotted,
    target_surfaces,
    track_text,
)
from ringpose.console.engine import ConsolePicture, Engine, Stage
from ringpose.console.playback import IN_STEP, SPEEDS, STEP_S, Playback
from ringpose.console.state import ConsoleState, Trajectory, first_state
from ringpose.errors import DataError, RingposeError
from ringpose.geometry.ring import predicted_break_points, ring_arcs
from ringpose.simulate.placement import ring_views, target_placement
from ringpose.types.rig import Rig
from ringpose.types.scene import Earth, RingView, Scene
from ringpose.types.session import parsed_sequence, steps_of, written_sequence
from ringpose.types.target import MOTION_PRESETS

PERIOD_S = 0.07
"""Time between two states while the motion plays."""

ORBIT_PERIOD_S = 0.4
"""Least time between two updates of the orbit view; viser draws it anew for 0.25 s after each."""

END_S = 60.0
"""End of the motion that the controls set; it then starts again."""

SLIDER_PERIOD_S = 1.0
"""Time between two moves of the time slider while the motion plays; the label of the picture has the exact time."""

PANEL_FIRST_S = 0.05
"""Time in which an update of the panel leaves before that of the orbit view, with which the browser would draw it."""

SHOWN_MEASUREMENTS = 300
"""Measurements in the plots."""

EARTH_MARGIN_M = 0.5
"""Gap between the target and the Earth, which is drawn beyond all parts, as large as it appears from the ring."""

EARTH = Earth(direction=np.array([0.9, -0.2, 0.15]))
"""The Earth of scenes without one: beside the target, and in the first view of the page."""


class ConsolePage:
    """Serves the page of the console within its context.

    `record` is called with each measurement while recording is switched on, and `save` with the state when its button
    is pressed; the text that it returns is shown. `load` reads a trajectory, `load_rig` a rig, from the content of a
    file that is uploaded and its name.
    """

    def __init__(
        self,
        scene: Scene,
        host: str,
        port: int,
        width: int,
        load: Callable[[bytes, str], Trajectory],
        load_rig: Callable[[bytes, str], Rig],
        record: Callable[[ConsolePicture], None] | None = None,
        save: Callable[[ConsoleState], str] | None = None,
    ) -> None:
        self._scene, self._width = scene, width
        self._views = tuple(view for view in ring_views(scene) if view.target == "ring" and not view.begin_s)
        if not self._views:
            raise DataError("the scene", "has no view of a ring", "add one to its trajectory")
        self._state = replace(first_state(scene, self._views[0]), width=width)
        self._record, self._save, self._load, self._load_rig = record, save, load, load_rig
        self._lock = threading.RLock()
        self._ended = threading.Event()
        self._rows: deque[tuple[float, ...]] = deque(maxlen=SHOWN_MEASUREMENTS)
        self._measured = 0
        self._drawn_since = self._sought = -1
        self._playback = Playback()
        self._measurement: ConsolePicture | None = None
        self._measured_s = self._slider_moved_s = 0.0
        self._server = opened_server(host, port)
        self._engine = Engine(scene, self._show, self._record_shot, lambda: bool(self._server.get_clients()))
        self._orbit = Stage[tuple[ConsolePicture, bytes]]("orbit view", self._draw_orbit_view, self._engine.fail)

    def __enter__(self) -> "ConsolePage":
        self._view3d = SceneView(self._server, self._scene.rig, self._state.center_m)
        self._add_target()
        self._add_sky()
        self._add_gui()
        self._orbit.start()
        self._engine.__enter__()
        self._change()
        self._player = threading.Thread(target=self._play, name="console player", daemon=True)
        self._player.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._player.join()
        self._engine.__exit__()
        self._orbit.end()
        self._server.stop()

    @property
    def port(self) -> int:
        """The port of the page."""
        return int(self._server.get_port())

    def serve(self) -> None:
        """Serve until a thread fails."""
        self._engine.wait_for_failure()
        if self._engine.failure is not None:
            raise self._engine.failure

    # Controls

    def _add_gui(self) -> None:
        gui = self._server.gui
        self._live = ImagePanel(self._server, "camera")
        self._text = gui.add_markdown("waiting for the first measurement")
        self._playing = gui.add_checkbox("play", False)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Target"):
            self._add_target_controls()
        with tabs.add_tab("Rig and light"):
            self._add_rig_controls()
            self._add_light_controls()
        with tabs.add_tab("Measured"):
            self._result = ImagePanel(self._server, "newest measurement")
            self._details = gui.add_markdown("")
        with tabs.add_tab("Errors"):
            self._plots = Plots(self._server, "number")
        self._preset.on_update(lambda _: self._apply_preset())
        self._motion.on_update(lambda _: self._apply_motion())
        self._step.on_click(lambda _: self._advance(STEP_S))
        for handle in (
            *self._center, *self._angles, self._spin, self._tumble, *self._drift, self._focal, self._pitch, self._size,
            self._auto, self._exposure, *self._on, self._sequence, *self._tilts, *self._shifts, self._ambient,
            self._sun, *self._sun_angles, self._earth,
        ):  # fmt: skip
            handle.on_update(lambda event: None if event.client is None else self._change())
        self._time.on_update(lambda event: None if event.client is None else self._seek(self._time.value))

    def _add_target_controls(self) -> None:
        gui, state = self._server.gui, self._state
        limits = ((-1.5, 1.5), (-1.5, 1.5), (0.2, 3.0))
        with gui.add_folder("Pose at time 0"):
            names = [view.name for view in self._views]
            self._preset = gui.add_dropdown("view of the scene", names, initial_value=names[0])
            self._center: list[Any] = [
                gui.add_slider(f"centre {name} (m)", *limit, 0.001, round(float(value), 3))
                for name, value, limit in zip("xyz", state.center_m, limits, strict=True)
            ]
            self._angles: list[Any] = [
                gui.add_slider(f"{name} (deg)", -60.0, 60.0, 0.1, round(float(np.degrees(value)), 1))
                for name, value in (("pitch", state.pitch_rad), ("yaw", state.yaw_rad), ("roll", state.roll_rad))
            ]
        with gui.add_folder("Motion"):
            self._motion = gui.add_dropdown("motion", ["still", *MOTION_PRESETS], initial_value="still")
            self._spin: Any = gui.add_slider("spin (deg/s)", -10.0, 10.0, 0.01, 0.0)
            self._tumble: Any = gui.add_slider("tumble (deg/s)", -10.0, 10.0, 0.01, 0.0)
            self._drift: list[Any] = [gui.add_slider(f"drift {name} (mm/s)", -50.0, 50.0, 1.0, 0.0) for name in "xyz"]
            self._speed: Any = gui.add_dropdown("speed", [*SPEEDS, IN_STEP], initial_value="1")
            self._time: Any = gui.add_slider("time (s)", 0.0, END_S, 0.01, 0.0)
            self._step = gui.add_button(f"step {STEP_S:g} s")
            loading: Any = gui.add_upload_button("load trajectory", mime_type="application/json,.jsonl")
            loading.on_upload(lambda _: self._load_trajectory(loading.value))
            self._loaded = gui.add_markdown("")
            gui.add_button("leave trajectory").on_click(lambda _: self._follow(None, ""))
        if self._record is not None:
            self._recording = gui.add_checkbox("record shots with their truth", False)
            self._recorded = gui.add_markdown("")
        if self._save is not None:
            self._saving = gui.add_button("save scene and rig")
            self._saving.on_click(lambda _: self._save_state())

    def _add_rig_controls(self) -> None:
        gui, lasers = self._server.gui, self._scene.rig.lasers.names
        largest = max(self._width, self._scene.rig.camera.image_width)
        widths = sorted({width for width in (320, 480, 640, 800, 1200, self._width) if width <= largest})
        with gui.add_folder("Camera"):
            self._focal = gui.add_slider("focal length (%)", 50.0, 200.0, 1.0, 100.0)
            self._size = gui.add_dropdown(
                "image width (px)", [f"{each}" for each in widths], initial_value=f"{self._width}"
            )
            self._pitch = gui.add_slider("pixel pitch (%)", 50.0, 200.0, 1.0, 100.0)
            self._auto = gui.add_checkbox("exposure by the scene", True)
            self._exposure = gui.add_slider("exposure (ms)", 0.05, 50.0, 0.05, 5.0)
            picking: Any = gui.add_upload_button("rig file", mime_type=".yaml,.yml")
            picking.on_upload(lambda _: self._pick_rig(picking.value))
            self._picked = gui.add_markdown("")
        with gui.add_folder("Lasers"):
            self._on = [gui.add_checkbox(f"laser {name}", True) for name in lasers]
            steps = written_sequence(steps_of(self._state.masks, len(lasers)))
            self._sequence: Any = gui.add_text("sequence", steps)
            self._wrong_sequence = gui.add_markdown("")
            self._tilts: list[Any] = [gui.add_slider(f"tilt of {name} (deg)", -10.0, 10.0, 0.1, 0.0) for name in lasers]
            self._shifts: list[Any] = [
                gui.add_slider(f"{name} along y (mm)", -100.0, 100.0, 1.0, 0.0) for name in lasers
            ]

    def _add_light_controls(self) -> None:
        gui, light = self._server.gui, self._state.light
        with gui.add_folder("Light"):
            self._ambient: Any = gui.add_slider("ambient light (W/m2)", 0.0, 50.0, 0.1, light.ambient_w_m2)
            self._sun: Any = gui.add_slider("sun (W/m2)", 0.0, 1400.0, 0.5, light.sun_w_m2)
            self._sun_angles: list[Any] = [
                gui.add_slider(f"sun {name} (deg)", -limit, limit, 0.5, round(value, 1))
                for name, limit, value in zip(
                    ("azimuth", "elevation"), (180.0, 90.0), _angles_deg(light.sun_direction), strict=True
                )
            ]
            self._earth: Any = gui.add_checkbox("Earth", light.earth is not None)

    def _change(self, time_s: float | None = None, *, is_time_only: bool = False, measure_now: bool = False) -> None:
        """Take over the positions of all controls, at the given time or at the time of the last state."""
        with self._lock:
            number, pitch, yaw, roll = self._state.number + 1, *(np.radians(each.value) for each in self._angles)
            azimuth, elevation = (np.radians(handle.value) for handle in self._sun_angles)
            level = np.cos(elevation)
            direction = np.array([np.sin(azimuth) * level, -np.sin(elevation), np.cos(azimuth) * level])
            earth = (self._state.light.earth or EARTH) if self._earth.value else None
            light = replace(self._state.light, ambient_w_m2=float(self._ambient.value), earth=earth)
            self._state = replace(
                self._state,
                center_m=np.array([handle.value for handle in self._center], dtype=np.float64),
                pitch_rad=float(pitch),
                yaw_rad=float(yaw),
                roll_rad=float(roll),
                spin_rad_s=float(np.radians(self._spin.value)),
                tumble_rad_s=float(np.radians(self._tumble.value)),
                drift_m_s=1e-3 * np.array([handle.value for handle in self._drift], dtype=np.float64),
                time_s=self._state.time_s if time_s is None else time_s,
                rig_change=replace(
                    self._state.rig_change,
                    focal_scale=self._focal.value / 100,
                    pitch_scale=self._pitch.value / 100,
                    laser_tilt_rad=tuple(float(np.radians(handle.value)) for handle in self._tilts),
                    laser_shift_m=tuple(1e-3 * float(handle.value) for handle in self._shifts),
                ),
                width=int(self._size.value),
                exposure_s=None if self._auto.value else 1e-3 * self._exposure.value,
                mask=sum(1 << laser for laser, handle in enumerate(self._on) if handle.value),
                masks=self._masks(),
                light=replace(light, sun_w_m2=float(self._sun.value), sun_direction=direction),
                number=number,
                since=self._state.since if is_time_only else number,
            )
            self._engine.show(self._state, measure_now=measure_now)

    def _masks(self) -> tuple[int, ...]:
        """The laser masks of the sequence in the text field; those of the last state if the text is invalid."""
        try:
            lasers = len(self._scene.rig.lasers.names)
            masks = tuple(step.mask(lasers) for step in parsed_sequence(self._sequence.value))
        except RingposeError as problem:
            self._wrong_sequence.content = f"not a sequence: {problem}"
            return self._state.masks
        self._wrong_sequence.content = ""
        return masks

    def _apply_preset(self) -> None:
        view: RingView = next(each for each in self._views if each.name == self._preset.value)
        state = first_state(self._scene, view)
        with self._lock:
            self._state = replace(self._state, light=state.light)
            angles = (state.pitch_rad, state.yaw_rad, state.roll_rad)
            values = [*state.center_m.round(4), *np.degrees(angles).round(3), *_angles_deg(state.light.sun_direction)]
            for handle, value in zip((*self._center, *self._angles, *self._sun_angles), values, strict=True):
                handle.value = float(value)
            self._ambient.value, self._sun.value = state.light.ambient_w_m2, state.light.sun_w_m2
            self._earth.value = state.light.earth is not None
        self._change(0.0)

    def _apply_motion(self) -> None:
        """Set the controls of spin and tumble to those of the motion that is chosen by name."""
        preset = MOTION_PRESETS.get(self._motion.value)
        x, y, z = (0.0, 0.0, 0.0) if preset is None else np.degrees(preset.angular_velocity_rad_s)
        self._spin.value, self._tumble.value = round(float(z), 2), round(float(np.hypot(x, y)), 2)
        if preset is None:
            for handle in self._drift:
                handle.value = 0.0
        self._change()

    def _load_trajectory(self, uploaded: Any) -> None:
        try:
            trajectory = self._load(uploaded.content, uploaded.name)
        except RingposeError as problem:
            self._loaded.content = f"not loaded: {problem}"
            return
        self._follow(trajectory, f"{uploaded.name}: {len(trajectory.time_s)} poses, {trajectory.time_s[-1]:.1f} s")

    def _follow(self, trajectory: Trajectory | None, text: str) -> None:
        """Show the poses of a trajectory from its beginning, or, for None, the pose that the controls set."""
        with self._lock:
            self._state = replace(self._state, trajectory=trajectory)
            self._time.max = END_S if trajectory is None else max(float(trajectory.time_s[-1]), 0.1)
        self._loaded.content = text
        self._change(0.0)

    def _pick_rig(self, uploaded: Any) -> None:
        """Take over camera and lasers of a rig file."""
        try:
            rig = self._load_rig(uploaded.content, uploaded.name)
            if rig.lasers.names != self._scene.rig.lasers.names:
                found = f"has the lasers {', '.join(rig.lasers.names)}"
                raise DataError(uploaded.name, found, "give a rig with the lasers of the scene")
        except RingposeError as problem:
            self._picked.content = f"not taken over: {problem}"
            return
        with self._lock:
            self._state = replace(self._state, rig_change=replace(self._state.rig_change, rig=rig))
        self._picked.content = f"{uploaded.name}: {rig.camera.camera_name}"
        self._change()

    def _save_state(self) -> None:
        assert self._save is not None
        try:
            self._saving.label = f"save scene and rig (saved as {self._save(self._state)})"
        except RingposeError as problem:
            self._saving.label = f"save scene and rig (not saved: {problem})"

    def _record_shot(self, picture: ConsolePicture) -> None:
        """Record a measurement if that is switched on; its rig must be that of the folder."""
        if self._record is None or not self._recording.value or picture.shot is None:
            return
        if not picture.state.rig_change.is_none or picture.state.width != self._width:
            self._recorded.content = "not recorded: camera or lasers differ from the recorded rig; save the scene"
            return
        self._record(picture)
        self._recorded.content = f"recorded {picture.shot.name}"

    def _play(self) -> None:
        while not self._ended.wait(PERIOD_S):
            is_played = self._playing.value and bool(self._server.get_clients())
            with self._lock:
                shown = self._measurement
                is_measured = shown is not None and shown.state.number == self._state.number
                speed = self._speed.value
                step_s = self._playback.step_s(time.monotonic(), speed if is_played else None, is_measured=is_measured)
                if step_s:
                    self._advance(step_s, measure_now=speed == IN_STEP)

    def _advance(self, step_s: float, *, measure_now: bool = False) -> None:
        """Advance the time by a step; the slider follows when the picture is shown."""
        with self._lock:
            time_s = float((self._state.time_s + step_s) % self._time.max)
            self._change(time_s, is_time_only=True, measure_now=measure_now)

    def _seek(self, time_s: float) -> None:
        """Show another time, which may not be typed completely yet."""
        with self._lock:
            self._playback.hold(time.monotonic())
            self._change(float(time_s), is_time_only=True)
            self._sought = self._state.number

    # The scene in three dimensions

    def _add_target(self) -> None:
        """The parts of the target, in its frame."""
        server = self._server.scene
        self._target = server.add_frame("/target", show_axes=False)
        for number, (color, (vertices, faces)) in enumerate(target_surfaces(self._scene).items()):
            server.add_mesh_simple(f"/target/{number}", vertices, faces, color=color, side="double", **CHEAP)

    def _place_target(self, picture: ConsolePicture) -> None:
        """Move target, light planes, sun and Earth to where they are in this state."""
        state, rig = picture.state, picture.rig
        view = state.view(self._scene)
        placement = target_placement(self._scene, view)
        self._target.wxyz = viser.transforms.SO3.from_matrix(placement.rotation).wxyz
        self._target.position = placement.translation_m
        if self._drawn_since != state.since:
            self._drawn_since = state.since
            self._view3d.show_rig(rig, state.mask, 1.1 * float(np.linalg.norm(view.center_m)))
            self._show_sky(state)
        radii_m = np.array([self._scene.ring.radius_inner_m, self._scene.ring.radius_outer_m])
        near = np.array([0.0, 0.0, float(view.center_m[2])])
        arcs = ring_arcs(view.center_m, view.normal, radii_m, near)
        points = predicted_break_points(arcs, rig.lasers.normal, rig.lasers.distance_m)
        self._view3d.show_stripes(points, state.mask)

    def _add_sky(self) -> None:
        server = self._server.scene
        self._sun_arrow = server.add_arrows(
            "/sun", np.zeros((1, 2, 3)), (240, 180, 40), shaft_radius=0.008, head_radius=0.02, head_length=0.05
        )
        self._sun_name = server.add_label("/sun/name", "sun")
        self._earth_ball = server.add_icosphere("/earth", 1.0, (70, 110, 180), subdivisions=4, **CHEAP)
        server.add_label("/earth/name", "Earth")  # its position is relative to the Earth

    def _show_sky(self, state: ConsoleState) -> None:
        """Draw an arrow from the sun, and the Earth in its direction from the ring, beyond all parts of the target."""
        light = state.light
        sun_m = state.center_m + 0.8 * light.sun_direction
        self._sun_arrow.points = np.array([[sun_m, sun_m - 0.4 * light.sun_direction]])
        self._sun_name.position = sun_m
        self._sun_arrow.visible = self._sun_name.visible = light.sun_w_m2 > 0
        earth = light.earth or EARTH
        distance_m, self._earth_ball.radius = drawn_earth_m(self._scene, earth)
        self._earth_ball.position = state.center_m + distance_m * earth.direction / np.linalg.norm(earth.direction)
        self._earth_ball.visible = light.earth is not None

    # Pictures

    def _show(self, picture: ConsolePicture, jpeg: bytes) -> None:
        """Show a preview, or a measurement; called by two threads of the engine.

        The panel is updated before the scene, and separately: the browser then draws it at once, not with the next
        frame of the scene.
        """
        with self._lock, self._server.atomic():
            state, shown = picture.state, self._measurement
            is_newest = state.number == self._state.number
            stamp = f"state {state.number}, {state.time_s:.2f} s"
            if picture.line is not None:
                self._measurement, self._measured_s = picture, time.monotonic()
                self._show_measurement(picture, jpeg, stamp)
            elif shown is not None:
                if state.number <= shown.state.number:
                    return  # its measurement is shown already
                stamp += f"; measured {time.monotonic() - self._measured_s:.1f} s ago"
            if picture.line is None or is_newest:
                self._live.show(jpeg, f"camera: {stamp}")
                if state.number > self._sought:  # else more may have been typed since
                    self._show_time(state.time_s)
        self._server.flush()
        if picture.line is None or is_newest:
            self._orbit.put((picture, jpeg))

    def _show_time(self, time_s: float) -> None:
        """Let the slider follow; while the motion plays not too often, as that replaces a digit that is being typed."""
        now_s = time.monotonic()
        if not self._playing.value or now_s > self._slider_moved_s + SLIDER_PERIOD_S:
            self._time.value, self._slider_moved_s = time_s, now_s

    def _draw_orbit_view(self, shown: tuple[ConsolePicture, bytes]) -> None:
        """Update the scene in three dimensions, at most once in a period."""
        picture, jpeg = shown
        self._ended.wait(PANEL_FIRST_S)
        with self._lock:
            measured = self._measurement
        with self._server.atomic():
            self._place_target(picture)
            self._view3d.show_image(jpeg)
            if measured is not None and measured.line is not None:
                track = measured.track
                self._view3d.show_rings(measured.line.pose, None, None if track is None else track.pose)
        self._ended.wait(ORBIT_PERIOD_S - PANEL_FIRST_S)

    def _show_measurement(self, picture: ConsolePicture, jpeg: bytes, stamp: str) -> None:
        line, errors, track = picture.line, picture.errors or {}, picture.track
        assert line is not None
        self._result.show(jpeg, f"newest measurement: {stamp}")
        self._text.content = line_text(line, stamp, errors)
        if track is not None:
            status = f"{track.validity}, {track.attempt.fusion_status}"
            text = track_text(track.pose, track.velocity, status, picture.track_error_m)
            self._details.content = f"{text}  \nrings: pose blue, track orange; the target shows the truth"
        self._measured += 1
        self._rows.append((float(self._measured), *plotted(line.pose, errors)))
        rows = list(self._rows)
        self._plots.show([row[0] for row in rows], [row[1:] for row in rows])


def drawn_earth_m(scene: Scene, earth: Earth) -> tuple[float, float]:
    """Distance (from the ring) and radius of a drawn Earth: as large as it appears from there, beyond all parts."""
    center_m = np.array([0.0, 0.0, scene.ring.height_m])
    vertices_m = np.concatenate([vertices_m for vertices_m, _ in target_surfaces(scene).values()])
    reach_m = float(np.linalg.norm(vertices_m - center_m, axis=1).max())
    sine = float(np.sin(earth.angular_radius_rad))
    distance_m = (reach_m + EARTH_MARGIN_M) / (1 - sine)
    return distance_m, distance_m * sine


def _angles_deg(direction: Any) -> tuple[float, float]:
    """Azimuth from the optical axis towards x, and elevation, of a direction in the camera frame."""
    x, y, z = direction / np.linalg.norm(direction)
    return float(np.degrees(np.arctan2(x, z))), float(np.degrees(np.arcsin(-y)))
