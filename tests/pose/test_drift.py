"""A light plane that has moved is distinguished from noise."""

from dataclasses import replace

import numpy as np
import pytest

from ringpose.estimate.measurements import measurements_of
from ringpose.estimate.residuals import Prior
from ringpose.estimate.solver import estimate_ring
from ringpose.geometry.rotations import tilted
from ringpose.pose.drift import (
    DRIFTED_FROM,
    SHOTS_NEEDED,
    DriftMonitor,
    drift_warning,
    health_after,
    new_health,
    plane_evidence,
)
from ringpose.pose.maximum_likelihood import most_likely_pose
from ringpose.pose.pipeline import pose_result
from ringpose.types.options import Method
from ringpose.types.pose import NoPose, PoseLine

FIFTH_OF_A_DEGREE = np.radians(0.2)


def drifted(rig, laser, tilt_rad=(0.0, 0.0), shift_m=0.0):
    """The rig with one light plane moved."""
    normal, distance = rig.lasers.normal.copy(), rig.lasers.distance_m.copy()
    normal[laser] = tilted(normal[laser], np.array(tilt_rad))
    distance[laser] += shift_m
    return replace(rig, lasers=replace(rig.lasers, normal=normal, distance_m=distance))


def health_of_stream(scene_of, face_points, rng, said, real, shots=40):
    """Shots of many poses by the real rig, understood with the one that is said: all that was seen on one ring."""
    health = new_health(3)
    for points in stream(scene_of, face_points, rng, real, shots):
        measured = measurements_of(points, said)
        estimate = estimate_ring(measured, said, Prior())
        health = health_after(health, plane_evidence(estimate, measured, said))
    return health


def stream(scene_of, face_points, rng, real, shots):
    """Break points of rings at many poses, seen by the real rig."""
    for _ in range(shots):
        distance_m, tilt = rng.uniform(0.3, 1.0), rng.uniform(-0.2, 0.2, 2)
        scene = scene_of(
            real, distance_m=float(distance_m), tilt_rad=tuple(tilt), turn_rad=float(rng.uniform(-0.2, 0.2))
        )
        yield face_points(scene, 0.3, 0.02, rng)


def camera_turned(rig, angle_rad):
    """All light planes turned alike about x, as they are for a camera that was turned against them."""
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])
    return replace(rig, lasers=replace(rig.lasers, normal=rig.lasers.normal @ turn.T))


@pytest.fixture
def rig(scene_of):
    return scene_of("B").rig


def test_noise_alone_leaves_the_lasers_healthy(scene_of, face_points, rng, rig):
    health = health_of_stream(scene_of, face_points, rng, rig, rig)

    assert health.figure.max() < 1.0
    assert drift_warning(health, rig.lasers.names) is None


@pytest.mark.parametrize("laser", range(3))
@pytest.mark.parametrize("drift", [{"tilt_rad": (0.0, 2e-3)}, {"shift_m": 0.5e-3}], ids=["tilt", "shift"])
def test_a_plane_that_has_moved_is_named(scene_of, face_points, rng, rig, laser, drift):
    health = health_of_stream(scene_of, face_points, rng, rig, drifted(rig, laser, **drift))

    assert health.figure.max() > DRIFTED_FROM
    assert f"laser {rig.lasers.names[laser]} has moved" in drift_warning(health, rig.lasers.names)


@pytest.mark.parametrize("laser", [0, *(pytest.param(laser, marks=pytest.mark.slow) for laser in (1, 2))])
@pytest.mark.parametrize(
    "tilt_rad",
    [
        pytest.param((FIFTH_OF_A_DEGREE, 0.0), id="along"),
        pytest.param((0.0, FIFTH_OF_A_DEGREE), id="across", marks=pytest.mark.slow),
    ],
)
def test_a_plane_that_has_tilted_by_a_fifth_of_a_degree_is_seen(scene_of, face_points, rng, rig, laser, tilt_rad):
    health = health_of_stream(scene_of, face_points, rng, rig, drifted(rig, laser, tilt_rad), shots=60)

    assert "has moved" in drift_warning(health, rig.lasers.names)


def test_a_camera_that_has_turned_is_seen(scene_of, face_points, rng, rig):
    health = health_of_stream(scene_of, face_points, rng, rig, camera_turned(rig, FIFTH_OF_A_DEGREE), shots=60)

    assert "the camera" in drift_warning(health, rig.lasers.names)


@pytest.mark.parametrize("laser", [1, *(pytest.param(laser, marks=pytest.mark.slow) for laser in (0, 2))])
def test_shots_that_have_no_pose_since_a_plane_has_moved_are_a_warning(scene_of, face_points, rng, rig, laser):
    monitor, warnings = DriftMonitor(rig.lasers.names, Method.ML), []
    real = drifted(rig, laser, (0.0, 2e-3))
    for points in stream(scene_of, face_points, rng, real, int(1.5 * SHOTS_NEEDED)):
        result = most_likely_pose(points, rig)
        pose = None if isinstance(result.pose, NoPose) else result.pose
        line = PoseLine(shot="a", stamp_s=0.0, pose=pose, flags=result.flags, plane_evidence=result.plane_evidence)
        warnings.append(monitor.update(line)[1])

    named = [warning for warning in warnings if warning is not None]
    assert len(named) == 1
    assert "contradict" in named[0]  # no plane is named: in such shots any of them may be the wrong one


def test_shots_that_had_to_be_mended_are_a_warning_too(rig):
    health = new_health(3)
    for _ in range(12):
        health = health_after(health, None)

    assert "100 % of the last shots contradict one ring" in drift_warning(health, rig.lasers.names)


@pytest.mark.slow
def test_streams_of_noise_never_warn(scene_of, face_points, rng, rig):
    streams = [health_of_stream(scene_of, face_points, rng, rig, rig) for _ in range(25)]

    assert [drift_warning(health, rig.lasers.names) for health in streams] == [None] * 25


@pytest.mark.slow
def test_a_target_that_stands_still_warns_three_times_in_a_hundred(scene_of, face_points, rng, rig):
    # its noise stays the same, so that any number of shots tells what the first one does
    alone = [health_of_stream(scene_of, face_points, rng, rig, rig, shots=1) for _ in range(500)]

    assert np.mean([health.figure.max() > DRIFTED_FROM for health in alone if health.shots]) < 0.05


def test_a_few_shots_warn_of_nothing(scene_of, face_points, rng, rig):
    health = health_of_stream(scene_of, face_points, rng, rig, drifted(rig, 1, (2e-3, 0.0)), shots=5)

    assert drift_warning(health, rig.lasers.names) is None


def test_two_stripes_say_nothing_about_the_planes(scene_of, face_points, rng, rig):
    scene = scene_of("B", distance_m=0.25)
    points = face_points(scene, 0.3, 0.02, rng)
    for part in (points.position_px, points.covariance_px2, points.face_start_px):
        part[2] = np.nan

    evidence = pose_result(points, rig).plane_evidence

    assert np.isnan(health_after(new_health(3), evidence).figure[2])
