"""The page of recorded shots: that of the console, with a timeline in place of the controls of the simulation."""

import threading
from collections.abc import Sequence
from typing import Any

import numpy as np

from ringpose.console.display import ImagePanel, Plots, SceneView, line_text, opened_server, plotted, track_text
from ringpose.report.overlay import pose_in_camera_frame
from ringpose.report.replay import ReplayShot, times_s
from ringpose.types.rig import Rig

MAX_SHOWN_S = 2.0
"""Maximum time for which a shot is shown while the replay plays, at speed 1."""


class RecordedPage:
    """Serves the page within its context; all browsers show the same shot."""

    def __init__(self, shots: Sequence[ReplayShot], rig: Rig, host: str, port: int) -> None:
        self._shots, self._rig, self._times_s = shots, rig, times_s(shots)
        self._ended = threading.Event()
        self._server = opened_server(host, port)

    def __enter__(self) -> "RecordedPage":
        gui, shots = self._server.gui, self._shots
        poses = [None if shot.line is None else pose_in_camera_frame(shot.line, self._rig) for shot in shots]
        self._poses = poses
        rings = [*poses, *(shot.truth for shot in shots)]
        centers = [ring.center_m for ring in rings if ring is not None and ring.center_m is not None]
        target_m = next((center for center in centers if np.isfinite(center).all()), np.array([0.0, 0.0, 1.0]))
        self._view3d = SceneView(self._server, self._rig, target_m)
        self._view3d.show_rig(self._rig, 255, 1.1 * float(np.linalg.norm(target_m)))
        self._picture = ImagePanel(self._server, "shot")
        self._text = gui.add_markdown("")
        self._playing: Any = gui.add_checkbox("play", False)
        with gui.add_folder("Time"):
            self._speed = gui.add_dropdown("speed", ["0.25", "0.5", "1", "2", "5", "10"], initial_value="1")
            self._number: Any = gui.add_slider("shot", 1, max(len(shots), 2), 1, 1)
            gui.add_button("previous").on_click(lambda _: self._step(-1))
            gui.add_button("next").on_click(lambda _: self._step(1))
        with gui.add_folder("Errors"):
            rows = [plotted(pose, shot.errors) for pose, shot in zip(poses, shots, strict=True)]
            Plots(self._server, "shot").show(range(1, len(shots) + 1), rows)
        self._number.on_update(lambda _: self._show())
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
        return min(int(self._number.value), len(self._shots)) - 1

    def _step(self, by: int) -> None:
        self._number.value = self._shown + 1 + by if 0 <= self._shown + by < len(self._shots) else self._shown + 1

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
            wait_s = min(gap_s, MAX_SHOWN_S) / float(self._speed.value)
            self._step(1)

    def _show(self) -> None:
        number = self._shown
        shot, pose = self._shots[number], self._poses[number]
        about = f"shot {number + 1} of {len(self._shots)}, {self._times_s[number]:.3f} s"
        track = shot.track
        with self._server.atomic():
            self._picture.show(shot.jpeg, f"{shot.name}: {about}")
            self._view3d.show_image(shot.jpeg)
            self._view3d.show_rings(pose, shot.truth, None if track is None else track.pose)
            text = line_text(shot.line, about, shot.errors)
            if track is not None:
                text += "  \n" + track_text(track.pose, track.velocity, track.reason or "")
            self._text.content = f"{text}  \nrings: pose blue, track orange, truth green"
