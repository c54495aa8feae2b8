"""Reasons for the rejection of views: another camera, a rotated image, a shadow, saturation."""

import re
from dataclasses import replace

import numpy as np
import pytest
from known_views import CHESSBOARD, board_view, chessboard_views

from ringpose.calibrate.camera.outliers import other_camera_finding
from ringpose.calibrate.camera.pipeline import calibrate_camera
from ringpose.geometry.board import corner_points
from ringpose.types.board import BoardView
from ringpose.types.calibration import Grade

POINTS = corner_points(CHESSBOARD)
NOISE_PX = 0.03


@pytest.fixture
def views(rng):
    return lambda number: chessboard_views(rng, number, NOISE_PX)


MIDDLE_PX, LAST_PX = np.array([800.0, 600.0]), np.array([1599.0, 1199.0])


def of_longer_lens(view: BoardView) -> BoardView:
    """The view with a focal length 2 % longer."""
    return replace(view, points_px=MIDDLE_PX + 1.02 * (view.points_px - MIDDLE_PX))


def turned(view: BoardView) -> BoardView:
    """The view in an image turned by half a turn."""
    return replace(view, points_px=LAST_PX - view.points_px)


def mixed(boards: list[BoardView], change, *indices: int) -> list[BoardView]:
    """The views, some of them changed."""
    return [change(view) if index in indices else view for index, view in enumerate(boards)]


def rejected(views: list[BoardView]) -> dict[str, str]:
    return {view.name: view.rejected for view in calibrate_camera(views, 1600, 1200).views if view.rejected}


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (of_longer_lens, r"focal length (1\.[89]|2\.[01]) % longer.*another camera, zoom or focus"),
        (turned, "turned by half a turn"),
    ],
)
def test_a_view_of_another_camera_or_turned_image_is_named(views, change, text):
    found = rejected(mixed(views(10), change, 4))

    assert list(found) == ["v4"]
    assert re.search(text, found["v4"])


def test_a_board_turned_by_half_a_turn_is_as_good_as_any(views, rng):
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


@pytest.mark.parametrize(
    ("indices", "grade"), [((0, 4), Grade.IMPROVABLE), pytest.param((0, 4, 8, 12), Grade.REDO, marks=pytest.mark.slow)]
)
def test_views_of_another_camera_are_named_together(views, indices, grade):
    boards = mixed(views(15), of_longer_lens, *indices)

    finding = other_camera_finding(calibrate_camera(boards, 1600, 1200))

    assert finding.grade is grade
    assert finding.value == pytest.approx(len(indices) / 15)
    assert finding.advice.startswith(f"views {', '.join(f'v{index}' for index in indices)} look like another camera's")
    assert re.search(r"focal length (1\.[89]|2\.[012]) % longer", finding.advice)


def test_a_view_of_the_other_camera_that_was_used_is_named_with_those_left_out(views):
    boards = mixed(views(15), of_longer_lens, 0, 4, 8)
    found = calibrate_camera(boards, 1600, 1200)
    kept = replace(found, views=tuple(replace(one, rejected="") if one.name == "v8" else one for one in found.views))

    assert other_camera_finding(kept).advice.startswith("views v0, v4, v8 look")


@pytest.mark.parametrize(
    ("change", "indices"),
    [(of_longer_lens, ()), (turned, (2, 6)), (of_longer_lens, (3,))],
    ids=["one camera", "turned images", "one view alone"],
)
def test_views_of_one_camera_and_one_view_alone_are_not_taken_for_another_camera(views, change, indices):
    boards = mixed(views(12), change, *indices)
    found = calibrate_camera(boards, 1600, 1200)

    assert other_camera_finding(found).grade is Grade.GOOD
    assert change is not turned or len(found.used) == 10
