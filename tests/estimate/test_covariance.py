"""The covariance of a pose, checked by sampling and by its invariances."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ring_scenes import axes_across, face_points_of, make_scene, moved_rig, turn_between

from ringpose.errors import DataError
from ringpose.pose.closed_form import closed_form_pose as estimate_pose
from ringpose.pose.maximum_likelihood import most_likely_pose
from ringpose.types.options import Method
from ringpose.types.pose import HARMLESS_FLAGS, PoseFlag
from ringpose.types.rig import ParameterCovariance

CAMERA = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
PLANES = tuple(f"{laser}.{what}" for laser in ("left", "middle", "right") for what in ("tilt_1", "tilt_2", "distance"))
SIGMA_PX = {Method.PAPER: 1e-9, Method.PAPER_CONSTRAINED: 0.03}
"""`paper` is linear only for noise that no image has: its plane row is too light to hold the centre in the plane."""
NOISE = pytest.mark.parametrize("method", list(SIGMA_PX))
SAMPLES = pytest.mark.parametrize("samples", [150, pytest.param(2000, marks=pytest.mark.slow)])


def largest_deviation(samples, covariance):
    """Largest deviation from 1 of the eigenvalues of the samples' covariance, whitened by the predicted one."""
    root = np.linalg.cholesky(covariance)
    white = np.linalg.solve(root, np.cov(samples.T)) @ np.linalg.inv(root).T
    return np.abs(np.linalg.eigvalsh(white) - 1.0).max()


def tolerance(samples):
    return 4.0 * np.sqrt(2.0 / (samples - 1))


def parameters_of(pose, normal):
    """The seven parameters of a pose about a given normal."""
    first, second = axes_across(normal)
    tilt = pose.normal / (pose.normal @ normal) - normal
    distance = pose.normal @ pose.center_m
    # the tilt basis turns with the normal, about the line in which both planes meet
    turn = turn_between(normal, pose.normal)
    in_plane = [pose.center_m @ turn @ first, pose.center_m @ turn @ second]
    radii = (pose.radius_inner_m, pose.radius_outer_m)
    return np.array([tilt @ first, tilt @ second, distance, *in_plane, *radii])


def through_another_camera(points, camera, wrong):
    """The stripes' lines as a wrongly known camera straightens them; the pixels as they were taken stay."""

    def moved(straight_px):
        matrix = camera.camera_matrix
        rays = np.concatenate(
            [(straight_px - matrix[:2, 2]) / [matrix[0, 0], matrix[1, 1]], np.ones((len(straight_px), 1))], axis=1
        )
        zero = np.zeros(3)
        taken = cv2.projectPoints(rays, zero, zero, matrix, camera.distortion_coefficients)[0]
        said = wrong.camera_matrix
        for _ in range(20):  # fixed point of the distortion
            again = cv2.projectPoints(rays, zero, zero, said, wrong.distortion_coefficients)[0]
            rays[:, :2] += (taken - again)[:, 0] / [said[0, 0], said[1, 1]]
        return rays[:, :2] * [said[0, 0], said[1, 1]] + said[:2, 2]

    return replace(
        points,
        face_start_undistorted_px=moved(points.face_start_undistorted_px),
        face_end_undistorted_px=moved(points.face_end_undistorted_px),
    )


def correlated(rng):
    """A full covariance of camera and planes: 0.1 px, 1e-4 of distortion, 10 microradians, 3 micrometres."""
    scale = np.array([0.1] * 4 + [1e-4] * 5 + [1e-5, 1e-5, 3e-6] * 3)
    mixed = np.eye(len(scale)) + 0.3 * rng.normal(size=(len(scale), len(scale)))
    return scale[:, None] * (mixed @ mixed.T) * scale


@pytest.fixture
def scene():
    return make_scene("B", distance_m=0.5)


def poses_of_noisy_points(scene, sigma_px, method, samples, rng):
    noisy = [scene.break_points(sigma_px, rng).position_px for _ in range(samples)]
    points = scene.break_points()
    return [estimate_pose(replace(points, position_px=position_px), scene.rig, method) for position_px in noisy]


@NOISE
@SAMPLES
def test_samples_scatter_as_predicted(scene, rng, method, samples):
    sigma_px = SIGMA_PX[method]
    predicted = estimate_pose(scene.break_points(sigma_px), scene.rig, method)

    poses = poses_of_noisy_points(scene, sigma_px, method, samples, rng)

    centers, grasps = (np.array([getattr(pose, name) for pose in poses]) for name in ("center_m", "grasp_m"))
    assert largest_deviation(centers, predicted.covariance_center_m2) < tolerance(samples)
    assert largest_deviation(grasps, predicted.covariance_grasp_m2) < tolerance(samples)


@pytest.mark.parametrize("samples", [400, pytest.param(2000, marks=pytest.mark.slow)])  # eigenvalues of 7 scatter more
def test_samples_of_the_seven_parameters_scatter_as_predicted(scene, rng, samples):
    # little noise: the band's width is known so much better than the centre that its second order shows
    sigma_px = 0.003
    predicted = estimate_pose(scene.break_points(sigma_px), scene.rig)

    poses = poses_of_noisy_points(scene, sigma_px, Method.PAPER_CONSTRAINED, samples, rng)

    values = np.array([parameters_of(pose, predicted.normal) for pose in poses])
    assert largest_deviation(values, predicted.covariance) < tolerance(samples)


@SAMPLES
def test_samples_of_a_wrong_rig_scatter_as_predicted(scene, rng, samples):
    names = CAMERA + PLANES
    known = ParameterCovariance(parameters=names, data=correlated(rng))
    predicted = estimate_pose(scene.break_points(0.03), replace(scene.rig, covariance=known))

    centers = []
    for step in rng.multivariate_normal(np.zeros(len(names)), known.data, size=samples):
        position_px = scene.break_points(0.03, rng).position_px
        wrong = moved_rig(scene.rig, names, step)
        centers.append(estimate_pose(replace(scene.break_points(), position_px=position_px), wrong).center_m)

    assert largest_deviation(np.array(centers), predicted.covariance_center_m2) < tolerance(samples)


@pytest.mark.slow
@pytest.mark.parametrize("samples", [1000])
def test_samples_of_a_wrong_rig_scatter_as_the_likelihood_says(scene, rng, samples):
    names = CAMERA + PLANES
    known = ParameterCovariance(parameters=names, data=correlated(rng))
    predicted = most_likely_pose(face_points_of(scene, 0.03, 0.003), replace(scene.rig, covariance=known)).pose

    poses = []
    for step in rng.multivariate_normal(np.zeros(len(names)), known.data, size=samples):
        wrong = moved_rig(scene.rig, names, step)
        points = through_another_camera(face_points_of(scene, 0.03, 0.003, rng), scene.rig.camera, wrong.camera)
        pose = most_likely_pose(points, replace(wrong, covariance=known)).pose
        if not pose.flags & ~HARMLESS_FLAGS:  # one in 750 looks contradictory by chance: 5 of 1000 is the 99.9 % limit
            poses.append(pose)

    assert len(poses) >= samples - 5
    centers, grasps = (np.array([getattr(pose, name) for pose in poses]) for name in ("center_m", "grasp_m"))
    assert largest_deviation(centers, predicted.covariance_center_m2) < tolerance(samples)
    assert largest_deviation(grasps, predicted.covariance_grasp_m2) < tolerance(samples)


@NOISE
@given(
    distance_m=st.floats(0.25, 1.0),
    turn_rad=st.floats(-0.3, 0.3),
    more=st.lists(st.floats(0.0, 2.0), min_size=12, max_size=12),
)
def test_more_noise_never_shrinks_the_covariance(method, distance_m, turn_rad, more):
    scene = make_scene("B", distance_m=distance_m, turn_rad=turn_rad)
    few = scene.break_points(1e-3)
    added = 1e-6 * np.array(more).reshape(3, 2, 2)[..., None] * np.eye(2)

    less_sure = replace(few, covariance_px2=few.covariance_px2 + added)
    before, after = (estimate_pose(points, scene.rig, method).covariance for points in (few, less_sure))

    assert np.linalg.eigvalsh(after - before)[0] >= -1e-9 * np.linalg.eigvalsh(after)[-1]


@NOISE
def test_an_unsure_rig_never_shrinks_the_covariance(scene, rng, method):
    unsure = replace(scene.rig, covariance=ParameterCovariance(parameters=CAMERA + PLANES, data=correlated(rng)))

    before, after = (estimate_pose(scene.break_points(0.3), rig, method).covariance for rig in (scene.rig, unsure))

    assert np.linalg.eigvalsh(after - before)[0] >= -1e-9 * np.linalg.eigvalsh(after)[-1]


def test_covariance_of_the_center_follows_from_the_seven_parameters(scene):
    pose = estimate_pose(scene.break_points(0.3), scene.rig)
    first, second = axes_across(pose.normal)
    # c = offset n + center_1 e1 + center_2 e2: the tilts turn the centre about the camera
    distance_m = pose.normal @ pose.center_m
    to_center = np.stack(
        [
            distance_m * first - (pose.center_m @ first) * pose.normal,
            distance_m * second - (pose.center_m @ second) * pose.normal,
            pose.normal,
            first,
            second,
        ],
        axis=-1,
    )

    expected = to_center @ pose.covariance[:5, :5] @ to_center.T

    np.testing.assert_allclose(pose.covariance_center_m2, expected, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("missing", ["a break point's", "the rig's"])
def test_without_a_covariance_there_is_none_of_the_pose(scene, missing):
    unknown = ParameterCovariance(parameters=("fx",), data=np.array([[np.nan]]))
    rig = replace(scene.rig, covariance=unknown) if missing == "the rig's" else scene.rig
    points = scene.break_points(0.3)
    if missing == "a break point's":
        points.covariance_px2[1, 0] = np.nan

    pose = estimate_pose(points, rig)

    assert (pose.covariance, pose.covariance_center_m2, pose.covariance_grasp_m2) == (None, None, None)


def test_only_the_unseen_radius_has_no_covariance(scene):
    points = scene.break_points(0.01)
    points.position_px[:, 0] = np.nan

    pose = estimate_pose(points, scene.rig)

    nan_rows = np.isnan(pose.covariance).all(axis=1)
    assert nan_rows.tolist() == [False] * 5 + [True, False]


def test_rig_covariance_of_an_unknown_parameter_is_bad_data(scene):
    rig = replace(scene.rig, covariance=ParameterCovariance(parameters=("upper.tilt_1",), data=np.eye(1)))

    with pytest.raises(DataError, match=r"upper\.tilt_1"):
        estimate_pose(scene.break_points(0.3), rig)


@pytest.mark.slow
@NOISE
@pytest.mark.parametrize("distance_m", [0.25, 0.5, 1.0])
@pytest.mark.parametrize(("rig", "tilt_rad"), [("A", (0.1, -0.1)), ("B", (0.0, 0.2))])
def test_a_center_far_beyond_its_covariance_is_flagged(rng, rig, method, distance_m, tilt_rad):
    scene = make_scene(rig, distance_m=distance_m, tilt_rad=tilt_rad)

    poses = [estimate_pose(scene.break_points(0.3, rng), scene.rig, method) for _ in range(200)]
    unflagged = [pose for pose in poses if PoseFlag.CENTER_WEAK not in pose.flags]
    errors = [pose.center_m - scene.ring.center_m for pose in unflagged]
    squares = [e @ np.linalg.solve(pose.covariance_center_m2, e) for e, pose in zip(errors, unflagged, strict=True)]

    assert max(squares, default=0.0) < 5.0**2
