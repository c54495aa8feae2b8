"""Sizes of markers in images against those of the board file."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_boards import CHARUCO, CHESSBOARD, FOUR, GRID, drawn_board

from ringpose.calibrate.acceptance import marker_size_findings
from ringpose.calibrate.boards.patterns.markers import Markers, marker_layout
from ringpose.calibrate.boards.views import find_board
from ringpose.geometry.board import marker_corners
from ringpose.types.calibration import Grade

MARKED = {"charuco": CHARUCO, "four_markers": FOUR, "aruco_grid": GRID}


@pytest.mark.parametrize("board", [FOUR, *(pytest.param(each, marks=pytest.mark.slow) for each in (CHARUCO, GRID))])
def test_markers_have_their_size_with_a_correct_board_file(board):
    findings = marker_size_findings([find_board(drawn_board(board), board, "true")])

    assert [finding.grade for finding in findings] == [Grade.GOOD]
    assert marker_size_findings([find_board(drawn_board(CHESSBOARD), CHESSBOARD, "without markers")]) == ()


@pytest.mark.parametrize(
    ("drawn", "said"),
    [
        (CHARUCO, replace(CHARUCO, square_m=0.03)),
        (CHARUCO, replace(CHARUCO, marker_m=0.015)),
        (FOUR, replace(FOUR, marker_m=0.05)),
        (GRID, replace(GRID, gap_m=0.02)),
    ],
)
def test_a_wrong_marker_size_advises_to_measure_the_print(drawn, said):
    (finding,) = marker_size_findings([find_board(drawn_board(drawn), said, "wrong")])

    assert finding.grade is Grade.REDO
    assert "times as wide and 1." in finding.advice


def test_a_wrong_board_width_changes_only_the_width_of_the_markers():
    view = find_board(drawn_board(FOUR), replace(FOUR, width_m=0.35), "wide")

    # middles are 0.22 m apart on the print, 0.27 m in the file
    assert view.marker_size_ratio == pytest.approx((0.27 / 0.22, 1.0), abs=0.01)


@pytest.mark.parametrize(("side_px", "ratio"), [(27.0, 1.0), (270.0, 1.0), (27.0, 0.9), (270.0, 0.97)])
def test_a_size_ratio_is_reported_only_beyond_the_bias_of_the_corners(side_px, ratio):
    """Corners of small markers are found up to half a pixel inside, which must not be reported as a wrong size."""
    place = marker_corners(GRID)[..., :2]
    middle = place.mean(axis=1, keepdims=True)
    share = ratio if ratio < 1 else 1 - 0.9 / side_px
    corners_px = 50 + (middle + share * (place - middle)) * side_px / GRID.marker_m
    seen = Markers(ids=np.arange(len(place)), corners_px=corners_px)

    assert marker_layout(GRID, seen).size_ratio == pytest.approx((ratio, ratio), abs=1e-6)
