"""Accumulation of shots for the light planes: checks of methods and options."""

from dataclasses import replace

import pytest

from ringpose.calibrate.planes.shots import StripeShots, check_method
from ringpose.errors import UsageError
from ringpose.types.board import Board
from ringpose.types.options import PlanesMethod

CHESSBOARD = Board(kind="chessboard", squares_x=8, squares_y=6, square_m=0.02)


@pytest.fixture
def shots(rng, plane_board, true_camera, stripe_views, true_poses):
    """Three shots of three lasers."""
    found = StripeShots(plane_board, true_camera, "left,middle,right", None)
    found.names = ("left", "middle", "right")
    found.views = stripe_views(true_poses(rng, 3), rng, 0.02, 0.05)
    return found


def test_the_papers_method_requires_a_board_of_markers(true_camera):
    with pytest.raises(UsageError, match="--method paper"):
        check_method(PlanesMethod.PAPER, False, CHESSBOARD, true_camera)


@pytest.mark.parametrize(
    ("method", "finding"),
    [(PlanesMethod.JOINT, "no covariance"), (PlanesMethod.TOTAL_LEAST_SQUARES, "only the joint method")],
)
def test_a_camera_without_covariance_or_joint_method_cannot_be_free(method, finding, plane_board, true_camera):
    with pytest.raises(UsageError, match=finding):
        check_method(method, True, plane_board, replace(true_camera, covariance=None))


def test_the_assessment_compares_with_the_papers_method(shots):
    assessment = shots.assessment(PlanesMethod.TOTAL_LEAST_SQUARES)

    assert assessment.paper is not None
    assert assessment.paper.method == "paper"


def test_the_papers_method_is_not_compared_with_itself(shots):
    assert shots.assessment(PlanesMethod.PAPER).paper is None


def test_expected_angles_must_be_one_for_each_pair_of_neighbours(shots):
    with pytest.raises(UsageError, match="has 1, must have 2"):
        shots.assessment(PlanesMethod.PAPER, expected_rad=[0.17])
