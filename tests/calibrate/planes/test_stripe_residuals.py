"""Distances of stripe centres from light planes in the image, and their derivatives."""

import cv2
import numpy as np
import pytest
from known_views import TRUE_CAMERA

from ringpose.calibrate.boards.pose import moved_pose
from ringpose.calibrate.camera.parameters import camera_with, parameters_of
from ringpose.calibrate.planes.stripes.errors import stripe_rays, stripe_residuals
from ringpose.geometry.rays import rays
from ringpose.geometry.rotations import tilted
from ringpose.types.board import BoardPose

NORMAL, DISTANCE_M = np.array([0.02, 0.98, -0.19]) / np.linalg.norm([0.02, 0.98, -0.19]), -0.04


@pytest.fixture
def pose() -> BoardPose:
    rotation = cv2.Rodrigues(np.array([0.3, -0.25, 0.1]))[0]
    return BoardPose(name="b", rotation=rotation, translation_m=np.array([-0.12, -0.1, 0.5]), residual_rms_px=0.0)


@pytest.fixture
def centers_px(rng) -> np.ndarray:
    return np.column_stack([rng.uniform(200, 1400, 30), rng.uniform(500, 900, 30)])


def distances_m(centers_px, pose, normal, distance_m, camera) -> np.ndarray:
    """Distances of the centres on the board from the light plane."""
    found = rays(centers_px, camera)
    board = pose.rotation[:, 2]
    places = (board @ pose.translation_m / (found @ board))[:, None] * found
    return places @ normal - distance_m


def rows_at(centers_px, pose, camera):
    return stripe_residuals(stripe_rays(centers_px, camera), pose, NORMAL, DISTANCE_M)


def uphill(centers_px, pose, camera) -> np.ndarray:
    """Unit vectors in the image along which the distance from the light plane grows most."""
    steps = 1e-3 * np.eye(2)
    ends = [
        [distances_m(centers_px + sign * step, pose, NORMAL, DISTANCE_M, camera) for step in steps] for sign in (1, -1)
    ]
    gradient = np.transpose(np.array(ends[0]) - np.array(ends[1]))
    return gradient / np.linalg.norm(gradient, axis=1, keepdims=True)


def test_a_residual_is_the_distance_in_pixels_from_the_line_that_the_plane_draws(centers_px, pose):
    for _ in range(6):
        residual_px = rows_at(centers_px, pose, TRUE_CAMERA).residual_px
        centers_px = centers_px - residual_px[:, None] * uphill(centers_px, pose, TRUE_CAMERA)

    beside = centers_px + 0.5 * uphill(centers_px, pose, TRUE_CAMERA)

    assert np.abs(distances_m(centers_px, pose, NORMAL, DISTANCE_M, TRUE_CAMERA)).max() < 1e-9
    assert np.abs(rows_at(beside, pose, TRUE_CAMERA).residual_px - 0.5).max() < 0.002


STEPS = {"wrt_pose": np.full(6, 1e-6), "wrt_plane": np.full(3, 1e-6), "wrt_camera": np.repeat([1e-3, 1e-5], [4, 5])}


@pytest.mark.parametrize(("of", "parameter"), [(of, i) for of, steps in STEPS.items() for i in range(len(steps))])
def test_derivatives_are_those_of_differences(of, parameter, centers_px, pose):
    rows = rows_at(centers_px, pose, TRUE_CAMERA)
    size = STEPS[of][parameter]

    ends = []
    for sign in (1.0, -1.0):
        step = {name: np.zeros(len(steps)) for name, steps in STEPS.items()}
        step[of][parameter] = sign * size
        camera = camera_with(parameters_of(TRUE_CAMERA) + step["wrt_camera"], TRUE_CAMERA)
        tilts, shift_m = step["wrt_plane"][:2], step["wrt_plane"][2]
        moved = moved_pose(pose, step["wrt_pose"])
        ends.append(distances_m(centers_px, moved, tilted(NORMAL, tilts), DISTANCE_M + shift_m, camera))

    found = (ends[0] - ends[1]) / (2 * size)
    derivative = getattr(rows, of)[:, parameter] * rows.metres_per_pixel
    limit = 1e-4 * np.abs(found).max() + 1e-9 if of == "wrt_camera" else 1e-6
    assert np.abs(derivative - found).max() < limit
