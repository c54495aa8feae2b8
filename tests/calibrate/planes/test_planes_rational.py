"""Boards and light planes with a camera of eight distortion coefficients."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from drawn_boards import FOUR
from known_views import DISTANCES_M, NORMALS, true_poses
from scipy.stats import chi2

from ringpose.calibrate.boards.layout import corner_points
from ringpose.calibrate.camera.parameters import camera_with, parameters_of
from ringpose.calibrate.planes.pipeline import PlanesModel, calibrate_planes
from ringpose.calibrate.planes.quality import calibrated_rig
from ringpose.files.rigs import read_rig, write_rig
from ringpose.geometry.rotations import tilt_basis
from ringpose.types.board import BoardView
from ringpose.types.calibration import StripeView
from ringpose.types.rig import Camera, ParameterCovariance

MODEL = PlanesModel(names=("left", "middle", "right"))
CAMERA = Camera(
    camera_name="wide",
    image_width=1600,
    image_height=1200,
    camera_matrix=np.array([[1181.3, 0.0, 803.7], [0.0, 1180.6, 596.2], [0.0, 0.0, 1.0]]),
    distortion_model="rational_polynomial",
    distortion_coefficients=np.array([0.21, -0.06, 0.0005, -0.0004, 0.004, 0.47, -0.09, 0.01]),
)
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
PRIOR = ParameterCovariance(
    parameters=NAMES,
    data=np.diag(np.array([0.3, 0.3, 0.4, 0.4, 1e-3, 2e-3, 5e-5, 5e-5, 1e-3, 1e-3, 2e-3, 1e-3]) ** 2),
)
CORNER_PX, CENTER_PX = 0.02, 0.1


def rational_px(points: np.ndarray) -> np.ndarray:
    """The rational model, written out."""
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    k1, k2, p1, p2, k3, k4, k5, k6 = CAMERA.distortion_coefficients
    r2 = x * x + y * y
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([1181.3 * u + 803.7, 1180.6 * v + 596.2], axis=1)


@pytest.fixture
def drawn_views(rng):
    """Makes views of boards that the three light planes cross, with noise."""
    points_m = corner_points(FOUR)

    def stripe_px(turn, place, normal, distance_m) -> np.ndarray:
        x = np.linspace(0.02, 0.28, 120)
        y = (distance_m - normal @ place - normal @ turn[:, 0] * x) / (normal @ turn[:, 1])
        exact = rational_px(place + x[:, None] * turn[:, 0] + y[:, None] * turn[:, 1])
        return exact + CENTER_PX * rng.standard_normal((len(x), 1)) * [[0.0, 1.0]]

    def views(number: int) -> list[StripeView]:
        made = []
        for index, (turn, place) in enumerate(true_poses(rng, number)):
            corners = rational_px(points_m @ turn.T + place) + CORNER_PX * rng.standard_normal((16, 2))
            board = BoardView(name=f"v{index}", ids=np.arange(16), points_board_m=points_m, points_px=corners)
            stripes = tuple(stripe_px(turn, place, *plane) for plane in zip(NORMALS, DISTANCES_M, strict=True))
            made.append(StripeView(board=board, stripes_px=stripes))
        return made

    return views


def given(rng) -> Camera:
    """A camera with errors drawn from its covariance."""
    wrong = rng.multivariate_normal(np.zeros(len(NAMES)), PRIOR.data)
    return replace(camera_with(parameters_of(CAMERA) + wrong, CAMERA), covariance=PRIOR)


def errors(found) -> np.ndarray:
    """Camera's parameters and planes' tilts and distances less the true ones."""
    parts = [parameters_of(found.camera) - parameters_of(CAMERA)]
    for laser, normal, distance_m in zip(found.lasers, NORMALS, DISTANCES_M, strict=True):
        along = normal @ laser.normal
        tilts = -tilt_basis(laser.normal) @ normal / along
        parts.append(np.array([*tilts, laser.distance_m - distance_m * np.sign(along)]))
    return np.concatenate(parts)


@pytest.mark.parametrize("free_camera", [False, True])
def test_rig_of_a_rational_camera_comes_back_from_its_file_with_all_its_parameters(
    free_camera, rng, drawn_views, tmp_path
):
    found = calibrate_planes(drawn_views(5), given(rng), replace(MODEL, free_camera=free_camera))

    write_rig(tmp_path / "rig.yaml", calibrated_rig(found))
    rig = read_rig(tmp_path / "rig.yaml")

    assert rig.covariance.parameters[:12] == NAMES
    assert rig.covariance.parameters[12:] == tuple(
        f"{laser}.{what}" for laser in MODEL.names for what in ("tilt_1", "tilt_2", "distance")
    )
    np.testing.assert_allclose(rig.covariance.data, found.covariance.data, rtol=1e-12)
    np.testing.assert_array_equal(rig.camera.distortion_coefficients, found.camera.distortion_coefficients)


def test_true_points_of_a_rational_camera_are_those_of_opencv(rng):
    points = rng.uniform([-0.3, -0.2, 0.4], [0.3, 0.2, 0.6], (50, 3))

    expected, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), CAMERA.camera_matrix, CAMERA.distortion_coefficients
    )

    np.testing.assert_allclose(rational_px(points), expected.reshape(-1, 2), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("free_camera", [False, True])
def test_errors_with_a_rational_camera_are_as_large_as_reported(free_camera, rng, drawn_views):
    """The variances of a free camera may be up to a quarter too large: errors common to all views are never zero."""
    runs = 15
    normalised = []
    for _ in range(runs):
        found = calibrate_planes(drawn_views(6), given(rng), replace(MODEL, free_camera=free_camera))
        error = errors(found)
        normalised.append(error @ np.linalg.solve(found.covariance.data, error))

    low, high = chi2.ppf([0.025, 0.975], 21 * runs)
    assert 0.75 * low < np.sum(normalised) < high
