"""The rig of a scene, calibrated from simulated views of its boards as `calibrate-camera` and `calibrate-planes` do."""

from collections.abc import Iterator
from dataclasses import replace

from ringpose.calibrate.boards.diagnostics import NoBoard
from ringpose.calibrate.boards.views import board_image, find_board
from ringpose.calibrate.camera.assessment import camera_assessment, widened
from ringpose.calibrate.camera.parameters import CameraModel
from ringpose.calibrate.camera.pipeline import calibrate_camera
from ringpose.calibrate.planes.quality import calibrated_rig as rig_of_planes
from ringpose.calibrate.planes.shots import StripeShots
from ringpose.errors import DataError
from ringpose.simulate.pipeline import simulated_boards
from ringpose.types.board import BoardView
from ringpose.types.image import Shot
from ringpose.types.options import PlanesMethod
from ringpose.types.rig import Rig
from ringpose.types.scene import BoardSet, Scene


def calibrated_rig(scene: Scene, jobs: int = 1) -> Rig:
    """Camera and light planes with their joint covariance, estimated from the scene's board views.

    Views in which the board is not found are left out. DataError if the scene has no boards, or too few views.
    """
    if scene.camera_boards is None or scene.plane_boards is None:
        raise DataError("the scene", "has no board views", "add boards")
    camera, names = scene.rig.camera, scene.rig.lasers.names
    model, views = CameraModel(), [view for _, view in _board_views(scene, scene.camera_boards, jobs)]
    found = calibrate_camera(views, camera.image_width, camera.image_height, model, camera.camera_name)
    calibration, _ = widened(found, camera_assessment(found, views, model))
    stripes = StripeShots(scene.plane_boards.board, calibration.camera, ",".join(names), None)
    for shot, view in _board_views(scene, scene.plane_boards, jobs):
        stripes.add(shot, view)
    rig = rig_of_planes(stripes.assessment(PlanesMethod.JOINT).calibration)
    # a calibration does not know where the projectors are, which only the simulation of features needs
    return replace(rig, lasers=replace(rig.lasers, projector_m=scene.rig.lasers.projector_m))


def _board_views(scene: Scene, boards: BoardSet, jobs: int) -> Iterator[tuple[Shot, BoardView]]:
    for shot, _ in simulated_boards(scene, boards, jobs=jobs):
        view = find_board(board_image(shot), boards.board, shot.name)
        if not isinstance(view, NoBoard):
            yield shot, view
