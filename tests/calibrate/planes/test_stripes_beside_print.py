"""Stripes on the sheet beside the print are used, and those on other surfaces are not."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from known_views import TRUE_CAMERA, stripe_px, stripe_views, true_poses
from recorded_shots import make_shot
from ring_scenes import make_camera

from ringpose.calibrate.planes.pipeline import PlanesModel, calibrate_planes
from ringpose.calibrate.planes.quality import planes_verdict
from ringpose.calibrate.planes.stripes.extraction import stripe_view
from ringpose.geometry.board import corner_points
from ringpose.types.board import Board, BoardView
from ringpose.types.calibration import Grade
from ringpose.types.options import PlanesMethod

CAMERA = make_camera((800, 600), (900.0, 900.0), (399.5, 299.5))
BOARD = Board(kind="chessboard", squares_x=8, squares_y=6, square_m=0.02)
PIXELS_PER_METRE = 900.0 / 0.45
"""The board faces the camera 0.45 m away, the corner of its print at pixel (280, 180)."""
PRINT = np.s_[180:420, 280:600]
SHEET = np.s_[60:540, 160:720]
LIGHT, DARK, TABLE = 120.0, 20.0, 40.0
STRIPE_DN, STRIPE_SD_PX = 90.0, 1.5


def scene(sheet=SHEET, table=TABLE) -> np.ndarray:
    """The board on its sheet before a table, without the lasers."""
    image = np.full((600, 800), table)
    image[sheet] = LIGHT
    squares = np.kron(np.indices((6, 8)).sum(axis=0) % 2, np.ones((40, 40)))
    image[PRINT] = np.where(squares > 0, LIGHT, DARK)
    return image


def light(x_px, rows=np.s_[:], slope=0.0, strength=STRIPE_DN) -> np.ndarray:
    """The light of an upright stripe in these rows."""
    image, y = np.zeros((600, 800)), np.arange(600.0)[:, None]
    image[rows] = strength * np.exp(-0.5 * ((np.arange(800.0) - x_px - slope * (y - 300)) / STRIPE_SD_PX) ** 2)[rows]
    return image


def stripes_of(ambient, lit, rng, *, subtracted, surround_m=None):
    """The view of a shot of this scene, with a frame with the lasers off or without."""
    frames = np.stack([ambient, ambient + lit] if subtracted else [ambient + lit])
    blurred = np.stack([cv2.GaussianBlur(frame, (0, 0), 0.8) for frame in frames])
    images = np.clip(np.rint(blurred + rng.standard_normal(frames.shape)), 0, 255).astype(np.uint8)
    points_m = corner_points(BOARD)
    points_px = points_m[:, :2] * PIXELS_PER_METRE + [279.5, 179.5]
    board = BoardView(name="b", ids=np.arange(len(points_m)), points_board_m=points_m, points_px=points_px)
    shot = make_shot(images, [0, 1] if subtracted else [1])
    return stripe_view(shot, board, BOARD, CAMERA, ["red"], surround_m)


@pytest.mark.parametrize("subtracted", [True, False])
def test_a_stripe_beside_the_print_is_followed_to_the_rim_of_the_sheet(subtracted, rng):
    view = stripes_of(
        scene(), light(660, np.s_[60:540], 0.05) + light(668, np.s_[:60], 0.05), rng, subtracted=subtracted
    )

    (stripe,) = view.stripes_px
    assert view.remarks == ()
    assert len(stripe) > 420
    assert 60 < stripe[:, 1].min() < 80
    assert np.abs(stripe[:, 0] - 660 - 0.05 * (stripe[:, 1] - 300)).max() < 0.5


@pytest.mark.parametrize("subtracted", [True, False])
def test_a_stripe_across_the_print_is_followed_beyond_it_but_not_over_the_rim_of_the_sheet(subtracted, rng):
    view = stripes_of(
        scene(), light(420, np.s_[60:540], 0.1) + light(426, np.s_[540:], 0.1), rng, subtracted=subtracted
    )

    (stripe,) = view.stripes_px
    assert np.ptp(stripe[:, 1]) > 440
    assert np.abs(stripe[:, 0] - 420 - 0.1 * (stripe[:, 1] - 300)).max() < 0.5


@pytest.mark.parametrize("subtracted", [True, False])
@pytest.mark.parametrize(
    ("sheet", "table", "lit"),
    [
        (np.s_[60:540, 160:640], TABLE, light(700)),  # on the table beside the sheet
        (np.s_[60:540, 160:640], TABLE, light(640, slope=0.0)),  # along the edge of the sheet
        (np.s_[60:540, 160:640], LIGHT, light(700)),  # on a table as light as the sheet, whose edge is dark
    ],
    ids=["table", "edge", "light table"],
)
def test_light_on_another_surface_is_not_taken_for_the_stripe_on_the_board(sheet, table, lit, subtracted, rng):
    ambient = scene(sheet, table)
    if table == LIGHT:
        ambient[57:60, 157:643] = ambient[540:543, 157:643] = DARK
        ambient[57:543, 157:160] = ambient[57:543, 640:643] = DARK
    view = stripes_of(ambient, lit, rng, subtracted=subtracted)

    assert [len(px) for px in view.stripes_px] == [0]
    (remark,) = view.remarks
    assert "beside it, past an edge or a mark in the image" in remark
    assert "--surround" in remark


def test_glare_on_the_sheet_is_not_taken_for_a_stripe(rng):
    y, x = np.mgrid[:600, :800]
    spot = 160.0 * np.exp(-0.5 * (((x - 660) / 12) ** 2 + ((y - 300) / 40) ** 2))

    view = stripes_of(scene(), spot, rng, subtracted=True)

    assert [len(px) for px in view.stripes_px] == [0]


def test_two_stripes_beside_the_print_for_one_laser_are_reported(rng):
    view = stripes_of(scene(), light(640) + light(690), rng, subtracted=True)

    assert [len(px) for px in view.stripes_px] == [0]
    assert "more stripes on the board" in view.remarks[0]


def test_a_given_width_of_the_sheet_counts_whatever_the_image_shows(rng):
    def centres(surround_m):
        return len(stripes_of(scene(), light(660), rng, subtracted=True, surround_m=surround_m).stripes_px[0])

    assert centres(0.0) == 0
    assert centres(0.02) == 0  # to pixel 640
    assert centres(0.06) > 200


def calibrated(poses, height_m, print_m, rng, method=PlanesMethod.JOINT):
    """The planes of boards whose stripes lie on a surface behind the print, as far as they are beside it."""
    views = []
    for view, (turn, place) in zip(stripe_views(poses, rng, 0.02, 0.0), poses, strict=True):
        stripes = []
        for laser, own in enumerate(view.stripes_px):
            behind = stripe_px(turn, place + height_m * turn[:, 2], laser)
            beside = np.linspace(0.02, 0.28, len(own)) > print_m
            shown = np.where(beside[:, None], behind, own)
            stripes.append(shown + 0.05 * rng.standard_normal((len(shown), 1)) * [[0.0, 1.0]])
        views.append(replace(view, stripes_px=tuple(stripes), print_m=(print_m, 1.0)))
    return calibrate_planes(views, TRUE_CAMERA, PlanesModel(names=("left", "middle", "right"), method=method))


def sheet_check(calibration):
    (found,) = [check for check in planes_verdict(calibration).findings if check.name == "sheet_height_m"]
    return found


@pytest.mark.parametrize("print_m", [0.0, 0.1])
@pytest.mark.parametrize(
    ("height_m", "grade"),
    [(0.0, Grade.GOOD), (4e-3, Grade.REDO), pytest.param(-4e-3, Grade.REDO, marks=pytest.mark.slow)],
)
def test_the_height_of_a_surface_behind_the_print_is_estimated_and_graded(height_m, grade, print_m, rng):
    calibration = calibrated(true_poses(rng, 5), height_m, print_m, rng)

    found_m, sd_m = calibration.sheet_height_m
    found = sheet_check(calibration)
    assert abs(found_m - height_m) < max(4 * sd_m, 0.3 * abs(height_m))  # robust weights see a part of a large step
    assert found.grade is grade
    if grade is Grade.REDO:
        assert f"mm {'behind' if height_m > 0 else 'in front of'} it, on another surface" in found.advice


@pytest.mark.parametrize(
    ("method", "depths_m"), [(PlanesMethod.JOINT, (0.5, 0.53)), (PlanesMethod.TOTAL_LEAST_SQUARES, (0.4, 0.6))]
)
def test_a_height_that_the_boards_or_the_method_do_not_determine_is_not_graded_good(method, depths_m, rng):
    facing = [(np.eye(3), np.array([-0.15, -0.12, depth_m])) for depth_m in depths_m]

    found = sheet_check(calibrated(facing, 5e-3, 0.0, rng, method))

    assert found.grade is Grade.IMPROVABLE
    assert "not determined" in found.advice


def test_boards_with_stripes_on_the_print_alone_have_no_sheet_to_check(rng):
    facing = [(np.eye(3), np.array([-0.15, -0.2, depth_m])) for depth_m in (0.4, 0.5, 0.6)]

    verdict = planes_verdict(calibrated(facing, 0.0, 0.3, rng))

    assert "sheet_height_m" not in [check.name for check in verdict.findings]
