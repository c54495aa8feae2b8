"""The page of the console, by viser: controls, the scene in three dimensions, pictures, text and plots.

The controls belong to all browsers together, which therefore show the same state, also after a reload.
"""

import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ringpose.console import controls, display, drawing
from ringpose.console.engine import ConsolePicture, Engine, Stage
from ringpose.console.live_scene import LiveScene
from ringpose.console.playback import IN_STEP, STEP_S, Playback
from ringpose.console.server import opened_server
from ringpose.console.state import ConsoleState, Trajectory, first_state, trajectory_of_views
from ringpose.errors import DataError, RingposeError
from ringpose.simulate.placement import ring_views, target_placement
from ringpose.types.rig import Rig
from ringpose.types.scene import Scene

PERIOD_S = 0.07
"""Time between two states while the motion plays."""

ORBIT_PERIOD_S = 0.4
"""Least time between two updates of the orbit view; viser draws it anew for 0.25 s after each."""

SLIDER_PERIOD_S = 1.0
"""Time between two moves of the time slider while the motion plays; the label of the picture has the exact time."""

PANEL_FIRST_S = 0.05
"""Time in which an update of the panel leaves before that of the orbit view, with which the browser would draw it."""

SHOWN_MEASUREMENTS = 300
"""Measurements in the plots."""

TIME_LABEL = "time since the start (s)"
"""Of the plots of errors."""

VIEW_S = 2.0
"""Time from a view of a scene without motion to the next, when they are played."""

MIN_END_S = 0.1
"""End of a trajectory of one pose."""

AGE_PERIOD_S = 0.5
"""Time between two updates of the age of a measurement that is outdated."""


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
        port: int | None,
        width: int,
        load: Callable[[bytes, str], Trajectory],
        load_rig: Callable[[bytes, str], Rig],
        record: Callable[[ConsolePicture], None] | None = None,
        save: Callable[[ConsoleState], str] | None = None,
    ) -> None:
        self._scene, self._width = scene, width
        self._views = tuple(view for view in ring_views(scene).begins if view.target == "ring")
        if not self._views:
            raise DataError("the scene", "has no view of a ring", "add one to its trajectory")
        self._lasers = scene.rig.lasers.names
        self._controls = controls.console_controls(scene, self._views, width)
        self._values: dict[str, controls.Value] = {name: control.initial for name, control in self._controls.items()}
        self._fields: dict[str, display.Field] = {}
        self._state = controls.changed_state(first_state(scene, self._views[0]), self._values, self._lasers)
        self._reported: set[str] = set()
        self._record, self._save, self._load, self._load_rig = record, save, load, load_rig
        self._lock = threading.RLock()
        self._ended = threading.Event()
        self._rows: deque[tuple[float, ...]] = deque(maxlen=SHOWN_MEASUREMENTS)
        self._began_s = time.monotonic()
        self._drawn_since = self._sought = self._failed = -1
        self._playback = Playback()
        self._measurement: ConsolePicture | None = None
        self._measured_s = self._aged_s = self._slider_moved_s = 0.0
        self._server = opened_server(host, port)
        self._engine = Engine(
            scene, self._show, self._record_shot, lambda: bool(self._server.get_clients()), self._report
        )
        self._orbit = Stage[tuple[ConsolePicture, bytes]](
            "orbit view", self._draw_orbit_view, self._engine.fail, report=self._report
        )

    def __enter__(self) -> "ConsolePage":
        surfaces, placement = drawing.target_surfaces(self._scene), target_placement(self._scene, self._views[0])
        self._view3d = LiveScene(self._server, drawing.bounds_of_target(surfaces, placement))
        self._view3d.place("target", np.eye(3), self._state.center_m)
        self._view3d.show("target", [*surfaces, drawing.target_edges(self._scene)])
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
        self._problem = gui.add_markdown("")
        self._live = display.ImagePanel(self._server, "camera")
        self._text = gui.add_markdown("waiting for the first measurement")
        gui.add_html(drawing.legend_html(self._scene.rig, ("pose", "track")))
        self._on_click("reset view", self._view3d.reset_view, "Shows all of the scene, as at the start.")
        self._playing: Any = gui.add_checkbox(
            "play", False, hint="Lets the time go on, at the speed of the tab Target."
        )
        tabs = gui.add_tab_group()
        with tabs.add_tab("Target"):
            self._add_target_controls()
        with tabs.add_tab("Rig and light"):
            self._add_rig_controls()
            self._add_light_controls()
        with tabs.add_tab("Measured"):
            self._comparison = gui.add_html("")
            self._result = display.ImagePanel(self._server, "newest measurement")
            self._details = gui.add_markdown("")
        with tabs.add_tab("Errors"):
            self._plots = display.Plots(self._server, TIME_LABEL)
            saving: Any = gui.add_button("errors as CSV", hint="What the plots show, in mm and degrees.")
            saving.on_click(lambda event: self._guarded(partial(self._send_csv, event.client)))

    def _add_target_controls(self) -> None:
        gui = self._server.gui
        with gui.add_folder("Pose at time 0"):
            self._add("view", *(f"center_{axis}_m" for axis in "xyz"), "pitch_deg", "yaw_deg", "roll_deg")
        with gui.add_folder("Motion"):
            self._add("motion", "spin_deg_s", "tumble_deg_s", *(f"drift_{axis}_mm_s" for axis in "xyz"))
            self._add("speed", "time_s")
            self._on_click(f"step {STEP_S:g} s", lambda: self._advance(STEP_S))
            loading: Any = gui.add_upload_button("load trajectory", mime_type="application/json,.jsonl")
            loading.on_upload(lambda _: self._guarded(lambda: self._load_trajectory(loading.value)))
            self._loaded = gui.add_markdown("")
            if len(self._views) > 1:
                hint = "From each view of the scene to the next."
                self._on_click("play the scene's trajectory", self._play_views, hint)
            self._on_click("leave trajectory", lambda: self._follow(None, ""))
        if self._record is None:
            gui.add_markdown("*to record shots with their truth, start with --output DIR*")
        else:
            self._recording: Any = gui.add_checkbox(
                "record shots with their truth", False, hint="Each shot that is measured, into the folder of --output."
            )
            self._recording.on_update(lambda _: self._guarded(self._measure_to_record))
            self._recorded = gui.add_markdown("")
        if self._save is not None:
            self._saving = self._on_click("save scene and rig", self._save_state)

    def _add_rig_controls(self) -> None:
        gui, lasers = self._server.gui, self._lasers
        with gui.add_folder("Camera"):
            self._add("focal_percent", "width_px", "pixel_pitch_percent", "exposure_by_scene", "exposure_ms")
            picking: Any = gui.add_upload_button("rig file", mime_type=".yaml,.yml")
            picking.on_upload(lambda _: self._guarded(lambda: self._pick_rig(picking.value)))
            self._picked = gui.add_markdown("")
        with gui.add_folder("Lasers"):
            self._add(*(f"laser_{name}" for name in lasers), "sequence")
            self._add(*(f"tilt_{name}_deg" for name in lasers), *(f"shift_{name}_mm" for name in lasers))

    def _add_light_controls(self) -> None:
        with self._server.gui.add_folder("Light"):
            self._add("ambient_w_m2", "sun_w_m2", "sun_azimuth_deg", "sun_elevation_deg", "earth")

    def _add(self, *names: str) -> None:
        """Add the fields of these controls."""
        actions = {"view": self._apply_view, "motion": self._apply_motion, "time_s": self._seek, "speed": lambda: None}
        for name in names:
            self._fields[name] = display.Field(self._server, self._controls[name])
            action = actions.get(name, self._change)
            self._fields[name].on_update(partial(self._guarded, partial(self._take_over, action)))

    def _on_click(self, label: str, action: Callable[[], None], hint: str | None = None) -> Any:
        button = self._server.gui.add_button(label, hint=hint)
        button.on_click(lambda _: self._guarded(action))
        return button

    def _guarded(self, action: Callable[[], None]) -> None:
        """Act; an exception is shown, and the page goes on."""
        try:
            action()
        except Exception as problem:
            self._report(problem)

    def _report(self, problem: Exception) -> None:
        """Show an exception that nothing else handles until a later state is measured; print its traceback once."""
        text = f"{type(problem).__name__}: {problem}"
        if text not in self._reported:
            self._reported.add(text)
            traceback.print_exception(problem, file=sys.stderr)
        self._failed = self._state.number
        self._problem.content = f"**internal error** in state {self._failed}: {display.plain(text)}"

    def _take_over(self, action: Callable[[], None]) -> None:
        """Take over what is in the fields and act; say at each field what was not taken."""
        with self._lock:
            given = {name: field.value for name, field in self._fields.items()}
            values, refusals = controls.taken_over(self._controls, given, self._values)
            for name, field in self._fields.items():
                field.report(refusals.get(name, ""))
            if values != self._values:
                self._values = values
                action()

    def _set(self, values: Mapping[str, controls.Value]) -> None:
        """Put values into the fields."""
        self._values.update(values)
        for name, value in values.items():
            self._fields[name].show(value)

    def _change(self, time_s: float | None = None, *, is_time_only: bool = False, measure_now: bool = False) -> None:
        """Show the state of all controls, at the given time or at the time of the last state."""
        with self._lock:
            number = self._state.number + 1
            self._state = replace(
                controls.changed_state(self._state, self._values, self._lasers),
                time_s=self._state.time_s if time_s is None else time_s,
                number=number,
                since=self._state.since if is_time_only else number,
            )
            self._engine.show(self._state, measure_now=measure_now)

    def _apply_view(self) -> None:
        """Set the controls to pose and light of the view that is chosen by name."""
        view = next(each for each in self._views if each.name == self._values["view"])
        with self._lock:
            self._state = replace(self._state, light=first_state(self._scene, view).light)
            self._set(controls.view_values(self._scene, view))
            self._change(0.0)

    def _apply_motion(self) -> None:
        """Set the controls of spin and tumble to those of the motion that is chosen by name."""
        self._set(controls.motion_values(str(self._values["motion"])))
        self._change()

    def _load_trajectory(self, uploaded: Any) -> None:
        try:
            trajectory = self._load(uploaded.content, uploaded.name)
        except RingposeError as problem:
            self._loaded.content = display.plain(f"not loaded: {problem}")
            return
        self._follow(trajectory, f"{uploaded.name}: {len(trajectory.time_s)} poses, {trajectory.time_s[-1]:.1f} s")

    def _follow(self, trajectory: Trajectory | None, text: str) -> None:
        """Show the poses of a trajectory from its beginning, or, for None, the pose that the controls set."""
        with self._lock:
            self._state = replace(self._state, trajectory=trajectory)
            end_s = controls.END_S if trajectory is None else max(float(trajectory.time_s[-1]), MIN_END_S)
            self._controls["time_s"] = self._fields["time_s"].extended_to(end_s)
            self._loaded.content = display.plain(text)
            self._change(0.0)

    def _play_views(self) -> None:
        """Play the motion from each view of the scene to the next."""
        period_s = self._scene.period_s if self._scene.motion is not None else VIEW_S
        self._follow(trajectory_of_views(self._views, period_s), f"{len(self._views)} views of the scene")
        self._playing.value = True

    def _measure_to_record(self) -> None:
        """Measure the present state, so that the first recorded shot is what is shown."""
        if self._recording.value:
            self._change(measure_now=True)

    def _send_csv(self, client: Any) -> None:
        """Send what the plots show to the browser that asks for it."""
        rows = list(self._rows)
        text = display.csv_of(TIME_LABEL, [row[0] for row in rows], [row[1:] for row in rows])
        client.send_file_download("errors.csv", text.encode(), save_immediately=True)

    def _pick_rig(self, uploaded: Any) -> None:
        """Take over camera and lasers of a rig file."""
        try:
            rig = self._load_rig(uploaded.content, uploaded.name)
            if rig.lasers.names != self._scene.rig.lasers.names:
                finding = f"has the lasers {', '.join(rig.lasers.names)}"
                raise DataError(uploaded.name, finding, "give a rig with the lasers of the scene")
        except RingposeError as problem:
            self._picked.content = display.plain(f"not taken over: {problem}")
            return
        with self._lock:
            self._state = replace(self._state, rig_change=replace(self._state.rig_change, rig=rig))
        self._picked.content = display.plain(f"{uploaded.name}: {rig.camera.camera_name}")
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
        try:
            self._record(picture)
        except RingposeError as problem:
            self._recording.value = False
            self._recorded.content = display.plain(f"recording is switched off: {problem}")
            return
        self._recorded.content = display.plain(f"recorded {picture.shot.name}")

    def _play(self) -> None:
        while not self._ended.wait(PERIOD_S):
            self._guarded(self._go_on)

    def _go_on(self) -> None:
        """Advance the time while the motion plays, and the age of the measurement."""
        is_played = self._playing.value and bool(self._server.get_clients())
        with self._lock:
            now_s = time.monotonic()
            speed = str(self._values["speed"])
            is_measured = self._measurement is not None and self._measurement.state.number == self._state.number
            step_s = self._playback.step_s(now_s, speed if is_played else None, is_measured=is_measured)
            if step_s:
                self._advance(step_s, measure_now=speed == IN_STEP)
            if now_s > self._aged_s + AGE_PERIOD_S:
                self._aged_s = now_s
                self._show_text()

    def _advance(self, step_s: float, *, measure_now: bool = False) -> None:
        """Advance the time by a step; the slider follows when the picture is shown."""
        with self._lock:
            end = self._controls["time_s"]
            assert isinstance(end, controls.Number)
            self._change((self._state.time_s + step_s) % end.high, is_time_only=True, measure_now=measure_now)

    def _seek(self) -> None:
        """Show another time, which may not be typed completely yet."""
        with self._lock:
            self._playback.hold(time.monotonic())
            self._change(float(self._values["time_s"]), is_time_only=True)
            self._sought = self._state.number

    # The scene in three dimensions

    def _show_scene(self, picture: ConsolePicture) -> None:
        """Show target, rig, stripes, sun and Earth where they are in this state."""
        state, rig, view = picture.state, picture.rig, picture.state.view(self._scene)
        placement = target_placement(self._scene, view)
        self._view3d.place("target", placement.rotation, placement.translation_m)
        if self._drawn_since != state.since:
            self._drawn_since = state.since
            self._view3d.show("rig", drawing.rig_elements(rig, state.mask, view.center_m))
            self._view3d.show("sky", drawing.sky(self._scene, state.center_m, state.light))
        radii_m = (self._scene.ring.radius_inner_m, self._scene.ring.radius_outer_m)
        self._view3d.show("ring", [drawing.stripes(rig, state.mask, view.center_m, view.normal, radii_m)])

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
                if self._problem.content and state.number > self._failed:
                    self._problem.content = ""
            elif shown is not None:
                if state.number <= shown.state.number:
                    return  # its measurement is shown already
                self._show_text()
            if picture.line is None or is_newest:
                self._live.show(jpeg, f"camera: {stamp}")
                if state.number > self._sought:  # else more may have been typed since
                    self._show_time(state.time_s)
        self._server.flush()
        if picture.line is None or is_newest:
            self._orbit.put((picture, jpeg))

    def _show_text(self) -> None:
        """Status and figures of the newest measurement, with its age if the state has changed since."""
        picture, now = self._measurement, self._state
        if picture is None:
            return
        then, outdated, ago_s = picture.state, "", time.monotonic() - self._measured_s
        if then.since != now.since:
            outdated = f"controls were changed, measured {ago_s:.1f} s ago"
        elif not then.shows_target_of(now):
            outdated = f"the target has moved for {now.time_s - then.time_s:.2f} s since"
        stamp = f"state {then.number}, {then.time_s:.2f} s"
        text = display.line_text(picture.line, stamp, picture.errors or {}, outdated)
        if self._text.content != text:
            self._text.content = text

    def _show_time(self, time_s: float) -> None:
        """Let the slider follow; while the motion plays not too often, as that replaces a digit that is being typed."""
        now_s, field = time.monotonic(), self._fields["time_s"]
        if field.value != self._values["time_s"] and not field.is_refused:
            return  # it was just set, and is about to be taken over
        if not self._playing.value or now_s > self._slider_moved_s + SLIDER_PERIOD_S:
            self._slider_moved_s = now_s
            self._set({"time_s": time_s})

    def _draw_orbit_view(self, shown: tuple[ConsolePicture, bytes]) -> None:
        """Update the scene in three dimensions, at most once in a period."""
        picture, jpeg = shown
        self._ended.wait(PANEL_FIRST_S)
        with self._lock:
            measured = self._measurement
        with self._server.atomic():
            self._show_scene(picture)
            self._view3d.show_image("/rig/camera", jpeg)
            if measured is not None and measured.line is not None:
                track = measured.track
                is_outdated = not measured.state.shows_target_of(picture.state)
                track_pose = None if track is None else track.pose
                self._view3d.show(
                    "measured", drawing.rings(measured.line.pose, None, track_pose, is_outdated=is_outdated)
                )
        self._ended.wait(ORBIT_PERIOD_S - PANEL_FIRST_S)

    def _show_measurement(self, picture: ConsolePicture, jpeg: bytes, stamp: str) -> None:
        line, errors, track = picture.line, picture.errors or {}, picture.track
        assert line is not None
        self._result.show(jpeg, f"newest measurement: {stamp}")
        self._comparison.content = display.comparison_html(line.pose, picture.truth)
        self._show_text()
        if track is not None:
            status = f"{track.validity}, {track.fusion_status}"
            text = display.track_text(track.pose, track.velocity, status, picture.track_error_m)
            self._details.content = f"{text}  \nrings are pale if outdated; the target shows the truth"
        self._rows.append((time.monotonic() - self._began_s, *display.plotted(line.pose, errors)))
        rows = list(self._rows)
        self._plots.show([row[0] for row in rows], [row[1:] for row in rows])
