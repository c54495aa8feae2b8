"""Light planes from images of boards that are drawn here, where stripes cross black and white."""

import cv2
import numpy as np
import pytest
from calibrated import chi_squared
from drawn_boards import drawn_board
from known_views import plane_errors
from recorded_shots import make_shot
from ring_scenes import make_camera

from ringpose.calibrate.boards.views import find_board
from ringpose.calibrate.planes.pipeline import PlanesModel, calibrate_planes
from ringpose.calibrate.planes.stripes.extraction import stripe_view
from ringpose.types.board import Board
from ringpose.types.image import Shot

MODEL = PlanesModel(names=("left", "middle", "right"), order=(2, 1, 0))
FOCAL_PX, MIDDLE_PX = (889.0, 888.5), (402.3, 297.6)
CAMERA = make_camera((800, 600), FOCAL_PX, MIDDLE_PX)
CHESSBOARD = Board(kind="chessboard", squares_x=11, squares_y=7, square_m=0.024)
CHARUCO = Board(kind="charuco", squares_x=11, squares_y=7, square_m=0.024, marker_m=0.0175, dictionary="DICT_5X5_100")
FOUR_MARKERS = Board(
    kind="four_markers", dictionary="DICT_4X4_50", width_m=0.28, height_m=0.18, marker_m=0.05, margin_m=0.01
)
NORMALS = np.array([[0.0, np.cos(a), -np.sin(a)] for a in (0.09, 0.0, -0.09)])
DISTANCES_M = np.array([-0.045, -0.04, -0.045])
PIXELS_PER_METRE = 2000.0
"""Reflectance of the board, seen from above."""
RIM_PX = 40
SUBPIXELS = 2
SHEET_M = 0.0004
"""Standard deviation of a light sheet's thickness."""
SPECKLE = 0.15
GRAIN_PX = 1.2


def drawn_shot(drawn, rng, stand, name) -> Shot:
    """A dark frame and one of all lasers: light on black and white, speckle, blur, noise, whole numbers."""
    turn, place = stand
    x = ((fine(800) - MIDDLE_PX[0]) / FOCAL_PX[0])[None, :].astype(np.float32)
    y = ((fine(600) - MIDDLE_PX[1]) / FOCAL_PX[1])[:, None].astype(np.float32)

    def along(direction):
        return float(direction[0]) * x + float(direction[1]) * y + float(direction[2])

    depth_m = float(turn[:, 2] @ place) / along(turn[:, 2])
    on_board = [
        (depth_m * along(turn[:, axis]) - float(turn[:, axis] @ place)) * PIXELS_PER_METRE + RIM_PX - 0.5
        for axis in range(2)
    ]
    reflectance = cv2.remap(drawn, *on_board, cv2.INTER_LINEAR) / 255.0
    sheets = [
        np.exp(-0.5 * ((depth_m * along(n) - float(d)) / SHEET_M) ** 2)
        for n, d in zip(NORMALS, DISTANCES_M, strict=True)
    ]
    grain = cv2.GaussianBlur(rng.standard_normal((600, 800), np.float32), (0, 0), GRAIN_PX)
    speckle = cv2.resize(np.clip(1 + SPECKLE * grain / grain.std(), 0.2, None), depth_m.shape[::-1])
    lit = (60 + 220 * np.sum(sheets, axis=0) * speckle) * reflectance
    images = np.stack([noisy(60 * reflectance, rng), noisy(lit, rng)])
    return make_shot(images, [0, 7], name=name, exposure_s=1.0)


def fine(pixels: int) -> np.ndarray:
    """Centres of sub-pixels."""
    return (np.arange(pixels * SUBPIXELS) + 0.5) / SUBPIXELS - 0.5


def noisy(light_dn: np.ndarray, rng) -> np.ndarray:
    """Blurred, summed over the pixels; 40 electrons a grey value."""
    seen = cv2.resize(cv2.GaussianBlur(light_dn, (0, 0), 0.8 * SUBPIXELS), (800, 600), interpolation=cv2.INTER_AREA)
    noise = np.sqrt(seen / 40 + 0.5) * rng.standard_normal(seen.shape, np.float32)
    return np.clip(np.rint(seen + noise + 2), 0, 255).astype(np.uint8)


def board_stand(rng, width_m, height_m):
    """A board 0.45 to 0.6 m away, under the stripes."""
    turn = cv2.Rodrigues(np.array([*rng.uniform(-0.35, 0.35, 2), rng.uniform(-0.15, 0.15)]))[0]
    middle = np.array([rng.uniform(-0.01, 0.01), rng.uniform(-0.045, -0.035), rng.uniform(0.45, 0.6)])
    return turn, middle - turn @ [width_m / 2, height_m / 2, 0.0]


def nees(found) -> float:
    error = plane_errors(found, NORMALS, DISTANCES_M)
    return float(error @ np.linalg.solve(found.covariance.data, error))


@pytest.mark.slow
@pytest.mark.parametrize("board", [CHESSBOARD, CHARUCO, FOUR_MARKERS], ids=lambda board: board.kind)
def test_errors_of_planes_from_images_are_as_large_as_reported(board, rng):
    """NEES of the three kinds of boards together within its 95 % interval."""
    runs = 8
    drawn = drawn_board(board)
    size_m = (np.array(drawn.shape)[::-1] - 2 * RIM_PX) / PIXELS_PER_METRE

    normalised = []
    for _ in range(runs):
        stands = [board_stand(rng, *size_m) for _ in range(6)]
        shots = [drawn_shot(drawn, rng, stand, str(k)) for k, stand in enumerate(stands)]
        boards = [find_board(shot.images[0], board, shot.name) for shot in shots]
        views = [stripe_view(shot, seen, board, CAMERA, "abc") for shot, seen in zip(shots, boards, strict=True)]
        normalised.append(nees(calibrate_planes(views, CAMERA, MODEL)))

    low, high = chi_squared([0.025 / 3, 1 - 0.025 / 3], 9 * runs)
    assert low < np.sum(normalised) < high
