"""Board poses from exact and noisy corners."""

import numpy as np
import pytest
from drawn_boards import FOUR
from known_views import TRUE_CAMERA, board_view, true_poses

from ringpose.calibrate.boards.corner_errors import maximum_likelihood_pose
from ringpose.calibrate.boards.layout import corner_points
from ringpose.calibrate.boards.pose import board_pose, marker_average_pose, moved_pose


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
    facing = (
        np.array([[1, 0, 0], [0, np.cos(0.1), -np.sin(0.1)], [0, np.sin(0.1), np.cos(0.1)]]),
        np.array([0, 0, 1.5]),
    )
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
        error = _step(exact, found)
        normalised.append(error @ np.linalg.solve(expected, error))

    assert np.mean(normalised) == pytest.approx(6, abs=3 * np.sqrt(2 * 6 / runs))


def test_a_pose_that_is_moved_there_and_back_is_the_same(rng):
    (pose,) = true_poses(rng, 1)
    start = board_pose(board_view(corner_points(FOUR), pose), TRUE_CAMERA)
    step = rng.normal(0, 0.01, 6)

    back = moved_pose(moved_pose(start, step), -step)

    assert np.abs(back.rotation - start.rotation).max() < 1e-12
    assert np.abs(back.translation_m - start.translation_m).max() < 1e-15


def _step(first, second) -> np.ndarray:
    """Difference of two poses' rotation vectors (from the skew part of the logarithm) and translations."""
    return np.concatenate(
        [_vector(second.rotation) - _vector(first.rotation), second.translation_m - first.translation_m]
    )


def _vector(rotation: np.ndarray) -> np.ndarray:
    skew = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    angle = np.arctan2(np.linalg.norm(skew) / 2, (np.trace(rotation) - 1) / 2)
    return skew / np.linalg.norm(skew) * angle
