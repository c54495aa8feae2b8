"""Board poses from exact and noisy corners."""

import numpy as np
import pytest
from drawn_boards import FOUR
from known_views import TRUE_CAMERA, board_view, rotation, true_poses

from ringpose.calibrate.boards.corner_errors import maximum_likelihood_pose
from ringpose.calibrate.boards.pose import board_pose, marker_average_pose
from ringpose.geometry.board import corner_points
from ringpose.geometry.rotations import rotation_vector


@pytest.mark.parametrize("pose_of", [board_pose, marker_average_pose])
def test_exact_corners_give_the_exact_pose(pose_of, rng):
    (pose,) = true_poses(rng, 1)

    found = pose_of(board_view(corner_points(FOUR), pose), TRUE_CAMERA)

    assert np.abs(found.rotation - pose[0]).max() < 1e-6
    assert np.abs(found.translation_m - pose[1]).max() < 1e-6
    assert found.residual_rms_px < 1e-4


def test_noisy_corners_never_flip_the_board(rng):
    points = corner_points(FOUR)
    poses = true_poses(rng, 30)

    found = [board_pose(board_view(points, pose, noise_px=rng.normal(0, 0.3, (16, 2))), TRUE_CAMERA) for pose in poses]

    cosines = [own.rotation[:, 2] @ pose[0][:, 2] for own, pose in zip(found, poses, strict=True)]
    assert min(cosines) > np.cos(0.02)


def test_a_single_marker_that_flips_does_not_turn_the_mean(rng):
    facing = rotation([0.1, 0.0, 0.0]), np.array([0.0, 0.0, 1.5])
    points = corner_points(FOUR)

    found = [
        marker_average_pose(board_view(points, facing, noise_px=rng.normal(0, 0.1, (16, 2))), TRUE_CAMERA)
        for _ in range(20)
    ]

    assert min(own.rotation[:, 2] @ facing[0][:, 2] for own in found) > np.cos(0.12)


def test_errors_of_poses_have_the_covariance_that_is_reported(rng):
    runs, sigma_px = 200, 0.1
    points = corner_points(FOUR)
    (pose,) = true_poses(rng, 1)
    exact, unit = maximum_likelihood_pose(board_view(points, pose), TRUE_CAMERA)
    expected = sigma_px**2 * unit

    normalised = []
    for _ in range(runs):
        found = board_pose(board_view(points, pose, noise_px=rng.normal(0, sigma_px, (16, 2))), TRUE_CAMERA)
        turn = rotation_vector(found.rotation) - rotation_vector(exact.rotation)
        error = np.concatenate([turn, found.translation_m - exact.translation_m])
        normalised.append(error @ np.linalg.solve(expected, error))

    assert np.mean(normalised) == pytest.approx(6, abs=3 * np.sqrt(2 * 6 / runs))
