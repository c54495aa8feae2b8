"""Reasons for the rejection of views: another camera, a rotated image, a shadow, saturation."""

import re
from dataclasses import replace

import numpy as np
import pytest

from ringpose.calibrate.boards.layout import corner_points
from ringpose.calibrate.camera.outliers import other_camera_finding
from ringpose.calibrate.camera.pipeline import calibrate_camera
from ringpose.types.board import Board, BoardView
from ringpose.types.calibration import Grade

CHESSBOARD = Board(kind="chessboard", squares_x=12, squares_y=10, square_m=0.025)
POINTS = corner_points(CHESSBOARD)
NOISE_PX = 0.03


@pytest.fixture
def views(rng, board_view, true_poses):
    def made(number: int) -> list[BoardView]:
        return [
            board_view(POINTS, pose, f"v{index}", NOISE_PX * rng.standard_normal((len(POINTS), 2)))
            for index, pose in enumerate(true_poses(rng, number))
        ]

    return made


def changed(view: BoardView, points_px: np.ndarray) -> BoardView:
    return BoardView(name=view.name, ids=view.ids, points_board_m=view.points_board_m, points_px=points_px)


def rejected(views: list[BoardView]) -> dict[str, str]:
    return {view.name: view.rejected for view in calibrate_camera(views, 1600, 1200).views if view.rejected}


def test_a_view_of_another_camera_is_named_with_its_focal_length(views):
    boards = views(10)
    boards[4] = changed(boards[4], [800.0, 600.0] + 1.02 * (boards[4].points_px - [800.0, 600.0]))

    found = rejected(boards)

    assert list(found) == ["v4"]
    assert re.search(r"focal length (1\.[89]|2\.[01]) % longer", found["v4"])
    assert "another camera, zoom or focus" in found["v4"]


def test_an_image_turned_by_half_a_turn_is_said_to_be(views):
    boards = views(10)
    boards[4] = changed(boards[4], [1599.0, 1199.0] - boards[4].points_px)

    found = rejected(boards)

    assert list(found) == ["v4"]
    assert "turned by half a turn" in found["v4"]


def test_a_board_turned_by_half_a_turn_is_as_good_as_any(views, board_view, rng):
    turn = np.diag([-1.0, -1.0, 1.0])
    rolled = board_view(POINTS, (turn, np.array([0.15, 0.12, 0.5])), "rolled", NOISE_PX)

    assert rejected([*views(10), rolled]) == {}


def test_an_overexposed_view_is_named_with_the_share_of_its_corners(views, rng):
    boards = views(10)
    drawn_aside = boards[4].points_px + rng.choice([-0.5, 0.5], (len(POINTS), 2))
    boards[4] = replace(boards[4], points_px=drawn_aside, saturated_share=0.9)

    found = rejected(boards)

    assert list(found) == ["v4"]
    assert "white is saturated beside 90 % of its corners" in found["v4"]


def mixed(boards: list[BoardView], indices: tuple[int, ...]) -> list[BoardView]:
    """The views, some of them with a focal length 2 % longer."""
    middle = [800.0, 600.0]
    return [
        changed(view, middle + 1.02 * (view.points_px - middle)) if index in indices else view
        for index, view in enumerate(boards)
    ]


@pytest.mark.parametrize(("indices", "grade"), [((0, 4), Grade.IMPROVABLE), ((0, 4, 8, 12), Grade.REDO)])
def test_views_of_another_camera_are_told_together(views, indices, grade):
    boards = mixed(views(15), indices)

    finding = other_camera_finding(calibrate_camera(boards, 1600, 1200), boards)

    assert finding.grade is grade
    assert finding.value == pytest.approx(len(indices) / 15)
    assert finding.advice.startswith(f"views {', '.join(f'v{index}' for index in indices)} look like another camera's")
    assert re.search(r"focal length (1\.[89]|2\.[012]) % longer", finding.advice)


def test_a_view_of_the_other_camera_that_was_used_is_told_with_those_left_out(views):
    boards = mixed(views(15), (0, 4, 8))
    found = calibrate_camera(boards, 1600, 1200)
    kept = replace(found, views=tuple(replace(one, rejected="") if one.name == "v8" else one for one in found.views))

    finding = other_camera_finding(kept, boards)

    assert finding.advice.startswith("views v0, v4, v8 look")


def test_views_of_one_camera_are_no_others(views):
    boards = views(10)

    assert other_camera_finding(calibrate_camera(boards, 1600, 1200), boards).grade is Grade.GOOD


def test_images_turned_by_half_a_turn_are_no_other_cameras(views):
    boards = [
        changed(view, [1599.0, 1199.0] - view.points_px) if index in (2, 6) else view
        for index, view in enumerate(views(12))
    ]
    found = calibrate_camera(boards, 1600, 1200)

    assert len(found.used) == 10
    assert other_camera_finding(found, boards).grade is Grade.GOOD


def test_one_view_alone_is_no_other_cameras(views):
    boards = mixed(views(12), (3,))

    assert other_camera_finding(calibrate_camera(boards, 1600, 1200), boards).grade is Grade.GOOD
