"""Dictionaries of markers and the boards that need them."""

import pytest

from ringpose.calibrate.boards.patterns.markers import marker_dictionary
from ringpose.errors import DataError
from ringpose.types.board import Board


def board(kind: str, squares: int, dictionary: str) -> Board:
    return Board(kind=kind, squares_x=squares, squares_y=squares, dictionary=dictionary)


@pytest.mark.parametrize(("kind", "squares", "needed"), [("charuco", 11, 60), ("aruco_grid", 8, 64)])
def test_a_dictionary_with_too_few_markers_for_the_board_is_rejected(kind, squares, needed):
    with pytest.raises(DataError, match=f'"DICT_5X5_50" has 50 markers, the board has {needed}; give a larger'):
        marker_dictionary(board(kind, squares, "DICT_5X5_50"))


@pytest.mark.parametrize(("kind", "squares"), [("charuco", 10), ("aruco_grid", 7), ("four_markers", 1000)])
def test_a_dictionary_with_all_markers_of_the_board_is_accepted(kind, squares):
    assert len(marker_dictionary(board(kind, squares, "DICT_5X5_50")).bytesList) == 50
