"""Known cameras, boards and views, computed by formulas."""

import json
from collections.abc import Callable, Sequence

import cv2
import numpy as np
import pytest

from ringpose.calibrate.boards.layout import corner_points
from ringpose.types.board import Board, BoardView
from ringpose.types.calibration import StripeView
from ringpose.types.image import Shot
from ringpose.types.rig import Camera

MATRIX = np.array([[1781.3, 0.0, 803.7], [0.0, 1780.6, 596.2], [0.0, 0.0, 1.0]])
COEFFICIENTS = np.array([-0.105, 0.118, 0.00055, -0.0004, 0.0])
NORMALS = np.array([[0.0, np.cos(a), -np.sin(a)] for a in (0.18, 0.0, -0.17)])
DISTANCES_M = np.array([-0.039, -0.070, -0.040])


def projected_px(points: np.ndarray) -> np.ndarray:
    """The pinhole with radial and tangential distortion, written out."""
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    k1, k2, p1, p2, k3 = COEFFICIENTS
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([MATRIX[0, 0] * u + MATRIX[0, 2], MATRIX[1, 1] * v + MATRIX[1, 2]], axis=1)


def rotation(vector: Sequence[float]) -> np.ndarray:
    """Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    x, y, z = np.asarray(vector) / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def poses(rng: np.random.Generator, number: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Boards 0.4 to 0.6 m away, tilted to all sides, their middle near the optical axis."""
    made = []
    for _ in range(number):
        turn = rotation([*rng.uniform(-0.45, 0.45, 2), rng.uniform(-0.2, 0.2)])
        middle = np.array([*rng.uniform(-0.02, 0.02, 2), rng.uniform(0.4, 0.6)])
        made.append((turn, middle - turn @ np.array([0.15, 0.12, 0.0])))
    return made


def stripe_px(turn: np.ndarray, place: np.ndarray, laser: int, number: int = 200) -> np.ndarray:
    """Pixels of the line in which a light plane cuts the board, over the board's width."""
    along_x = NORMALS[laser] @ turn[:, 0]
    along_y = NORMALS[laser] @ turn[:, 1]
    x = np.linspace(0.02, 0.28, number)
    y = (DISTANCES_M[laser] - NORMALS[laser] @ place - along_x * x) / along_y
    return projected_px(place + x[:, None] * turn[:, 0] + y[:, None] * turn[:, 1])


@pytest.fixture(scope="session")
def true_camera() -> Camera:
    return Camera(
        camera_name="true",
        image_width=1600,
        image_height=1200,
        camera_matrix=MATRIX,
        distortion_model="plumb_bob",
        distortion_coefficients=COEFFICIENTS,
    )


@pytest.fixture(scope="session")
def plane_board() -> Board:
    return Board(
        kind="four_markers", dictionary="DICT_4X4_50", width_m=0.3, height_m=0.24, marker_m=0.06, margin_m=0.01
    )


@pytest.fixture(scope="session")
def rendered_plane_views(shared_data, plane_board) -> list[tuple[Shot, BoardView]]:
    """The rendered shots of the four-marker board, and the board in each; finding it takes most of a second."""
    from ringpose.calibrate.boards.views import board_image, find_board
    from ringpose.files.images.shots import read_shot

    shots = [read_shot(path) for path in sorted((shared_data / "rendered" / "calib_b" / "planes").glob("*.npz"))]
    return [(shot, find_board(board_image(shot), plane_board, shot.name)) for shot in shots]


@pytest.fixture(scope="session")
def board_view() -> Callable[..., BoardView]:
    """Makes the view of points on a board at a pose, with noise in pixels."""

    def view(
        points_m: np.ndarray,
        pose: tuple[np.ndarray, np.ndarray],
        name: str = "view",
        noise_px: np.ndarray | float = 0.0,
    ) -> BoardView:
        pixels = projected_px(points_m @ pose[0].T + pose[1]) + noise_px
        return BoardView(name=name, ids=np.arange(len(points_m)), points_board_m=points_m, points_px=pixels)

    return view


@pytest.fixture(scope="session")
def stripe_views(board_view, plane_board) -> Callable[..., list[StripeView]]:
    """Makes views of the four-marker board with three stripes, with noise of corners and stripes in pixels."""
    points_m = corner_points(plane_board)

    def views(
        board_poses: Sequence[tuple[np.ndarray, np.ndarray]],
        rng: np.random.Generator,
        corner_px: float = 0.0,
        center_px: float = 0.0,
    ) -> list[StripeView]:
        made = []
        for index, pose in enumerate(board_poses):
            board = board_view(points_m, pose, f"v{index}", corner_px * rng.standard_normal((16, 2)))
            stripes = []
            for laser in range(3):
                stripe = stripe_px(*pose, laser)
                stripes.append(stripe + center_px * rng.standard_normal((len(stripe), 1)) * [[0.0, 1.0]])
            made.append(StripeView(board=board, stripes_px=tuple(stripes)))
        return made

    return views


@pytest.fixture(scope="session")
def drawn_board() -> Callable[[Board], np.ndarray]:
    """Draws a board from above, 2 pixels a millimetre, with a white rim of 40 pixels."""

    def drawn(board: Board) -> np.ndarray:
        if board.kind == "chessboard":
            side = round(2000 * board.square_m)
            squares = np.indices((board.squares_y, board.squares_x)).sum(axis=0) % 2 * 255
            face = np.kron(squares, np.ones((side, side))).astype(np.uint8)
        elif board.kind == "charuco":
            dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
            size = (board.squares_x, board.squares_y)
            pattern = cv2.aruco.CharucoBoard(size, board.square_m, board.marker_m, dictionary)
            pattern.setLegacyPattern(board.legacy_pattern)
            side = round(2000 * board.square_m)
            face = pattern.generateImage((size[0] * side, size[1] * side))
        else:
            face = _drawn_markers(board)
        printed = np.pad(face, 40, constant_values=255) * 0.7 + 20
        return np.rint(cv2.GaussianBlur(printed, (0, 0), 1.0)).astype(np.uint8)

    return drawn


def _drawn_markers(board: Board) -> np.ndarray:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    side = round(2000 * board.marker_m)
    if board.kind == "four_markers":
        width, height, near = (round(2000 * size) for size in (board.width_m, board.height_m, board.margin_m))
        right, low = width - near - side, height - near - side
        places = [(near, near), (right, near), (right, low), (near, low)]
    else:
        pitch = side + round(2000 * board.gap_m)
        width = board.squares_x * pitch - round(2000 * board.gap_m)
        height = board.squares_y * pitch - round(2000 * board.gap_m)
        places = [(x * pitch, y * pitch) for y in range(board.squares_y) for x in range(board.squares_x)]
    face = np.full((height, width), 255, np.uint8)
    for number, (x, y) in enumerate(places):
        face[y : y + side, x : x + side] = cv2.aruco.generateImageMarker(dictionary, number, side)
    return face


@pytest.fixture
def rendered_truth(shared_data) -> Callable[[str, np.ndarray], np.ndarray]:
    """True pixels of board points in a rendered calibration view."""
    lines = (shared_data / "rendered" / "calib_b" / "truth.jsonl").read_text().splitlines()
    truths = {truth["view"]: truth for truth in map(json.loads, lines)}

    def pixels(view: str, points_m: np.ndarray) -> np.ndarray:
        turn = rotation(truths[view]["camera_from_board_rvec"])
        return projected_px(points_m @ turn.T + np.array(truths[view]["camera_from_board_tvec_m"]))

    return pixels


@pytest.fixture(scope="session")
def true_poses() -> Callable[[np.random.Generator, int], list[tuple[np.ndarray, np.ndarray]]]:
    """Makes board poses."""
    return poses


@pytest.fixture(scope="session")
def true_planes() -> tuple[np.ndarray, np.ndarray]:
    """Normals and distances of the light planes."""
    return NORMALS, DISTANCES_M


CHESSBOARD = Board(kind="chessboard", squares_x=12, squares_y=10, square_m=0.025)


@pytest.fixture
def chessboard_views(rng, board_view) -> Callable[..., list[BoardView]]:
    """Makes views of a chessboard of 11 x 9 corners with noise."""

    def made(number: int, noise_px: float = 0.05) -> list[BoardView]:
        points = corner_points(CHESSBOARD)
        return [
            board_view(points, pose, f"v{index}", noise_px * rng.standard_normal((len(points), 2)))
            for index, pose in enumerate(poses(rng, number))
        ]

    return made
