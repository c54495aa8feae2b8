"""A known camera, boards and views of them with stripes, computed by formulas."""

from collections.abc import Sequence

import numpy as np
from drawn_boards import FOUR
from ring_scenes import RIGS

from ringpose.geometry.board import corner_points
from ringpose.geometry.rotations import tilt_basis
from ringpose.types.board import Board, BoardView
from ringpose.types.calibration import PlanesCalibration, StripeView
from ringpose.types.rig import Camera

TRUE_CAMERA = RIGS["B"].camera
NORMALS = np.array([[0.0, np.cos(a), -np.sin(a)] for a in (0.18, 0.0, -0.17)])
DISTANCES_M = np.array([-0.039, -0.070, -0.040])
"""Of the light planes."""

PROJECTOR_M = np.array([0.02, 0.0, 0.0])
"""From which the angles of bent sheets count."""

CHESSBOARD = Board(kind="chessboard", squares_x=12, squares_y=10, square_m=0.025)


def projected_px(points: np.ndarray, camera: Camera = TRUE_CAMERA) -> np.ndarray:
    """The pinhole with radial and tangential distortion of five or eight coefficients, written out."""
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    k1, k2, p1, p2, k3, *others = camera.distortion_coefficients
    k4, k5, k6 = others or (0.0, 0.0, 0.0)
    r2 = x * x + y * y
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    (fx, _, cx), (_, fy, cy), _ = camera.camera_matrix
    return np.stack([fx * u + cx, fy * v + cy], axis=1)


def rotation(vector: Sequence[float]) -> np.ndarray:
    """Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    x, y, z = np.asarray(vector) / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def true_poses(rng: np.random.Generator, number: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Boards 0.4 to 0.6 m away, tilted to all sides, their middle near the optical axis."""
    made = []
    for _ in range(number):
        turn = rotation([*rng.uniform(-0.45, 0.45, 2), rng.uniform(-0.2, 0.2)])
        middle = np.array([*rng.uniform(-0.02, 0.02, 2), rng.uniform(0.4, 0.6)])
        made.append((turn, middle - turn @ np.array([0.15, 0.12, 0.0])))
    return made


def stripe_px(
    turn: np.ndarray, place: np.ndarray, laser: int, camera: Camera = TRUE_CAMERA, bow_per_rad: float = 0.0
) -> np.ndarray:
    """Pixels of the line in which a light plane cuts the board, over the board's width.

    With a bow, rays of the sheet rise over the plane by so much, times the square of their angle about a projector.
    """
    along_x = NORMALS[laser] @ turn[:, 0]
    along_y = NORMALS[laser] @ turn[:, 1]
    x = np.linspace(0.02, 0.28, 200)
    y = (DISTANCES_M[laser] - NORMALS[laser] @ place - along_x * x) / along_y
    axis = np.array([0.0, 0.0, 1.0]) - NORMALS[laser, 2] * NORMALS[laser]
    for _ in range(4 if bow_per_rad else 0):
        point = place + x[:, None] * turn[:, 0] + y[:, None] * turn[:, 1]
        along, aside = ((point - PROJECTOR_M) @ each for each in (axis, np.cross(NORMALS[laser], axis)))
        height = bow_per_rad * np.hypot(along, aside) * np.arctan2(aside, along) ** 2 / np.linalg.norm(axis)
        y += (DISTANCES_M[laser] + height - point @ NORMALS[laser]) / along_y
    return projected_px(place + x[:, None] * turn[:, 0] + y[:, None] * turn[:, 1], camera)


def board_view(
    points_m: np.ndarray,
    pose: tuple[np.ndarray, np.ndarray],
    name: str = "view",
    noise_px: np.ndarray | float = 0.0,
    camera: Camera = TRUE_CAMERA,
) -> BoardView:
    """The view of points on a board at a pose, with noise in pixels."""
    pixels = projected_px(points_m @ pose[0].T + pose[1], camera) + noise_px
    return BoardView(name=name, ids=np.arange(len(points_m)), points_board_m=points_m, points_px=pixels)


def stripe_views(
    board_poses: Sequence[tuple[np.ndarray, np.ndarray]],
    rng: np.random.Generator,
    corner_px: float = 0.0,
    center_px: float = 0.0,
    camera: Camera = TRUE_CAMERA,
    bow_per_rad: Sequence[float] = (0.0, 0.0, 0.0),
) -> list[StripeView]:
    """Views of the four-marker board with three stripes, with noise of corners and stripes in pixels."""
    made = []
    for index, pose in enumerate(board_poses):
        board = board_view(corner_points(FOUR), pose, f"v{index}", corner_px * rng.standard_normal((16, 2)), camera)
        stripes = []
        for laser in range(3):
            stripe = stripe_px(*pose, laser, camera, bow_per_rad[laser])
            stripes.append(stripe + center_px * rng.standard_normal((len(stripe), 1)) * [[0.0, 1.0]])
        made.append(StripeView(board=board, stripes_px=tuple(stripes)))
    return made


def chessboard_views(rng: np.random.Generator, number: int, noise_px: float = 0.05) -> list[BoardView]:
    """Views of a chessboard of 11 x 9 corners."""
    points = corner_points(CHESSBOARD)
    return [
        board_view(points, pose, f"v{index}", noise_px * rng.standard_normal((len(points), 2)))
        for index, pose in enumerate(true_poses(rng, number))
    ]


def plane_errors(
    found: PlanesCalibration, normals: np.ndarray = NORMALS, distances_m: np.ndarray = DISTANCES_M
) -> np.ndarray:
    """Tilts and distance of each true plane as seen from the estimate."""
    errors: list[float] = []
    for laser, normal, distance_m in zip(found.lasers, normals, distances_m, strict=True):
        along = normal @ laser.normal
        errors += [*(tilt_basis(laser.normal) @ normal / along), distance_m * np.sign(along) - laser.distance_m]
    return np.array(errors)
