"""Stripes as points in space: positions against constructed truth, covariances by sampling."""

from dataclasses import replace

import numpy as np
import pytest
from ring_scenes import line_of_face, make_scene, moved_rig, with_lines
from scipy.stats import chi2

from ringpose.estimate.nuisance import covariance_root
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.geometry.rays import project
from ringpose.geometry.ring import rotation_by
from ringpose.measure.points import stripe_points
from ringpose.types.assumptions import RigStability
from ringpose.types.detection import UNLABELLED, Detection, NoBreakPoints, Stripes
from ringpose.types.options import PoseFrame
from ringpose.types.rig import (
    NO_ROBOT_POSES,
    LaserBow,
    Mount,
    ParameterCovariance,
    camera_parameters,
    laser_parameters,
)

SIGMA_PX = 0.1
EXACT = RigStability()
SIGMAS = {"fx": 0.5, "fy": 0.5, "cx": 0.6, "cy": 0.6, "k1": 2e-4, "k2": 4e-4, "p1": 3e-5, "p2": 3e-5, "k3": 4e-4}
OF_PLANE = (1e-4, 1e-4, 3e-5)


def with_covariance(rig, rng):
    """The rig with a covariance of all its parameters, which are correlated."""
    names = (*camera_parameters(5), *laser_parameters(rig.lasers.names))
    sigma = np.array([*SIGMAS.values(), *OF_PLANE * len(rig.lasers.names)])
    mixed = np.eye(len(names)) + 0.3 * rng.normal(size=(len(names), len(names))) / np.sqrt(len(names))
    root = sigma[:, None] * mixed
    return replace(rig, covariance=ParameterCovariance(parameters=names, data=root @ root.T))


def detection_of(position_px, laser, break_points=NoBreakPoints.NO_RING, sigma_px=SIGMA_PX):
    stripes = Stripes(
        position_px=position_px,
        sigma_px=np.full(len(position_px), sigma_px),
        peak_dn=np.full(len(position_px), 100.0),
        piece=np.arange(len(position_px)),
        laser=np.asarray(laser),
        stamp_s=np.full(len(position_px), 5.0),
    )
    return Detection(shot="a", stamp_s=5.0, break_points=break_points, stripes=stripes)


def point_of(rig, laser, x, z):
    """A point of a light plane by two of its coordinates."""
    normal, distance_m = rig.lasers.normal[laser], rig.lasers.distance_m[laser]
    return np.array([x, (distance_m - normal[0] * x - normal[2] * z) / normal[1], z])


@pytest.fixture
def rng(request):
    return np.random.default_rng(list(request.node.name.encode()))


def nees_of_draws(rig, draws, rng, mount=None):
    """The normalised squared error of one point in each draw of calibration, mount and noise."""
    root, names = covariance_root(rig.covariance.data), rig.covariance.parameters
    frame = PoseFrame.CAMERA if mount is None else PoseFrame.BASE
    nominal = replace(rig, mount=mount)
    nees = []
    for _ in range(draws):
        true_rig = moved_rig(rig, names, root @ rng.normal(size=root.shape[1]))
        laser = int(rng.integers(3))
        point_m = point_of(true_rig, laser, rng.uniform(-0.1, 0.1), rng.uniform(0.4, 0.8))
        position_px = project(point_m[None], true_rig.camera)
        position_px[0, 1] += SIGMA_PX * rng.normal()
        found = stripe_points(detection_of(position_px, [laser]), nominal, EXACT, frame).points
        truth_m = point_m
        if mount is not None:
            error = mount.root @ rng.normal(size=6)
            matrix = mount.carrier_from_camera
            truth_m = rotation_by(error[:3]) @ matrix[:3, :3] @ point_m + matrix[:3, 3] + error[3:]
        off_m = found.position_m[0] - truth_m
        nees.append(off_m @ np.linalg.solve(found.covariance_m2[0], off_m))
    return np.array(nees)


@pytest.mark.parametrize("is_mounted", [False, True], ids=["camera", "base"])
def test_covariances_of_points_hold_for_drawn_calibrations_and_noise(is_mounted, rng):
    draws = 300
    rig = with_covariance(make_scene("B").rig, rng)
    mount = None
    if is_mounted:
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation_by(np.array([0.4, -1.0, 0.3])), [0.5, -0.2, 0.9]
        root = np.diag([2e-4, 3e-4, 1e-4, 1e-4, 2e-4, 1e-4])
        mount = Mount(carrier_from_camera=matrix, root=root, carrier=PoseFrame.BASE)

    nees = nees_of_draws(rig, draws, rng, mount)

    low, high = chi2.ppf([5e-4, 1 - 5e-4], 3 * draws) / draws
    assert low < nees.mean() < high
    assert (nees > chi2.ppf(0.99, 3)).sum() <= 10  # of 300: binomial 99.9 %


def test_points_of_a_rig_that_has_moved_are_not_covered_by_the_noise_alone(rng):
    rig = replace(make_scene("B").rig, covariance=None)
    true_rig = moved_rig(rig, ("left.tilt_1",), (1e-2,))
    point_m = point_of(true_rig, 0, 0.05, 0.6)
    detection = detection_of(project(point_m[None], true_rig.camera), [0])

    exact, unstable = (stripe_points(detection, rig, each) for each in (EXACT, RigStability(plane_tilt_rad=1e-2)))

    off_m = exact.points.position_m[0] - point_m
    along_m = np.linalg.norm(exact.points.noise_m[0])
    assert not exact.calibration_covariance
    assert np.linalg.norm(off_m) > 5 * along_m
    variance = unstable.points.covariance_m2[0]
    direction = off_m / np.linalg.norm(off_m)
    assert np.linalg.norm(off_m) < 3 * np.sqrt(direction @ variance @ direction)


def test_a_point_lies_on_the_bent_sheet_of_its_laser_and_is_as_uncertain_as_its_bow():
    rig = make_scene("B").rig
    name, bow = rig.lasers.names[1], LaserBow(per_rad=0.004, sd_per_rad=1e-3)
    bent = replace(rig, bows={name: bow})
    places_px = np.array([[300.0, 500.0], [800.0, 500.0]])

    points, more, flat = (
        stripe_points(detection_of(places_px, [1, 1]), each, EXACT).points
        for each in (bent, replace(rig, bows={name: replace(bow, per_rad=0.005)}), rig)
    )

    assert np.linalg.norm(points.position_m - flat.position_m, axis=1)[0] > 1e-3
    by_bow = points.covariance_m2 - points.noise_m[:, :, None] * points.noise_m[:, None, :]
    change_m = more.position_m - points.position_m
    np.testing.assert_allclose(by_bow[0], np.outer(change_m[0], change_m[0]), rtol=0.05)
    assert np.linalg.norm(change_m[1]) < 0.01 * np.linalg.norm(change_m[0])


def test_with_all_lasers_on_only_stripes_on_the_face_have_a_laser():
    scene = make_scene("B")
    ends_m = scene.points_m
    on_face_m = 0.5 * (ends_m[:, 0] + ends_m[:, 1])
    beside_m = on_face_m + 0.4 * (ends_m[:, 1] - ends_m[:, 0]) * 5
    position_px = project(np.concatenate([on_face_m, beside_m]), scene.rig.camera)
    ends_px = np.stack([line_of_face(scene, laser) for laser in range(3)])
    found = with_lines(scene.break_points(), ends_px, 0.05)
    detection = detection_of(position_px, 6 * [UNLABELLED], found)

    found = stripe_points(detection, scene.rig, EXACT)

    assert found.points.laser.tolist() == [0, 1, 2]
    assert found.left_out.laser_unknown == 3
    np.testing.assert_allclose(found.points.position_m, on_face_m, rtol=0, atol=1e-7)


def test_without_break_points_no_stripe_of_all_lasers_has_one():
    scene = make_scene("B")

    found = stripe_points(detection_of(scene.position_px.reshape(-1, 2), 6 * [UNLABELLED]), scene.rig, EXACT)

    assert (len(found.points.laser), found.left_out.laser_unknown) == (0, 6)


def test_points_at_whose_time_the_robot_is_nowhere_are_left_out_and_counted():
    scene = make_scene("B")
    mount = Mount(carrier_from_camera=np.eye(4), root=np.zeros((6, 6)))
    camera = CameraMotion(poses=NO_ROBOT_POSES, mount=mount)
    detection = detection_of(scene.position_px.reshape(-1, 2), [0, 0, 1, 1, 2, 2])

    found = stripe_points(detection, scene.rig, EXACT, PoseFrame.BASE, camera)

    assert (len(found.points.laser), found.left_out.no_robot_pose) == (0, 6)


def test_a_ray_that_meets_its_plane_behind_the_camera_gives_no_point():
    scene = make_scene("B")
    rig = replace(scene.rig, lasers=replace(scene.rig.lasers, distance_m=-scene.rig.lasers.distance_m))

    found = stripe_points(detection_of(scene.position_px.reshape(-1, 2), [0, 0, 1, 1, 2, 2]), rig, EXACT)

    assert (len(found.points.laser), found.left_out.no_intersection) == (0, 6)
