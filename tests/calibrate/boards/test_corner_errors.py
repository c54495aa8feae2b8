"""Errors of boards' corners: correlation within a marker, standard deviations by view, errors that views share."""

from dataclasses import replace

import numpy as np
import pytest
from known_views import TRUE_CAMERA, stripe_views, true_poses

from ringpose.calibrate.boards.corner_errors import (
    corner_sigmas_px,
    endpoint_correlation,
    endpoint_for_correlation,
    moderated_variances,
    whiten,
    with_shared_errors,
)
from ringpose.calibrate.boards.pose import board_pose
from ringpose.types.board import BoardView
from ringpose.types.calibration import StripeView


@pytest.mark.parametrize("left_out", [0.02, 0.1])
def test_errors_at_the_ends_of_parabolas_have_the_predicted_correlation(left_out, rng):
    t = np.linspace(left_out, 1 - left_out, 200)
    fitted = np.polynomial.polynomial.polyfit(t, rng.standard_normal((200, 4000)), 2)

    ends = np.polynomial.polynomial.polyval(np.array([0.0, 1.0]), fitted)

    assert np.corrcoef(ends.T)[0, 1] == pytest.approx(endpoint_correlation(left_out), abs=0.05)
    assert endpoint_for_correlation(endpoint_correlation(left_out)) == pytest.approx(1 / (1 - 2 * left_out))


def meeting(first, first_to, second, second_to) -> np.ndarray:
    """Where two lines meet, each through two points; by cross products."""
    lines = [np.cross([*one, 1.0], [*other, 1.0]) for one, other in ((first, first_to), (second, second_to))]
    point = np.cross(*lines)
    return point[:2] / point[2]


@pytest.mark.parametrize("lean", [pytest.param(0.0, marks=pytest.mark.slow), 0.4])
def test_corners_where_moved_sides_meet_become_independent(lean, rng):
    """Each side's ends are moved outwards by numbers of correlation 0.5; corners are where the moved sides meet."""
    corners = 100.0 * np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) @ np.array([[1.0, 0.2], [lean, 1.0]])
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

    view = BoardView(
        name="marker", ids=np.arange(4), points_board_m=np.zeros((4, 3)), points_px=corners, end_correlation=0.5
    )
    independent = whiten(np.array(errors).T, view)

    assert np.cov(independent) == pytest.approx(np.eye(8), abs=0.16)


DEGREES_OF_FREEDOM = np.full(60, 26.0)


def test_views_with_equal_errors_share_one_variance(rng):
    squares = 0.04 * rng.chisquare(DEGREES_OF_FREEDOM)

    moderated = moderated_variances(squares, DEGREES_OF_FREEDOM)

    assert np.ptp(np.log(moderated)) < 0.2 * np.ptp(np.log(squares))
    assert moderated.mean() == pytest.approx(0.04, rel=0.1)


def test_views_that_differ_keep_their_own_variance(rng):
    true = 0.04 * np.exp(rng.normal(0.0, 1.0, 60))

    moderated = moderated_variances(true * rng.chisquare(DEGREES_OF_FREEDOM), DEGREES_OF_FREEDOM)

    assert np.std(np.log(moderated / true)) < 0.4  # of chi-squared of 26 it is 0.28


def test_moderated_variances_err_less_than_the_views_own(rng):
    true = 0.04 * np.exp(rng.normal(0.0, 0.3, 60))
    squares = true * rng.chisquare(DEGREES_OF_FREEDOM)

    errors = [
        np.std(np.log(found / true))
        for found in (moderated_variances(squares, DEGREES_OF_FREEDOM), squares / DEGREES_OF_FREEDOM)
    ]

    assert errors[0] < 0.9 * errors[1]


def test_exact_corners_have_a_variance_above_zero_and_two_views_share_one():
    assert np.all(moderated_variances(np.zeros(4), np.full(4, 20.0)) > 0)
    two = moderated_variances(np.array([1.0, 9.0]), np.array([10.0, 10.0]))
    assert np.ptp(two) == 0.0


SIGMA_PX = 0.02
EXACT_VIEWS, POOR_VIEWS = 5, 4


def with_errors(view: StripeView, errors_px: np.ndarray) -> StripeView:
    return replace(view, board=replace(view.board, points_px=view.board.points_px + errors_px))


def poses_of(views, camera):
    return [board_pose(view.board, camera) for view in views]


@pytest.fixture
def views(rng) -> list[StripeView]:
    """Exact."""
    return stripe_views(true_poses(rng, EXACT_VIEWS + POOR_VIEWS), rng)


def test_views_with_larger_errors_have_larger_standard_deviations(rng, views):
    sizes = SIGMA_PX * np.repeat([1.0, 4.0], [EXACT_VIEWS, POOR_VIEWS])
    seen = [with_errors(view, size * rng.standard_normal((16, 2))) for view, size in zip(views, sizes, strict=True)]

    sigmas = corner_sigmas_px(seen, poses_of(seen, TRUE_CAMERA), TRUE_CAMERA)

    assert sigmas[:EXACT_VIEWS].mean() == pytest.approx(SIGMA_PX, rel=0.2)
    assert sigmas[EXACT_VIEWS:].mean() == pytest.approx(4 * SIGMA_PX, rel=0.2)


@pytest.mark.parametrize(("share", "least", "most"), [(0.0, 1.0, 1.4), (1.0, 1.9, 2.6)])
def test_errors_that_all_views_share_are_not_averaged_out(share, least, most, rng, views):
    """Common and independent errors have half of the variance each: means over nine views have 5 times the variance of
    independent errors."""
    common = share * SIGMA_PX * rng.standard_normal((16, 2))
    seen = [with_errors(view, common + SIGMA_PX * rng.standard_normal((16, 2))) for view in views]
    poses = poses_of(seen, TRUE_CAMERA)
    sigmas = corner_sigmas_px(seen, poses, TRUE_CAMERA)

    wider = with_shared_errors(sigmas, seen, poses, TRUE_CAMERA, shared_parameters=0)

    assert least < wider.mean() / sigmas.mean() < most


def test_views_may_show_different_numbers_of_corners(rng, views):
    """A corner that a single view shows does not contribute to the errors that views have in common."""
    seen = [with_errors(view, SIGMA_PX * rng.standard_normal((16, 2))) for view in views]
    board = seen[0].board
    fewer = replace(board, ids=board.ids[:8], points_board_m=board.points_board_m[:8], points_px=board.points_px[:8])
    seen[0] = replace(seen[0], board=fewer)
    poses = poses_of(seen, TRUE_CAMERA)

    wider = with_shared_errors(
        corner_sigmas_px(seen, poses, TRUE_CAMERA), seen, poses, TRUE_CAMERA, shared_parameters=0
    )

    assert wider.mean() == pytest.approx(SIGMA_PX, rel=0.4)
