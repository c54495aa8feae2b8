from dataclasses import replace

import cv2
import numpy as np
import pytest
from whole_records import complete_pose, square

from ringpose.geometry.rotations import tilted
from ringpose.pose.transform import pose_in_frame, with_camera_error
from ringpose.types.pose import RingPose


def rigid(rng):
    matrix = np.eye(4)
    matrix[:3, :3] = cv2.Rodrigues(rng.normal(size=3))[0]
    matrix[:3, 3] = rng.normal(size=3)
    return matrix


def some_pose(rng, **covariances) -> RingPose:
    without = {"covariance": None, "covariance_center_m2": None, "covariance_grasp_m2": None}
    return replace(complete_pose(rng), **without | covariances)


def test_vectors_are_moved_and_radii_stay(rng):
    pose, matrix = some_pose(rng), rigid(rng)

    moved = pose_in_frame(pose, matrix)

    np.testing.assert_allclose(moved.center_m, (matrix @ [*pose.center_m, 1])[:3])
    np.testing.assert_allclose(moved.grasp_m, (matrix @ [*pose.grasp_m, 1])[:3])
    np.testing.assert_allclose(moved.normal, (matrix @ [*pose.normal, 0])[:3])
    assert (moved.radius_inner_m, moved.radius_outer_m, moved.covariance) == (0.567, 0.597, None)


def test_there_and_back_is_the_same(rng):
    pose = some_pose(
        rng, covariance=square(rng, 7), covariance_center_m2=square(rng, 3), covariance_grasp_m2=square(rng, 3)
    )
    matrix = rigid(rng)

    again = pose_in_frame(pose_in_frame(pose, matrix), np.linalg.inv(matrix))

    np.testing.assert_allclose(again.center_m, pose.center_m, atol=1e-12)
    np.testing.assert_allclose(again.covariance, pose.covariance, atol=1e-11)
    np.testing.assert_allclose(again.covariance_center_m2, pose.covariance_center_m2, atol=1e-12)
    np.testing.assert_allclose(again.covariance_grasp_m2, pose.covariance_grasp_m2, atol=1e-12)


@pytest.mark.parametrize("trial", range(5))
def test_covariance_of_normal_and_offset_is_that_of_moved_samples(rng, trial):
    """Planes with small errors, moved one by one, scatter as the moved covariance says."""
    covariance = np.zeros((7, 7))
    covariance[:3, :3] = 1e-10 * square(rng, 3)
    pose, matrix = some_pose(rng, covariance=covariance), rigid(rng)
    count = 2000
    errors = rng.multivariate_normal(np.zeros(3), covariance[:3, :3], count)
    offset = pose.normal @ pose.center_m

    normals = np.array([tilted(pose.normal, error[:2]) for error in errors]) @ matrix[:3, :3].T
    offsets = offset + errors[:, 2] + normals @ matrix[:3, 3]
    moved = pose_in_frame(pose, matrix)

    basis = np.stack([tilted(moved.normal, tilt) - moved.normal for tilt in 1e-6 * np.eye(2)]) * 1e6
    samples = np.column_stack([(normals - moved.normal) @ basis.T, offsets])
    scale = np.sqrt(np.diag(moved.covariance)[:3])
    difference = (np.cov(samples.T) - moved.covariance[:3, :3]) / np.outer(scale, scale)
    assert np.abs(difference).max() < 4 * np.sqrt(2 / (count - 1))


def test_centre_in_the_plane_turns_with_the_basis(rng):
    covariance = np.zeros((7, 7))
    covariance[3:5, 3:5] = square(rng, 2)
    pose, matrix = some_pose(rng, covariance=covariance), rigid(rng)
    basis = np.stack([tilted(pose.normal, tilt) - pose.normal for tilt in 1e-6 * np.eye(2)]) * 1e6

    moved = pose_in_frame(pose, matrix)

    moved_basis = np.stack([tilted(moved.normal, tilt) - moved.normal for tilt in 1e-6 * np.eye(2)]) * 1e6
    in_space = moved_basis.T @ moved.covariance[3:5, 3:5] @ moved_basis
    expected = matrix[:3, :3] @ basis.T @ covariance[3:5, 3:5] @ basis @ matrix[:3, :3].T
    np.testing.assert_allclose(in_space, expected, atol=1e-4)


def test_the_mounts_error_is_that_of_moved_samples(rng):
    """Mounts with small errors move one exact pose; the places scatter as the covariance that is added says."""
    nothing = np.zeros((3, 3))
    pose = some_pose(rng, covariance=np.zeros((7, 7)), covariance_center_m2=nothing, covariance_grasp_m2=nothing)
    root = 1e-4 * rng.normal(size=(6, 6))
    matrix, count = rigid(rng), 4000

    moved = with_camera_error(pose_in_frame(pose, matrix), matrix[:3, 3], root)

    centers, normals = [], []
    for turn in (root @ rng.normal(size=(6, count))).T:
        wrong = matrix.copy()
        wrong[:3, :3] = cv2.Rodrigues(turn[:3])[0] @ matrix[:3, :3]
        wrong[:3, 3] += turn[3:]
        centers.append((wrong @ [*pose.center_m, 1])[:3])
        normals.append(wrong[:3, :3] @ pose.normal)
    basis = np.stack([tilted(moved.normal, tilt) - moved.normal for tilt in 1e-6 * np.eye(2)]) * 1e6
    offsets = np.sum(np.array(normals) * centers, axis=1)
    samples = np.column_stack([(np.array(normals) - moved.normal) @ basis.T, offsets])
    limit = 5 * np.sqrt(2 / (count - 1))
    for found, expected in ((np.array(centers), moved.covariance_center_m2), (samples, moved.covariance[:3, :3])):
        scale = np.sqrt(np.diag(expected))
        assert np.abs((np.cov(found.T) - expected) / np.outer(scale, scale)).max() < limit


def test_an_exact_mount_changes_no_covariance(rng):
    pose = some_pose(rng, covariance=square(rng, 7))

    assert with_camera_error(pose, np.zeros(3), np.zeros((6, 6))) is pose
