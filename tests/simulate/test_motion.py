"""Motion of the target: free bodies against closed forms, and moving shots against their truth."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import ellipj

from ringpose.errors import DataError
from ringpose.geometry.rays import project
from ringpose.geometry.ring import predicted_break_points, ring_arcs
from ringpose.simulate.motion import FreeAttitude, PosePath, velocities
from ringpose.simulate.pipeline import SceneFrames, illuminated_ring, simulate
from ringpose.simulate.placement import ring_views, target_placement
from ringpose.simulate.renderer import blur_px, layers, pixel_rays
from ringpose.types.scene import Light, RingView
from ringpose.types.target import MATERIALS, MOTION_PRESETS, Body, FreeMotion, TimedPoses

STRESS_RAD_S = np.array(MOTION_PRESETS["stress"].angular_velocity_rad_s)
TEN_MINUTES_S = 600.0


@pytest.mark.parametrize("axial", [0.4, 1.9], ids=["prolate", "oblate"])
def test_an_axisymmetric_body_precesses_about_its_momentum(axial):
    """R(t) = exp([h/A] t) exp([z] (1 - C/A) w_z t) with the momentum h and the moments A, A, C."""
    attitude = FreeAttitude(np.diag([1.0, 1.0, axial]), STRESS_RAD_S, 60.0)
    momentum = STRESS_RAD_S * [1.0, 1.0, axial]

    for time_s in (0.0, 7.3, 60.0):
        spin = Rotation.from_rotvec([0.0, 0.0, (1 - axial) * STRESS_RAD_S[2] * time_s])
        expected = (Rotation.from_rotvec(momentum * time_s) * spin).as_matrix()
        np.testing.assert_allclose(attitude.at(time_s)[0], expected, atol=1e-10)


def test_a_general_body_follows_jacobis_elliptic_functions():
    """Landau and Lifshitz, Mechanics, section 37: I1 < I2 < I3 and M^2 > 2 E I2."""
    first, second, third = moments = np.array([1.0, 1.7, 2.3])
    start = np.array([0.05, 0.0, 0.12])
    energy2, momentum2 = moments @ start**2, (moments**2) @ start**2
    assert momentum2 > energy2 * second
    shorter, longer = momentum2 - energy2 * first, energy2 * third - momentum2
    modulus2 = (second - first) * longer / ((third - second) * shorter)
    rate = np.sqrt((third - second) * shorter / (first * second * third))
    attitude = FreeAttitude(np.diag(moments), start, TEN_MINUTES_S)

    for time_s in (3.0, 100.0, TEN_MINUTES_S):
        sn, cn, dn, _ = ellipj(rate * time_s, modulus2)
        expected = [
            np.sqrt(longer / (first * (third - first))) * cn,
            np.sqrt(longer / (second * (third - second))) * sn,
            np.sqrt(shorter / (third * (third - first))) * dn,
        ]
        np.testing.assert_allclose(attitude.at(time_s)[1], expected, atol=1e-10)


def test_energy_and_momentum_are_kept_over_ten_minutes_at_eight_degrees_a_second():
    inertia = np.array([[3000.0, 120.0, -60.0], [120.0, 2500.0, 40.0], [-60.0, 40.0, 1200.0]])
    attitude = FreeAttitude(inertia, STRESS_RAD_S, TEN_MINUTES_S)
    momentum, energy = inertia @ STRESS_RAD_S, STRESS_RAD_S @ inertia @ STRESS_RAD_S

    for time_s in np.linspace(0.0, TEN_MINUTES_S, 60):
        rotation, rate = attitude.at(time_s)
        np.testing.assert_allclose(rotation @ inertia @ rate, momentum, atol=1e-9 * np.linalg.norm(momentum))
        assert rate @ inertia @ rate == pytest.approx(energy, rel=1e-9)


def test_times_beyond_the_computed_motion_are_errors():
    with pytest.raises(DataError, match="computed"):
        FreeAttitude(np.eye(3), STRESS_RAD_S, 1.0).at(1.1)


@pytest.fixture
def moving(scene):
    """A target that turns about a point behind the ring and drifts, seen by a camera that moves too."""
    camera = TimedPoses(
        time_s=np.array([0.0, 0.5, 1.0]),
        position_m=np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.02], [0.0, 0.01, 0.05]]),
        orientation_xyzw=Rotation.from_rotvec([[0.0, 0, 0], [0, 0.01, 0], [0.01, 0.02, 0]]).as_quat(),
    )
    motion = FreeMotion(
        inertia_kg_m2=np.diag([3.0, 2.5, 1.5]),
        center_of_mass_m=np.array([0.02, 0.01, -0.5]),
        angular_velocity_rad_s=np.radians([3.0, -2.0, 3.5]),
        velocity_m_s=np.array([0.03, 0.03, -0.026]),
        camera=camera,
    )
    return replace(scene, motion=motion, shots=2, period_s=0.3)


def test_the_centre_of_mass_moves_in_a_straight_line_and_keeps_its_place_in_the_body(moving):
    still_camera = replace(moving, motion=replace(moving.motion, camera=None))
    first, second = ring_views(still_camera)
    mass_m = moving.motion.center_of_mass_m

    start, later = (
        target_placement(still_camera, view, time_s).points_camera(mass_m)
        for view, time_s in ((first, 0.0), (second, 0.1))
    )

    np.testing.assert_allclose(later - start, 0.4 * moving.motion.velocity_m_s, atol=1e-12)


def test_a_moving_camera_sees_the_target_from_its_waypoints(moving):
    alone = replace(moving, motion=replace(moving.motion, camera=None))
    (_, seen), (_, world) = ring_views(moving), ring_views(alone)
    inertial_from_camera = PosePath(moving.motion.camera).camera_from_target(0.5)

    in_camera = target_placement(moving, seen, 0.2).points_camera(np.zeros(3))

    expected = target_placement(alone, world, 0.2).points_camera(np.zeros(3))
    np.testing.assert_allclose(inertial_from_camera[0] @ in_camera + inertial_from_camera[1], expected, atol=1e-12)
    np.testing.assert_allclose(inertial_from_camera[1], [0.0, 0.0, 0.02], atol=1e-12)


def test_velocities_are_the_derivatives_of_the_path(moving):
    """Without a moving camera: v + w x r of a rigid body, with the angular velocity of Euler's equations."""
    (view, *_) = ring_views(replace(moving, motion=replace(moving.motion, camera=None)))
    motion, point_m = moving.motion, np.array([0.1, -0.3, 0.06])
    rotation, _ = view.path.camera_from_target(0.2)
    turned, rate = FreeAttitude(motion.inertia_kg_m2, motion.angular_velocity_rad_s, 1.0).at(0.2)
    start, _ = view.path.camera_from_target(0.0)
    expected_rate = start @ turned @ rate

    velocity_m_s, rate_rad_s = velocities(view.path, 0.2, point_m)

    arm_m = rotation @ (point_m - motion.center_of_mass_m)
    np.testing.assert_allclose(rate_rad_s, expected_rate, atol=1e-9)
    np.testing.assert_allclose(velocity_m_s, motion.velocity_m_s + np.cross(expected_rate, arm_m), atol=1e-9)


def test_the_truth_of_a_moving_shot_has_pose_and_break_points_at_each_mid_exposure(moving):
    """The break points of each frame against the closed form of `geometry.ring` at the pose of that frame."""
    planes = moving.rig.lasers

    for (shot, truth), view in zip(simulate(moving), ring_views(moving), strict=True):
        middles_s = shot.stamp_s + shot.exposure_s / 2
        np.testing.assert_array_equal([frame.stamp_s for frame in truth.frames], middles_s)
        assert truth.stamp_s == middles_s[1]
        for frame, mask, middle_s in zip(truth.frames, shot.lasers, middles_s - shot.stamp_s[0], strict=True):
            placement = target_placement(moving, view, float(middle_s))
            np.testing.assert_allclose(frame.center_m, placement.points_camera(np.array([0.0, 0.0, 0.06])), atol=1e-7)
            if not mask:
                assert frame.break_points_px is None
                continue
            arcs = ring_arcs(frame.center_m, frame.normal, np.array([0.567, 0.597]), np.array([0.0, 0.0, 0.5]))
            points = predicted_break_points(arcs, planes.normal, planes.distance_m)
            expected_px = project(points, moving.rig.camera)
            for laser in range(3):
                if mask >> laser & 1:
                    np.testing.assert_allclose(frame.break_points_px[laser], expected_px[laser], atol=1e-8)
                    if mask.bit_count() == 1:
                        np.testing.assert_array_equal(truth.break_points_px[laser], frame.break_points_px[laser])
                else:
                    assert np.isnan(frame.break_points_px[laser]).all()


def test_stripes_of_a_moving_target_lie_where_the_truth_of_their_frame_has_them(moving, clean_scene):
    """The end of each stripe in its own frame; without motion it would be up to 2 px elsewhere."""
    clean = replace(clean_scene, motion=moving.motion, period_s=0.3, sequence=(0, 1, 2, 4))
    fast = replace(clean, motion=replace(moving.motion, velocity_m_s=np.array([0.3, 0.0, 0.0])), exposure_s=0.001)
    dark = replace(MATERIALS["black"], diffuse=0.0)
    fast = replace(fast, body=replace(fast.body, material=dark), ring=replace(fast.ring, wall=dark))
    still = replace(fast, motion=None)
    ((shot, truth),), ((_, unmoved),) = simulate(fast), simulate(still)

    for laser in range(3):
        (inner, outer) = truth.break_points_px[laser]
        rows = slice(int(outer[1]) - 2, int(outer[1]) + 4)
        profile = shot.images[1 + laser].astype(float)[rows].sum(axis=0)
        columns = np.arange(int(inner[0]) + 4, int(outer[0]) - 3)
        level = profile[columns].mean()
        dark = profile[int(outer[0]) + 4 : int(outer[0]) + 8].mean()
        beyond = (profile[int(outer[0]) - 3 : int(outer[0]) + 5] - dark).sum() / (level - dark)
        assert int(outer[0]) - 3.5 + beyond == pytest.approx(outer[0], abs=0.5)
    assert np.abs(truth.break_points_px - unmoved.break_points_px).max() > 1.0


def test_shots_of_a_still_target_are_marked(scene, moving):
    ((still, _),), ((moved, _), _) = simulate(scene), simulate(moving)

    assert still.meta["still"] is True
    assert "still" not in moved.meta


def test_a_period_shorter_than_a_shot_is_an_error(moving):
    with pytest.raises(DataError, match="period_s"):
        next(simulate(replace(moving, period_s=0.005)))


def test_the_simulated_camera_shows_the_motion_within_a_moment(moving):
    frames = SceneFrames(moving)
    ((shot, _), _) = simulate(moving)

    taken = [frames(0, int(mask)).image for mask in shot.lasers]

    np.testing.assert_array_equal(taken, shot.images)


def test_a_path_through_poses_passes_them_and_ends_with_them():
    poses = TimedPoses(
        time_s=np.array([0.0, 1.0, 3.0]),
        position_m=np.array([[0.0, 0, 1], [0.1, 0, 1], [0.2, 0.3, 0.9]]),
        orientation_xyzw=Rotation.from_rotvec([[0.0, 0, 0], [0, 0, 0.3], [0.2, 0, 0.5]]).as_quat(),
    )
    path = PosePath(poses)

    for time_s, position_m in zip(poses.time_s, poses.position_m, strict=True):
        np.testing.assert_allclose(path.camera_from_target(time_s)[1], position_m, atol=1e-12)
    with pytest.raises(DataError, match="covers"):
        path.camera_from_target(3.1)


def test_the_sky_turns_when_the_camera_does(moving):
    turn = TimedPoses(
        time_s=np.array([0.0, 1.0]),
        position_m=np.zeros((2, 3)),
        orientation_xyzw=Rotation.from_rotvec([[0.0, 0, 0], [0, 0.4, 0]]).as_quat(),
    )
    scene = replace(moving, motion=replace(moving.motion, camera=turn))
    (view, _) = ring_views(scene)

    later = illuminated_ring(scene, view, time_s=0.5).light.sun_direction

    expected = Rotation.from_rotvec([0.0, -0.2, 0.0]).apply(scene.lights[view.light].sun_direction)
    np.testing.assert_allclose(later, expected, atol=1e-12)


@pytest.mark.parametrize("motion_px", [0.5, 3.0, 12.0])
def test_a_moving_edge_is_blurred_into_a_ramp_of_its_motion(clean_scene, motion_px):
    """A white wall that moves sideways at constant speed: light rises linearly over the motion, about its middle."""
    speed_m_s = motion_px / 356.0 / 0.01
    poses = TimedPoses(
        time_s=np.array([0.0, 1.0]),
        position_m=np.array([[0.0, 0.0, 1.0], [speed_m_s, 0.0, 1.0]]),
        orientation_xyzw=np.array([[1.0, 0.0, 0.0, 0.0]] * 2),
    )
    camera = replace(clean_scene.rig.camera, distortion_coefficients=np.zeros(5))
    wall = Body(size_m=np.array([4.0, 4.0, 0.1]), offset_m=np.array([2.0, 0.0]), material=MATERIALS["white"])
    scene = replace(
        clean_scene,
        rig=replace(clean_scene.rig, camera=camera),
        body=wall,
        lights={"dim": Light(name="dim", sun_w_m2=1.0, sun_direction=np.array([0.0, 0.0, -1.0]))},
        motion=poses,
        views=(RingView(name="moving", center_m=np.ones(3), normal=np.array([0.0, 0.0, -1.0]), target="body"),),
    )
    (view,) = ring_views(scene)
    illuminated = illuminated_ring(scene, view, (0,), 0.005, 0.01)

    image = layers(illuminated, pixel_rays(camera), blur_px=blur_px(illuminated, camera)).ambient

    assert blur_px(illuminated, camera) == pytest.approx(motion_px, rel=0.07)
    profile = image[60:180].astype(float).mean(axis=0) / image[120, 300]
    edge_px = 160.7 + motion_px / 2
    borders = (np.arange(321) - 0.5 - edge_px) / motion_px
    ramp = np.where(borders < -0.5, 0.0, np.where(borders > 0.5, borders, (borders + 0.5) ** 2 / 2))
    np.testing.assert_allclose(profile, np.diff(ramp) * motion_px, atol=0.02)
