"""Distances of stripe centres from light planes in the image, and their derivatives."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

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


def test_a_residual_is_the_distance_in_pixels_from_the_line_that_the_plane_draws(centers_px, pose, true_camera):
    for _ in range(6):
        residual_px = rows_at(centers_px, pose, true_camera).residual_px
        centers_px = centers_px - residual_px[:, None] * uphill(centers_px, pose, true_camera)

    beside = centers_px + 0.5 * uphill(centers_px, pose, true_camera)

    assert np.abs(distances_m(centers_px, pose, NORMAL, DISTANCE_M, true_camera)).max() < 1e-9
    assert np.abs(rows_at(beside, pose, true_camera).residual_px - 0.5).max() < 0.002


@pytest.mark.parametrize("parameter", range(6))
def test_derivatives_by_the_pose_are_those_of_differences(parameter, centers_px, pose, true_camera):
    rows = rows_at(centers_px, pose, true_camera)
    step = 1e-6 * np.eye(6)[parameter]

    ends = [
        distances_m(centers_px, moved_pose(pose, sign * step), NORMAL, DISTANCE_M, true_camera) for sign in (1.0, -1.0)
    ]

    found = (ends[0] - ends[1]) / 2e-6
    assert np.abs(rows.wrt_pose[:, parameter] * rows.metres_per_pixel - found).max() < 1e-6


@pytest.mark.parametrize("parameter", range(3))
def test_derivatives_by_the_plane_are_those_of_differences(parameter, centers_px, pose, true_camera):
    rows = rows_at(centers_px, pose, true_camera)
    step = 1e-6 * np.eye(3)[parameter]

    ends = [
        distances_m(centers_px, pose, tilted(NORMAL, sign * step[:2]), DISTANCE_M + sign * step[2], true_camera)
        for sign in (1.0, -1.0)
    ]

    found = (ends[0] - ends[1]) / 2e-6
    assert np.abs(rows.wrt_plane[:, parameter] * rows.metres_per_pixel - found).max() < 1e-6


@pytest.mark.parametrize("parameter", range(9))
def test_derivatives_by_the_camera_are_those_of_differences(parameter, centers_px, pose, true_camera):
    rows = rows_at(centers_px, pose, true_camera)
    size = 1e-3 if parameter < 4 else 1e-5
    step = size * np.eye(9)[parameter]

    ends = [
        distances_m(
            centers_px,
            pose,
            NORMAL,
            DISTANCE_M,
            camera_with(parameters_of(true_camera) + sign * step, replace(true_camera)),
        )
        for sign in (1.0, -1.0)
    ]

    found = (ends[0] - ends[1]) / (2 * size)
    derivative = rows.wrt_camera[:, parameter] * rows.metres_per_pixel
    assert np.abs(derivative - found).max() < 1e-4 * np.abs(found).max() + 1e-9
