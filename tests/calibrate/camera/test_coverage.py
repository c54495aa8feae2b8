"""Coverage of the image by corners, and tilts of the boards, on constructed views."""

import numpy as np
import pytest
from known_views import TRUE_CAMERA, rotation

from ringpose.calibrate.camera.assessment import coverage
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.calibration import CameraCalibration, CameraView


def covered(*views: tuple[np.ndarray, float, float], bad: int = -1):
    """The coverage of views with given pixels, tilt about x, and distance."""
    judged = []
    for index, (points_px, tilt_rad, distance_m) in enumerate(views):
        count, turn = len(points_px), rotation([tilt_rad or 1e-12, 0.0, 0.0])
        place = np.array([0.0, 0.0, distance_m])
        board = BoardView(
            name=f"v{index}", ids=np.arange(count), points_board_m=np.zeros((count, 3)), points_px=points_px
        )
        judged.append(
            CameraView(
                board=board,
                pose=BoardPose(name=board.name, rotation=turn, translation_m=place, residual_rms_px=0.1),
                points_px=points_px,
                residual_px=np.zeros_like(points_px),
                left_out=np.zeros(count, dtype=bool),
                rejected="bad" if index == bad else "",
            )
        )
    calibration = CameraCalibration(camera=TRUE_CAMERA, rms_px=0.1, sigma_px=0.1, views=tuple(judged))
    return coverage(calibration)


def grid_px(left: float, right: float, top: float, bottom: float) -> np.ndarray:
    column, row = np.meshgrid(np.linspace(left, right, 24), np.linspace(top, bottom, 24))
    return np.stack([column.ravel(), row.ravel()], axis=1)


@pytest.mark.parametrize(
    ("left_px", "share", "bare"), [(0, 1.0, ()), (560, None, ("upper left", "left", "lower left"))]
)
def test_regions_without_corners_are_named(left_px, share, bare):
    found = covered((grid_px(left_px, 1599, 0, 1199), 0.0, 0.5))

    assert found.bare_regions == bare
    assert share is None or found.share == share


def test_every_corner_is_counted_once():
    found = covered((grid_px(0, 1599, 0, 1199), 0.0, 0.5), (grid_px(300, 800, 200, 900), 0.0, 0.5))

    assert found.corners.sum() == 2 * 24**2


def test_rejected_views_do_not_count_for_coverage():
    whole, middle = (grid_px(0, 1599, 0, 1199), 0.0, 0.5), (grid_px(600, 1000, 500, 700), 0.0, 0.9)

    found = covered(whole, middle, bad=0)

    assert found.corners.sum() == 24**2
    assert found.distance_m == (0.9,)


def test_tilts_are_the_angles_between_board_and_image_plane_with_their_spread_about_either_axis():
    px = grid_px(0, 100, 0, 100)

    found = covered(*((px, tilt, 0.5) for tilt in (-0.4, -0.2, 0.1, 0.4)))

    along, across = found.tilt_spread_rad
    assert found.tilt_rad == pytest.approx((0.4, 0.2, 0.1, 0.4))
    assert along > 0.3
    assert across == pytest.approx(0.0, abs=1e-9)
