"""What `import ringpose` gives: reading, detection, measurement, tracks, calibration and simulation, for notebooks.

import ringpose

rig = ringpose.read_rig("rig.yaml")
line = ringpose.measure_ring(ringpose.read_shot("shots/0001.npz"), rig)
print(line.status, line.pose.grasp_m, line.pose.covariance_grasp_m2)

The functions are named for what they act on, since `ringpose.detect`, `ringpose.measure` and `ringpose.simulate` are
packages. Positions are metres in the frame of the camera (x right, y down, z along the optical axis), angles radians,
image points pixels. All raise `RingposeError` with file, finding and remedy.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

from ringpose.calibrate.boards.shots import BoardShots
from ringpose.calibrate.camera.parameters import PLUMB_BOB as PLUMB_BOB
from ringpose.calibrate.camera.parameters import CameraModel as CameraModel
from ringpose.calibrate.camera.pipeline import assessed_camera
from ringpose.calibrate.planes.pipeline import StripeShots
from ringpose.calibrate.planes.quality import PlanesAssessment as PlanesAssessment
from ringpose.detect.pipeline import Prior as Prior
from ringpose.errors import RingposeError as RingposeError
from ringpose.files import boards, records, rigs
from ringpose.files.cameras import formats
from ringpose.files.images import shots as shot_files
from ringpose.files.records.poses import pose_line_of
from ringpose.files.records.tracks import line_record
from ringpose.files.scenes import scene as scene_files
from ringpose.measure.stream import Measured as Measured
from ringpose.measure.stream import Setup as Setup
from ringpose.measure.stream import Stream as Stream
from ringpose.simulate import pipeline as simulation
from ringpose.track.explanations import TrackOptions as TrackOptions
from ringpose.track.pipeline import Tracker as Tracker
from ringpose.types.assumptions import USUAL
from ringpose.types.assumptions import AssumptionOptions as AssumptionOptions
from ringpose.types.board import Board as Board
from ringpose.types.board import BoardView
from ringpose.types.calibration import CameraAssessment as CameraAssessment
from ringpose.types.detection import Detection as Detection
from ringpose.types.image import Shot as Shot
from ringpose.types.options import PlanesMethod as PlanesMethod
from ringpose.types.pose import KnownRadii as KnownRadii
from ringpose.types.pose import PoseLine as PoseLine
from ringpose.types.pose import Ring as Ring
from ringpose.types.rig import Camera as Camera
from ringpose.types.rig import Rig as Rig
from ringpose.types.scene import Scene as Scene
from ringpose.types.track import TrackLine as TrackLine
from ringpose.types.truth import Truth as Truth

File = str | PathLike[str]


def read_rig(path: File) -> Rig:
    """The camera, light planes and their covariance in a rig.yaml."""
    return rigs.read_rig(Path(path))


def read_camera(path: File) -> Camera:
    """The camera in a camera.yaml or rig.yaml, or in a file of ROS, OpenCV, Kalibr or MATLAB."""
    return formats.read_camera(Path(path))


def read_board(path: File) -> Board:
    """The kind and the sizes of a calibration board."""
    return boards.read_board(Path(path))


def read_scene(path: File) -> Scene:
    """The scene in a scene.yaml."""
    return scene_files.read_scene(Path(path))


def read_shot(path: File) -> Shot:
    """The frames of a shot (NPZ), with their lasers and stamps; an image is one frame with all lasers on."""
    return shot_files.read_shot(Path(path))


def read_pose_lines(path: File) -> Iterator[PoseLine]:
    """The lines that `ringpose pose` has written into a file."""
    with Path(path).open("rb") as stream:
        for location, record in records.read(stream, str(path)):
            yield pose_line_of(record, location)


def record_of(line: PoseLine | TrackLine) -> dict[str, Any]:
    """The JSON record of a line, as `ringpose pose` and `ringpose track` write it; NaN becomes null (None)."""
    return records.parsed_record(records.line_of(line_record(line)), "the line")


def detect_ring(shot: Shot, rig: Rig, options: AssumptionOptions = USUAL) -> Detection:
    """The stripes, break points and visible edges of the ring in a shot, or why there are none.

    `options`: what is known of motion, form and rig, as the command's `--still` or `--ring-tolerance`.
    """
    return Setup(rig=rig, options=options).detection(shot)


def measure_ring(
    source: Shot | Detection,
    rig: Rig,
    options: AssumptionOptions = USUAL,
    known: KnownRadii | Sequence[Ring] | None = None,
) -> PoseLine:
    """The pose line of a shot, or of what was detected in it, by itself; a `Stream` uses what earlier shots show.

    `known`: the radii of the ring, or the rings that it may be.
    """
    return Setup(rig=rig, options=options, known=known).measure(source)


def calibrate_camera(shots: Iterable[Shot], board: Board, model: CameraModel = PLUMB_BOB) -> CameraAssessment:
    """The camera that took these images of a board, with covariance, residuals of the views and findings."""
    return assessed_camera(_boards_in(shots, board)[0], model)


def calibrate_planes(
    shots: Iterable[Shot], board: Board, camera: Camera, method: PlanesMethod = PlanesMethod.JOINT
) -> PlanesAssessment:
    """The light planes of the lasers from shots of a board that the stripes cross, with covariance and verdict.

    `assessment.calibration` has the camera, the planes and their covariance: the parts of a `Rig`.
    """
    found, views = _boards_in(shots, board)
    stripes = StripeShots(found, camera, None, None)
    for shot, view in views:
        stripes.add(shot, view)
    return stripes.assessment(method)


def _boards_in(shots: Iterable[Shot], board: Board) -> tuple[BoardShots, list[tuple[Shot, BoardView]]]:
    """The board in each shot; those that do not show it are in `without_board`."""
    with BoardShots(board) as found:
        views = [(shot, found.add(shot)) for shot in shots]
    return found, [(shot, view) for shot, view in views if isinstance(view, BoardView)]


def simulate_shots(scene: Scene, count: int | None = None, seed: int | None = None) -> Iterator[tuple[Shot, Truth]]:
    """The shots of a scene, rendered, with their ground truth."""
    yield from simulation.simulate(scene if seed is None else replace(scene, seed=seed), count)
