from dataclasses import replace

import numpy as np
import pytest
from ring_scenes import make_camera

from ringpose.calibrate.boards.views import find_board
from ringpose.geometry.board import corner_points
from ringpose.geometry.rays import project
from ringpose.simulate.pipeline import simulated_boards
from ringpose.simulate.placement import board_poses, middle_of_board_m
from ringpose.types.board import Board, BoardView
from ringpose.types.scene import BoardApproach, BoardSet

CHARUCO = Board(kind="charuco", squares_x=7, squares_y=5, square_m=0.04, marker_m=0.03, dictionary="DICT_4X4_50")
BOARDS = {
    "charuco": CHARUCO,
    "chessboard": Board(kind="chessboard", squares_x=8, squares_y=6, square_m=0.03),
    "four_markers": Board(
        kind="four_markers", width_m=0.3, height_m=0.24, marker_m=0.06, margin_m=0.01, dictionary="DICT_4X4_50"
    ),
    "aruco_grid": Board(
        kind="aruco_grid", squares_x=3, squares_y=2, marker_m=0.06, gap_m=0.02, dictionary="DICT_4X4_50"
    ),
}


@pytest.fixture
def sharp_scene(scene):
    """The scene with an image large enough for markers."""
    distortion = scene.rig.camera.distortion_coefficients
    camera = make_camera((640, 480), (712.0, 712.8), (321.4, 238.4), distortion)
    return replace(scene, rig=replace(scene.rig, camera=camera), sensor=replace(scene.sensor, pixel_m=1.1e-5))


def boards_of(kind, **values):
    approach = BoardApproach(count=2, distances_m=(0.40, 0.45), tilt_rad=0.3, turn_rad=0.1, offset=0.02)
    return BoardSet(**{"board": BOARDS[kind], "approach": approach, "exposure_s": 0.002} | values)


@pytest.mark.parametrize(
    "kind",
    ["chessboard", "four_markers", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("charuco", "aruco_grid"))],
)
def test_corners_are_found_at_their_projections(sharp_scene, kind):
    ((shot, pose),) = simulated_boards(sharp_scene, boards_of(kind), count=1)

    found = find_board(shot.images[0], BOARDS[kind], shot.name)

    assert isinstance(found, BoardView)
    true_px = project(
        corner_points(BOARDS[kind])[found.ids] @ pose.rotation.T + pose.translation_m, sharp_scene.rig.camera
    )
    assert len(found.ids) >= 16
    assert np.sqrt(np.mean((found.points_px - true_px) ** 2)) < 0.1


def test_stripes_cross_the_plane_board(sharp_scene):
    boards = boards_of("four_markers", sequence=(0, 1, 2, 4, 7))

    ((shot, _), *_) = simulated_boards(sharp_scene, boards)

    brighter = shot.images[1:4].astype(int) - shot.images[0]
    assert ((brighter > 30).sum(axis=(1, 2)) > 300).all()


def test_given_poses_come_before_random_ones(sharp_scene):
    boards = boards_of("charuco")
    written = board_poses(sharp_scene, boards)[:1]

    poses = board_poses(sharp_scene, replace(boards, poses=written))

    assert len(poses) == 3
    assert poses[0] is written[0]


def test_random_boards_are_between_the_distances_and_face_the_camera(sharp_scene):
    approach = BoardApproach(count=50, distances_m=(0.3, 0.9), offset=0.0)

    poses = board_poses(sharp_scene, boards_of("charuco", approach=approach))

    depth_m = [(p.rotation @ middle_of_board_m(CHARUCO) + p.translation_m)[2] for p in poses]
    assert min(depth_m) >= 0.3
    assert max(depth_m) <= 0.9
    assert np.ptp(depth_m) > 0.4
    assert min(pose.rotation[2, 2] for pose in poses) > 0.5
