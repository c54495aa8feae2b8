"""Standard deviations of boards' corners by view, and of what views have in common."""

from dataclasses import replace

import numpy as np
import pytest
from known_views import TRUE_CAMERA, stripe_views, true_poses

from ringpose.calibrate.boards.corner_errors import corner_sigmas_px, with_shared_errors
from ringpose.calibrate.boards.pose import board_pose
from ringpose.types.calibration import StripeView

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


def test_views_with_equal_errors_have_one_standard_deviation(rng, views):
    seen = [with_errors(view, SIGMA_PX * rng.standard_normal((16, 2))) for view in views]

    sigmas = corner_sigmas_px(seen, poses_of(seen, TRUE_CAMERA), TRUE_CAMERA)

    assert np.ptp(sigmas) < 0.25 * sigmas.mean()
    assert sigmas.mean() == pytest.approx(SIGMA_PX, rel=0.15)


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
