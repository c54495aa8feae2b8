"""Views of each kind of board, drawn point by point: the print as a function of the place on the board, with a lens."""

import functools
from collections.abc import Callable, Sequence

import cv2
import numpy as np
from known_views import projected_px, rotation
from ring_scenes import make_camera

from ringpose.types.board import Board, BoardMarker

CAMERA = make_camera((480, 360), (520.0, 518.0), (243.0, 176.0), (-0.12, 0.06, 0.0008, -0.0005, 0.0))
SUBPIXELS, BLUR_PX, NOISE_DN = 4, 0.7, 1.5
DARK_DN, LIGHT_DN = 35.0, 205.0

Ink = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Whether there is ink at x, y on the board."""


def disks(spacing_m: float, radius_m: float, columns: int, rows: int, asymmetric: bool) -> Ink:
    """A grid of circles, its first centre one spacing from the board's corner in x and y."""

    def ink(x, y):
        row = np.clip(np.rint(y / spacing_m - 1), 0, rows - 1)
        pitch, shift = (2, row % 2) if asymmetric else (1, 0)
        column = np.clip(np.rint((x / spacing_m - 1 - shift) / pitch), 0, columns - 1)
        return np.hypot(x - spacing_m * (pitch * column + shift + 1), y - spacing_m * (row + 1)) < radius_m

    return ink


def pictures(dictionary: str, number: int, border: int) -> np.ndarray:
    """OpenCV's pictures of the first markers, one pixel a cell: whether there is ink."""
    family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    size = family.markerSize + 2 * border
    return np.array(
        [cv2.aruco.generateImageMarker(family, each, size, borderBits=border) < 128 for each in range(number)]
    )


def april_grid(side_m: float, gap_m: float, columns: int, rows: int) -> Ink:
    """As Kalibr draws it: marker 0 at the lower left, all turned by half a turn, squares of ink at their corners."""
    cells = pictures("DICT_APRILTAG_36h11", columns * rows, 2)[:, ::-1, ::-1]
    pitch_m = side_m + gap_m

    def ink(x, y):
        column, row = np.floor((x - gap_m) / pitch_m).astype(int), np.floor((y - gap_m) / pitch_m).astype(int)
        in_x, in_y = x - gap_m - pitch_m * column, y - gap_m - pitch_m * row
        marker = np.clip(column, 0, columns - 1) + columns * (rows - 1 - np.clip(row, 0, rows - 1))
        cell_x, cell_y = (np.clip((part / side_m * 10).astype(int), 0, 9) for part in (in_x, in_y))
        on_marker = (in_x < side_m) & (in_y < side_m) & (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        in_square = (
            (in_x >= side_m) & (in_y >= side_m) & (column >= -1) & (column < columns) & (row >= -1) & (row < rows)
        )
        return on_marker & cells[marker, cell_y, cell_x] | in_square

    return ink


PLACED = [
    (5, 0.03, 0.03, 0.04, 0.3),
    (17, 0.1, 0.035, 0.05, -0.5),
    (2, 0.17, 0.03, 0.035, 1.2),
    (40, 0.04, 0.1, 0.05, 0.8),
    (33, 0.115, 0.1, 0.035, 0.0),
    (8, 0.175, 0.09, 0.045, -1.9),
    (21, 0.04, 0.165, 0.04, 2.8),
    (49, 0.15, 0.16, 0.05, 0.1),
]
"""Markers of DICT_4X4_50: number, x and y of the middle, side and turn, clockwise on the board."""


def placed_markers(places: Sequence[tuple] = PLACED) -> Ink:
    """Single markers at these places."""
    cells = pictures("DICT_4X4_50", 50, 1)

    def ink(x, y):
        dark = np.zeros(x.shape, dtype=bool)
        for number, middle_x, middle_y, side_m, turn in places:
            right = ((x - middle_x) * np.cos(turn) + (y - middle_y) * np.sin(turn)) / side_m + 0.5
            down = ((y - middle_y) * np.cos(turn) - (x - middle_x) * np.sin(turn)) / side_m + 0.5
            inside = (right > 0) & (right < 1) & (down > 0) & (down < 1)
            dark[inside] = cells[number][(down[inside] * 6).astype(int), (right[inside] * 6).astype(int)]
        return dark

    return ink


def placed_corners(middle_x: float, middle_y: float, side_m: float, turn: float) -> tuple[tuple[float, float], ...]:
    """Clockwise from the marker's own top left."""
    cos, sin = side_m / 2 * np.cos(turn), side_m / 2 * np.sin(turn)
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    return tuple((float(middle_x + a * cos - b * sin), float(middle_y + a * sin + b * cos)) for a, b in signs)


def chessboard(side_m: float, columns: int, rows: int) -> Ink:
    """The square in the board's corner is black."""

    def ink(x, y):
        column, row = np.floor(x / side_m), np.floor(y / side_m)
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        return inside & ((column + row) % 2 == 0)

    return ink


def squares(side_m: float, gap_m: float, columns: int, rows: int) -> Ink:
    """Separate squares, the first in the board's corner."""

    def ink(x, y):
        column, row = np.floor(x / (side_m + gap_m)), np.floor(y / (side_m + gap_m))
        inside = (x - column * (side_m + gap_m) < side_m) & (y - row * (side_m + gap_m) < side_m)
        return inside & (column >= 0) & (column < columns) & (row >= 0) & (row < rows)

    return ink


@functools.cache
def rays() -> np.ndarray:
    """Undistorted directions through the points of all pixels, interpolated between those of the pixels' centres."""
    width, height = CAMERA.image_width, CAMERA.image_height
    pixels = np.stack(np.meshgrid(np.arange(-1.0, width + 1), np.arange(-1.0, height + 1)), axis=-1).reshape(-1, 2)
    seen = pixels
    for _ in range(12):
        directions = (seen - CAMERA.camera_matrix[:2, 2]) / np.diag(CAMERA.camera_matrix)[:2]
        seen = seen + pixels - projected_px(np.column_stack([directions, np.ones(len(seen))]), CAMERA)
    grid = directions.reshape(height + 2, width + 2, 2)
    by_y, by_x = (np.gradient(grid, axis=axis)[1:-1, None, 1:-1, None] for axis in (0, 1))
    # Points of a pixel differ in x and in y, so that edges along rows and columns are drawn to a sixteenth of a pixel.
    coarse, fine = np.arange(SUBPIXELS) / SUBPIXELS - 0.5, (np.arange(SUBPIXELS) + 0.5) / SUBPIXELS**2
    x, y = (
        (offset)[None, :, None, :, None]
        for offset in (coarse[None, :] + fine[:, None], coarse[:, None] + fine[None, :])
    )
    return (grid[1:-1, None, 1:-1, None] + x * by_x + y * by_y).reshape(-1, 2)


def drawn_view(
    ink: Ink, pose: tuple[np.ndarray, np.ndarray], rng: np.random.Generator, light_on_dark: bool = False
) -> np.ndarray:
    """The board with this ink at a pose, on a sheet without end, with blur and noise."""
    turn, place = pose
    x, y = rays().T
    depth = (turn[:, 2] @ place) / (x * turn[0, 2] + y * turn[1, 2] + turn[2, 2])
    offset = [depth * x - place[0], depth * y - place[1], depth - place[2]]
    on_board = [sum(turn[axis, side] * offset[axis] for axis in range(3)) for side in (0, 1)]
    dark = ink(*on_board).reshape(CAMERA.image_height, SUBPIXELS, CAMERA.image_width, SUBPIXELS)
    share = (dark != light_on_dark).mean(axis=(1, 3))
    light = cv2.GaussianBlur(LIGHT_DN + (DARK_DN - LIGHT_DN) * share, (0, 0), BLUR_PX)
    return np.clip(np.rint(light + NOISE_DN * rng.standard_normal(light.shape)), 0, 255).astype(np.uint8)


def tilted_poses(rng: np.random.Generator, outline_m: Sequence[float], views: int) -> list:
    """Boards tilted to all sides that fill most of the image, at distances that differ by a third."""
    middle = np.array([*outline_m, 0.0]) / 2
    fitting_m = max(outline_m[0] / CAMERA.image_width, outline_m[1] / CAMERA.image_height) * CAMERA.camera_matrix[0, 0]
    poses = []
    for number in range(views):
        way = 2 * np.pi * number / views + rng.uniform(0, 0.5)
        turn = rotation([0.5 * np.cos(way), 0.5 * np.sin(way), rng.uniform(-0.15, 0.15)])
        distance_m = fitting_m * rng.uniform(1.3, 1.7)
        shift = 0.05 * distance_m * rng.uniform(-1, 1, 2)
        poses.append((turn, np.array([*shift, distance_m]) - turn @ middle))
    return poses


SYMMETRIC = Board(kind="symmetric_circles", squares_x=9, squares_y=7, spacing_m=0.02)
ASYMMETRIC = Board(kind="asymmetric_circles", squares_x=5, squares_y=9, spacing_in_row_m=0.036)
APRIL = Board(kind="aprilgrid", squares_x=4, squares_y=3, marker_m=0.04, gap_m=0.012, dictionary="DICT_APRILTAG_36h11")
MAP = Board(
    kind="marker_map",
    dictionary="DICT_4X4_50",
    markers=tuple(BoardMarker(id=number, corners_m=placed_corners(*place)) for number, *place in PLACED),
)
SQUARES = Board(kind="separate_squares", squares_x=6, squares_y=5, square_m=0.0127, gap_m=0.0098778)
"""Part of Zhang's target: squares of half an inch, 8 / 9 of an inch apart."""

CHESSBOARD = Board(kind="chessboard", squares_x=9, squares_y=7, square_m=0.02)
CHARUCO = Board(kind="charuco", squares_x=6, squares_y=5, square_m=0.03, marker_m=0.022, dictionary="DICT_4X4_50")
WHITE = [(column, row) for row in range(5) for column in range(6) if (column + row) % 2]
CHARUCO_PLACES = [(n, 0.03 * (x + 0.5), 0.03 * (y + 0.5), 0.022, 0.0) for n, (x, y) in enumerate(WHITE)]
FOUR = Board(kind="four_markers", width_m=0.2, height_m=0.16, marker_m=0.06, margin_m=0.005, dictionary="DICT_4X4_50")
FOUR_PLACES = [
    (n, x, y, 0.06, 0.0) for n, (x, y) in enumerate([(0.035, 0.035), (0.165, 0.035), (0.165, 0.125), (0.035, 0.125)])
]
GRID = Board(kind="aruco_grid", squares_x=4, squares_y=3, marker_m=0.04, gap_m=0.012, dictionary="DICT_4X4_50")
GRID_PLACES = [(n, 0.02 + 0.052 * (n % 4), 0.02 + 0.052 * (n // 4), 0.04, 0.0) for n in range(12)]


def either(first: Ink, second: Ink) -> Ink:
    return lambda x, y: first(x, y) | second(x, y)


KINDS: dict[str, tuple[Board, Ink, tuple[float, float], bool]] = {
    "chessboard": (CHESSBOARD, chessboard(0.02, 9, 7), (0.18, 0.14), False),
    "ChArUco": (CHARUCO, either(chessboard(0.03, 6, 5), placed_markers(CHARUCO_PLACES)), (0.18, 0.15), False),
    "four markers": (FOUR, placed_markers(FOUR_PLACES), (0.2, 0.16), False),
    "marker grid": (GRID, placed_markers(GRID_PLACES), (0.196, 0.144), False),
    "symmetric circles": (SYMMETRIC, disks(0.02, 0.006, 9, 7, False), (0.2, 0.16), False),
    "asymmetric circles": (ASYMMETRIC, disks(0.018, 0.007, 5, 9, True), (0.2, 0.18), False),
    "light circles": (SYMMETRIC, disks(0.02, 0.006, 9, 7, False), (0.2, 0.16), True),
    "marker map": (MAP, placed_markers(), (0.21, 0.2), False),
    "separate squares": (SQUARES, squares(0.0127, 0.0098778, 6, 5), (0.1256, 0.103), False),
    "AprilGrid": (APRIL, april_grid(0.04, 0.012, 4, 3), (0.22, 0.168), False),
}
"""A board file's contents, the ink by formulas of its own, width and height in m, whether the ink is light on dark."""
