"""The output folder of `ringpose simulate`: rig, shots or detections, truth, and calibration views."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import cv2

from ringpose.errors import DataError
from ringpose.files import atomic, records
from ringpose.files.boards import write_board
from ringpose.files.images.codecs import write_image
from ringpose.files.images.shots import write_shot
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

    def __init__(self, folder: Path, rig: Rig, *, force: bool, inputs: Iterable[Path], content: str = "shots") -> None:
        """`content` names the subfolder: `shots`, or `detections`."""
        self.folder = atomic.make_folder(folder)
        self.force = force
        self.inputs = tuple(inputs)
        write_rig(folder / "rig.yaml", rig, force=force, inputs=self.inputs)
        self._begin(folder / "truth.jsonl", folder / content)
        atomic.make_folder(folder / content)

    def add(self, shot: Shot, truth: Truth) -> Path:
        """Write one shot and append its line to truth.jsonl; returns the shot's path."""
        path = self.folder / "shots" / f"{shot.name}.npz"
        write_shot(path, shot, force=self.force)
        self._append(self.folder / "truth.jsonl", truth_record(truth))
        return path

    def add_detection(self, detection: Detection, truth: Truth) -> Path:
        """Write one drawn detection and append its line to truth.jsonl; returns the detection's path."""
        path = self.folder / "detections" / f"{detection.shot}.npz"
        write_detection(path, detection, force=self.force, inputs=self.inputs)
        self._append(self.folder / "truth.jsonl", truth_record(truth))
        return path

    def add_boards(self, name: str, board: Board, views: Iterable[tuple[Shot, NamedBoardPose]]) -> None:
        """Write the views of a board (`camera` or `plane`) as they are rendered, the board file and the true poses.

        A view is a PNG image if it is a single frame without lasers, else a shot.
        """
        calibration = atomic.make_folder(self.folder / "calibration")
        folder, truth = atomic.make_folder(calibration / _VIEWS[name]), calibration / f"{name}_truth.jsonl"
        self._begin(truth, folder)
        write_board(calibration / f"{name}_board.yaml", board, force=self.force)
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

    def _begin(self, truth: Path, views: Path) -> None:
        """Create an empty truth file; if one exists, it is removed together with the views that it lists."""
        with atomic.replacing(truth, self.force):
            for name in _listed(truth):
                for suffix in ("npz", "png"):
                    (views / f"{name}.{suffix}").unlink(missing_ok=True)

    def _append(self, path: Path, record: Mapping[str, object]) -> None:
        try:
            with path.open("a", encoding="utf-8") as stream:
                stream.write(records.line_of(record))
        except OSError as error:
            raise atomic.output_error(path, error) from error


_VIEWS = {"camera": "camera", "plane": "planes"}
"""Folder of the views of each board."""


def _listed(truth: Path) -> list[str]:
    """Names of the shots or views in an existing truth file; empty if it cannot be read."""
    if not truth.is_file():
        return []
    try:
        listed = [record for _, record in records.read(truth.read_text(encoding="utf-8").splitlines(), str(truth))]
    except (DataError, UnicodeDecodeError):
        return []
    names = (str(record.get("shot", record.get("view", ""))) for record in listed)
    return [name for name in names if name and Path(name).name == name]
