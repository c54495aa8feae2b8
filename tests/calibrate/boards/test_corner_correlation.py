"""Correlation of the corner errors of one marker."""

import numpy as np
import pytest

from ringpose.calibrate.boards.corner_errors import endpoint_correlation, endpoint_for_correlation, whiten
from ringpose.types.board import BoardView

SQUARE = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]])


@pytest.mark.parametrize("left_out", [0.02, 0.1])
def test_errors_at_the_ends_of_parabolas_have_the_predicted_correlation(left_out, rng):
    t = np.linspace(left_out, 1 - left_out, 200)
    fitted = np.polynomial.polynomial.polyfit(t, rng.standard_normal((200, 4000)), 2)

    ends = np.polynomial.polynomial.polyval(np.array([0.0, 1.0]), fitted)

    assert np.corrcoef(ends.T)[0, 1] == pytest.approx(endpoint_correlation(left_out), abs=0.05)


@pytest.mark.parametrize("left_out", [0.0, 0.02, 0.1])
def test_the_fitted_length_of_a_side_follows_from_the_correlation_at_its_ends(left_out):
    assert endpoint_for_correlation(endpoint_correlation(left_out)) == pytest.approx(1 / (1 - 2 * left_out))


def view(corners_px: np.ndarray, end_correlation: float) -> BoardView:
    common = {"name": "marker", "ids": np.arange(4), "points_board_m": np.zeros((4, 3))}
    return BoardView(**common, points_px=corners_px, end_correlation=end_correlation)


def meeting(first, first_to, second, second_to) -> np.ndarray:
    """Where two lines meet, each through two points; by cross products."""
    lines = [np.cross([*one, 1.0], [*other, 1.0]) for one, other in ((first, first_to), (second, second_to))]
    point = np.cross(*lines)
    return point[:2] / point[2]


@pytest.mark.parametrize("lean", [0.0, 0.4])
def test_corners_where_moved_sides_meet_become_independent(lean, rng):
    """Each side's ends are moved outwards by numbers of correlation 0.5; corners are where the moved sides meet."""
    corners = SQUARE @ np.array([[1.0, 0.2], [lean, 1.0]])
    along = np.roll(corners, -1, axis=0) - corners
    outwards = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    root = np.linalg.cholesky(np.array([[1.0, 0.5], [0.5, 1.0]]))
    errors = []
    for _ in range(1200):
        moves = 1e-3 * rng.standard_normal((4, 2)) @ root.T
        starts = corners + moves[:, :1] * outwards
        ends = np.roll(corners, -1, axis=0) + moves[:, 1:] * outwards
        met = [meeting(starts[side - 1], ends[side - 1], starts[side], ends[side]) for side in range(4)]
        errors.append((np.array(met) - corners).ravel() / 1e-3)

    independent = whiten(np.array(errors).T, view(corners, 0.5))

    assert np.cov(independent) == pytest.approx(np.eye(8), abs=0.16)


def test_corners_with_independent_errors_are_not_changed(rng):
    rows = rng.standard_normal((8, 3))

    assert whiten(rows, view(SQUARE, 0.0)) is rows
