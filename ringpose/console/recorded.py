"""The page of recorded shots: that of the console, with a timeline in place of the controls of the simulation."""

import threading
from collections.abc import Sequence
from typing import Any

from ringpose.console.controls import Choice, Control, Number, Value, taken_over
from ringpose.console.display import Field, ImagePanel, Plots, line_text, plotted, track_text
from ringpose.console.drawing import NOTHING, bounds, cloud_points, legend_html, recorded_elements, rig_elements
from ringpose.console.live_scene import LiveScene
from ringpose.console.replay import ReplayCloud, ReplayShot, times_s
from ringpose.console.server import opened_server
from ringpose.report.overlay import pose_in_camera_frame
from ringpose.types.image import ALL_LASERS
from ringpose.types.rig import Rig

SPEEDS = ("0.25", "0.5", "1", "2", "5", "10")

MAX_SHOWN_S = 2.0
"""Maximum time for which a shot is shown while the replay plays, at speed 1."""


class RecordedPage:
    """Serves the page within its context; all browsers show the same shot."""

    def __init__(
        self, shots: Sequence[ReplayShot], rig: Rig, host: str, port: int | None, cloud: ReplayCloud | None = None
    ) -> None:
        self._shots, self._rig, self._times_s = shots, rig, times_s(shots)
        self._cloud, self._is_cloud_shown = cloud, False
        self._ended = threading.Event()
        self._lock = threading.RLock()
        self._controls: dict[str, Control] = {
            "speed": Choice(label="speed", options=SPEEDS, initial="1"),
            "shot": Number(label="shot", low=1.0, high=float(max(len(shots), 2)), step=1.0, initial=1.0),
        }
        self._values: dict[str, Value] = {name: control.initial for name, control in self._controls.items()}
        self._server = opened_server(host, port)

    def __enter__(self) -> "RecordedPage":
        gui, shots = self._server.gui, self._shots
        poses = [None if shot.line is None else pose_in_camera_frame(shot.line, self._rig) for shot in shots]
        self._poses = poses
        points_m = NOTHING if self._cloud is None else self._cloud.points_m(shots)
        shown = bounds([*poses, *(shot.truth for shot in shots)], points_m)
        self._view3d = LiveScene(self._server, shown)
        self._view3d.show("rig", rig_elements(self._rig, ALL_LASERS, shown.target_m))
        self._picture = ImagePanel(self._server, "shot")
        self._text = gui.add_markdown("")
        gui.add_html(legend_html(self._rig))
        gui.add_button("reset view").on_click(lambda _: self._view3d.reset_view())
        self._playing: Any = gui.add_checkbox("play", False)
        with gui.add_folder("Time"):
            self._fields = {name: Field(self._server, control) for name, control in self._controls.items()}
            gui.add_button("previous").on_click(lambda _: self._step(-1))
            gui.add_button("next").on_click(lambda _: self._step(1))
        with gui.add_folder("Errors"):
            rows = [plotted(pose, shot.errors) for pose, shot in zip(poses, shots, strict=True)]
            Plots(self._server, "shot").show(range(1, len(shots) + 1), rows)
        for field in self._fields.values():
            field.on_update(self._take_over)
        self._show()
        self._player = threading.Thread(target=self._play, name="replay player", daemon=True)
        self._player.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._player.join()
        self._server.stop()

    @property
    def port(self) -> int:
        """The port of the page."""
        return int(self._server.get_port())

    def serve(self) -> None:
        """Serve until the context ends or a signal comes."""
        self._ended.wait()

    @property
    def _shown(self) -> int:
        return min(round(float(self._values["shot"])), len(self._shots)) - 1

    def _take_over(self) -> None:
        """Take over what is in the fields; say at each what was not taken."""
        with self._lock:
            given = {name: field.value for name, field in self._fields.items()}
            self._values, refusals = taken_over(self._controls, given, self._values)
            for name, field in self._fields.items():
                field.report(refusals.get(name, ""))
            self._show()

    def _step(self, by: int) -> None:
        """Show an earlier or a later shot, if there is one."""
        with self._lock:
            if 0 <= self._shown + by < len(self._shots):
                self._values["shot"] = float(self._shown + 1 + by)
            self._fields["shot"].show(self._values["shot"])
            self._show()

    def _play(self) -> None:
        wait_s = 0.1
        while not self._ended.wait(wait_s):
            shown, wait_s = self._shown, 0.1
            if not self._playing.value:
                continue
            if shown + 1 == len(self._shots):
                self._playing.value = False
                continue
            gap_s = self._times_s[shown + 1] - self._times_s[shown]
            wait_s = min(gap_s, MAX_SHOWN_S) / float(self._values["speed"])
            self._step(1)

    def _show(self) -> None:
        number = self._shown
        shot, pose = self._shots[number], self._poses[number]
        about = f"shot {number + 1} of {len(self._shots)}, {self._times_s[number]:.3f} s"
        track = shot.track
        with self._server.atomic():
            self._picture.show(shot.jpeg, f"{shot.name}: {about}")
            self._view3d.show_image("/rig/camera", shot.jpeg)
            elements = recorded_elements(self._rig, pose, shot.truth, None if track is None else track.pose)
            self._view3d.show("measured", elements)
            self._show_cloud(shot)
            text = line_text(shot.line, about, shot.errors)
            if track is not None:
                text += "  \n" + track_text(track.pose, track.velocity, track.reason or "")
            self._text.content = text

    def _show_cloud(self, shot: ReplayShot) -> None:
        """The cloud where it is at the time of a shot; all of it, or the points of the shot."""
        cloud, place = self._cloud, shot.camera_from_cloud
        if cloud is None:
            return
        if place is None:
            self._view3d.show("cloud", ())
            self._is_cloud_shown = False
            return
        self._view3d.place("cloud", place[:3, :3], place[:3, 3])
        if cloud.by_shot or not self._is_cloud_shown:
            self._view3d.show("cloud", cloud_points(cloud.cloud, cloud.number_of(shot)))
        self._is_cloud_shown = True
