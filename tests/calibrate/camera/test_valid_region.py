"""Validity of a camera's covariance, for a wide rational lens computed here."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from known_views import projected_px
from ring_scenes import make_camera

from ringpose.calibrate.camera.assessment import camera_assessment
from ringpose.calibrate.camera.parameters import CameraModel
from ringpose.calibrate.camera.pipeline import calibrate_camera
from ringpose.calibrate.camera.quality import camera_quality, camera_summary, camera_verdict
from ringpose.calibrate.camera.validation import displacement_px, known_lens, map_points_px, projection_sigma_px
from ringpose.geometry.board import corner_points
from ringpose.types.board import Board, BoardView

MODEL = CameraModel(distortion_model="rational_polynomial")
POINTS_M = corner_points(Board(kind="chessboard", squares_x=12, squares_y=9, square_m=0.025))
NOISE_PX = 0.03
DISTORTION = (0.9, 0.15, 0.0004, -0.0003, 0.01, 1.3, 0.4, 0.05)
CAMERA = make_camera((800, 600), (600.0, 599.5), (402.3, 297.6), DISTORTION)


def middle_views(rng, number: int) -> list[BoardView]:
    """Makes views of boards in the middle of the image, with noise."""
    made = []
    for index in range(number):
        turn = np.asarray(cv2.Rodrigues(rng.uniform([-0.5, -0.5, -0.3], [0.5, 0.5, 0.3]))[0])
        depth_m = rng.uniform(0.3, 0.5)
        place = np.array([*rng.uniform(-0.15, 0.15, 2) * depth_m, depth_m])
        points_px = projected_px((POINTS_M - POINTS_M.mean(axis=0)) @ turn.T + place, CAMERA)
        seen = ((points_px > 2) & (points_px < [797, 597])).all(axis=1)
        noisy = points_px[seen] + NOISE_PX * rng.standard_normal((int(seen.sum()), 2))
        made.append(
            BoardView(name=f"v{index}", ids=np.flatnonzero(seen), points_board_m=POINTS_M[seen], points_px=noisy)
        )
    return made


@pytest.mark.slow
def test_a_rational_lens_has_the_reported_errors_where_it_is_known(rng):
    ratios = []
    for _ in range(6):
        boards = middle_views(rng, 10)
        found = calibrate_camera(boards, 800, 600, MODEL).camera
        known = known_lens(found, np.concatenate([view.points_px for view in boards]))
        squares = (displacement_px(found, CAMERA) / projection_sigma_px(found, found.covariance.data)) ** 2
        ratios.append(np.mean(squares[known]))

    assert 0.4 < np.mean(ratios) < 1.8


def test_the_share_of_the_image_in_which_the_lens_is_unknown_is_reported(rng):
    boards = middle_views(rng, 5)
    found = calibrate_camera(boards, 800, 600, MODEL)
    assessed = camera_assessment(found, MODEL)
    verdict = camera_verdict(assessed, 5)

    projection = camera_quality(assessed, verdict)["quality"]["projection"]
    lines = "\n".join(camera_summary(assessed, verdict))

    assert projection["unknown_share"] > 0.05
    assert np.isfinite(projection["sigma_worst_px"])
    assert f"not known in {100 * projection['unknown_share']:.0f} % of the image" in lines
    assert any("bring the board to the image's corners" in sentence for sentence in verdict.advice)


def test_a_rational_model_is_valid_up_to_the_largest_radius_of_a_corner():
    camera = replace(CAMERA, camera_matrix=np.array([[600.0, 0.0, 400.0], [0.0, 600.0, 300.0], [0.0, 0.0, 1.0]]))
    where = map_points_px(camera)

    known = known_lens(camera, np.array([[390.0, 290.0], [400.0, 520.0]]))

    assert np.array_equal(known, np.hypot(where[..., 0] - 400, where[..., 1] - 300) <= 220)


def test_polynomials_alone_are_known_everywhere(rng):
    boards = middle_views(rng, 5)

    assessed = camera_assessment(calibrate_camera(boards, 800, 600), CameraModel())

    assert assessed.unknown_share == 0
