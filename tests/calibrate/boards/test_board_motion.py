"""A board that moves between the frames of a shot."""

import numpy as np
import pytest
from drawn_boards import FOUR, drawn_board
from recorded_shots import make_shot

from ringpose.calibrate.boards.shots import STILL_PX, board_shift_px
from ringpose.calibrate.boards.views import find_board
from ringpose.types.board import BoardView
from ringpose.types.image import Shot


def shot_of(*images: np.ndarray) -> Shot:
    return make_shot(np.stack(images), [0, 1, 1, 1][: len(images)], period_s=0.1)


@pytest.fixture(scope="module")
def face() -> np.ndarray:
    """The board in the middle of a larger image."""
    return np.pad(drawn_board(FOUR), 60, constant_values=90)


@pytest.fixture(scope="module")
def view(face) -> BoardView:
    """The board as found there."""
    return find_board(face, FOUR, "s")


@pytest.mark.parametrize("pixels", [3, 11, 45])
def test_the_displacement_of_a_moved_board_is_measured(pixels, face, view):
    shot = shot_of(face, face, np.roll(face, pixels, axis=1))

    assert board_shift_px(shot, view, FOUR) == pytest.approx(pixels, abs=0.1)


@pytest.mark.parametrize(
    "change", [lambda lit: lit * 0.4 + 5, lambda lit: lit * 1.5 + 40, lambda lit: np.full_like(lit, 255.0)]
)
def test_other_light_is_not_motion(change, face, view, rng):
    noise = rng.normal(0, 2, face.shape)
    lit = np.rint(np.clip(change(face.astype(float)) + noise, 0, 255)).astype(np.uint8)

    shift_px = board_shift_px(shot_of(face, lit), view, FOUR)

    assert not shift_px > STILL_PX


def test_a_stripe_across_a_corner_is_not_taken_for_motion(face, view):
    lit = face.copy()
    row = round(float(view.points_px[0, 1]))
    lit[row - 3 : row + 4] = 255

    assert board_shift_px(shot_of(face, lit), view, FOUR) < STILL_PX


def test_the_displacement_in_a_single_frame_is_nan(face, view):
    assert np.isnan(board_shift_px(shot_of(face), view, FOUR))
