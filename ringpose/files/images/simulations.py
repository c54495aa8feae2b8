"""The output folder of `ringpose simulate`: rig, shots or detections, truth, and calibration views."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import cv2
import numpy as np

from ringpose.errors import DataError
from ringpose.files import atomic, records
from ringpose.files.boards import write_board
from ringpose.files.images.codecs import write_image
from ringpose.files.images.shots import read_shot, write_shot
from ringpose.files.records.detections import write_detection
from ringpose.files.records.truths import truth_record
from ringpose.files.rigs import write_rig
from ringpose.types.board import Board
from ringpose.types.detection import Detection
from ringpose.types.image import Shot
from ringpose.types.rig import Rig
from ringpose.types.scene import NamedBoardPose
from ringpose.types.truth import Truth


class SimulationFolder:
    """Writes each file atomically; the truth line of a shot is appended after the shot."""

    def __init__(
        self,
        folder: Path,
        rig: Rig,
        *,
        force: bool,
        inputs: Iterable[Path],
        content: str = "shots",
        resume: bool = False,
    ) -> None:
        """`content` names the subfolder: `shots`, or `detections`.

        `resume`: the folder is that of an interrupted run, of which the last shot is the first to be added again.
        """
        self.folder = atomic.make_folder(folder)
        self.resume = resume
        self.force = force or resume  # files that an interrupted run has written without their lines
        self.inputs = tuple(inputs)
        done = self._begin(folder / TRUTH, folder / content)
        self._last = done[-1] if done else None
        if not done:
            write_rig(folder / "rig.yaml", rig, force=self.force, inputs=self.inputs)
        atomic.make_folder(folder / content)

    def add(self, shot: Shot, truth: Truth) -> Path:
        """Write one shot and append its line to truth.jsonl; returns the shot's path."""
        path = self.folder / "shots" / f"{shot.name}.npz"
        if self._last is not None:
            self._check_last(shot, path)
            return path
        write_shot(path, shot, force=self.force)
        self._append(self.folder / TRUTH, truth_record(truth))
        return path

    def _check_last(self, shot: Shot, path: Path) -> None:
        """Reject a folder whose last shot differs from the same shot of this run."""
        if shot.name != self._last or not path.exists() or not np.array_equal(read_shot(path).images, shot.images):
            finding = f"has another shot {self._last!r} than this scene"
            remedy = "resume with the scene, seed and version of the interrupted run, or use --force without --resume"
            raise DataError(str(self.folder), finding, remedy)
        self._last = None

    def add_detection(self, detection: Detection, truth: Truth) -> Path:
        """Write one drawn detection and append its line to truth.jsonl; returns the detection's path."""
        path = self.folder / "detections" / f"{detection.shot}.npz"
        write_detection(path, detection, force=self.force, inputs=self.inputs)
        self._append(self.folder / TRUTH, truth_record(truth))
        return path

    def begin_boards(self, name: str, board: Board) -> int:
        """Write the board file of `camera` or `plane`; returns how many views an interrupted run has written."""
        calibration = atomic.make_folder(self.folder / "calibration")
        folder = atomic.make_folder(calibration / _VIEWS[name])
        done = self._begin(calibration / f"{name}_truth.jsonl", folder)
        write_board(calibration / f"{name}_board.yaml", board, force=self.force)
        return len(done)

    def add_boards(self, name: str, views: Iterable[tuple[Shot, NamedBoardPose]]) -> None:
        """Write the views of a board as they are rendered, and the true poses.

        A view is a PNG image if it is a single frame without lasers, else a shot.
        """
        calibration = self.folder / "calibration"
        folder, truth = calibration / _VIEWS[name], calibration / f"{name}_truth.jsonl"
        for shot, pose in views:
            if len(shot.images) == 1 and not shot.lasers.any():
                write_image(folder / f"{shot.name}.png", shot.images[0], force=self.force)
            else:
                write_shot(folder / f"{shot.name}.npz", shot, force=self.force)
            record = {
                "view": shot.name,
                "camera_from_board_rvec": cv2.Rodrigues(pose.rotation)[0].ravel(),
                "camera_from_board_tvec_m": pose.translation_m,
            }
            self._append(truth, record)

    def _begin(self, truth: Path, views: Path) -> list[str]:
        """Create an empty truth file; if one exists, it is removed together with the views that it lists.

        With `resume` it is kept but for a line that was cut off; returns what it lists.
        """
        if self.resume and (done := listed(truth)):
            with truth.open("r+b") as stream:
                stream.truncate(stream.read().rfind(b"\n") + 1)
            return done
        with atomic.replacing(truth, self.force):
            for name in listed(truth):
                for suffix in ("npz", "png"):
                    (views / f"{name}.{suffix}").unlink(missing_ok=True)
        return []

    def _append(self, path: Path, record: Mapping[str, object]) -> None:
        try:
            with path.open("a", encoding="utf-8") as stream:
                stream.write(records.line_of(record))
        except OSError as error:
            raise atomic.output_error(path, error) from error


_VIEWS = {"camera": "camera", "plane": "planes"}
"""Folder of the views of each board."""


TRUTH = "truth.jsonl"
"""Truth of the shots, in the folder."""


def listed(truth: Path) -> list[str]:
    """Names of the shots or views in the complete lines of a truth file; empty if there is none, or none is valid."""
    if not truth.is_file():
        return []
    try:
        lines = truth.read_text(encoding="utf-8").splitlines(keepends=True)
        whole = [line for line in lines if line.endswith("\n")]
        truths = [record for _, record in records.read(whole, str(truth))]
    except (DataError, UnicodeDecodeError):
        return []
    names = (str(record.get("shot", record.get("view", ""))) for record in truths)
    return [name for name in names if name and Path(name).name == name]
