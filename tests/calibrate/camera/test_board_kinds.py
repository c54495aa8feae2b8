"""Cameras from drawn views of each kind of board: found at the drawn places, and errors as the covariance states."""

from dataclasses import replace

import numpy as np
import pytest
from calibrated import assert_calibrated
from known_views import projected_px
from warped_boards import CAMERA, KINDS, drawn_view, tilted_poses

from ringpose.calibrate.boards.diagnostics import BoardFailure
from ringpose.calibrate.boards.views import find_board
from ringpose.calibrate.camera.parameters import CameraModel, parameters_of
from ringpose.calibrate.camera.pipeline import calibrate_camera
from ringpose.types.board import BoardView

MODEL = CameraModel(fix_k3=True)
SETS, VIEWS = 5, 8


SEEN_ELSEWHERE = ("chessboard", "ChArUco", "four markers", "marker grid", "symmetric circles")
"""Boards of which the fast tests find drawings of another origin."""


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in SEEN_ELSEWHERE])
def test_corners_are_found_where_they_are_drawn(kind, rng):
    board, ink, outline_m, light_on_dark = KINDS[kind]
    turn, place = pose = tilted_poses(rng, outline_m, 1)[0]

    view = find_board(drawn_view(ink, pose, rng, light_on_dark), board, kind)

    assert isinstance(view, BoardView)
    errors_px = view.points_px - projected_px(view.points_board_m @ turn.T + place, CAMERA)
    assert np.sqrt(np.mean(errors_px**2)) < 0.06
    assert np.abs(errors_px).max() < 0.3


@pytest.mark.slow
def test_squares_of_a_board_on_its_side_begin_at_its_own_top_left(rng):
    board, ink, outline_m, _ = KINDS["separate squares"]
    turn, place = pose = tilted_poses(rng, outline_m, 1)[0]
    on_its_side = np.rot90(drawn_view(ink, pose, rng), -1).copy()

    view = find_board(on_its_side, board, "on its side")

    assert len(view.ids) == 4 * 6 * 5
    drawn = np.stack([view.points_px[:, 1], CAMERA.image_height - 1 - view.points_px[:, 0]], axis=1)
    assert np.abs(drawn - projected_px(view.points_board_m @ turn.T + place, CAMERA)).max() < 0.3


def test_squares_with_other_counts_are_refused_and_with_another_gap_measured(rng):
    board, ink, outline_m, _ = KINDS["separate squares"]
    image = drawn_view(ink, tilted_poses(rng, outline_m, 1)[0], rng)

    fewer = find_board(image, replace(board, squares_x=5), "fewer")
    narrower = find_board(image, replace(board, gap_m=0.8 * board.gap_m), "narrower")

    assert fewer.failure is BoardFailure.LARGER
    # Squares over their distance are 12.7 / 22.58, and 12.7 / 20.60 in the board file.
    assert narrower.marker_size_ratio == pytest.approx((0.9125, 0.9125), abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_cameras_are_within_three_sigmas_and_their_covariance_holds(kind, rng):
    board, ink, outline_m, light_on_dark = KINDS[kind]
    free = np.arange(8)
    normalised, means = [], []
    for _ in range(SETS):
        images = [drawn_view(ink, pose, rng, light_on_dark) for pose in tilted_poses(rng, outline_m, VIEWS)]
        views = [find_board(image, board, f"{number}") for number, image in enumerate(images)]
        camera = calibrate_camera(views, CAMERA.image_width, CAMERA.image_height, MODEL).camera
        covariance = camera.covariance.data[np.ix_(free, free)]
        error = (parameters_of(camera) - parameters_of(CAMERA))[free]
        normalised.append(float(error @ np.linalg.solve(covariance, error)) / len(free))
        means.append(error / np.sqrt(np.diag(covariance)))

    assert np.abs(np.mean(means, axis=0)).max() < 3 / np.sqrt(SETS)
    assert_calibrated(normalised, len(free))
