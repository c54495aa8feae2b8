"""A light plane that has moved is told from noise."""

from dataclasses import replace

import numpy as np
import pytest

from ringpose.geometry.rotations import tilted
from ringpose.pose.health import DRIFTED_FROM, drift_warning, health_after, new_health
from ringpose.pose.pipeline import estimate_pose


def drifted(rig, laser, tilt_rad=(0.0, 0.0), shift_m=0.0):
    """The rig with one light plane moved."""
    normal, distance = rig.lasers.normal.copy(), rig.lasers.distance_m.copy()
    normal[laser] = tilted(normal[laser], np.array(tilt_rad))
    distance[laser] += shift_m
    return replace(rig, lasers=replace(rig.lasers, normal=normal, distance_m=distance))


def health_of_stream(scene_of, face_points, rng, said, real, shots=40):
    """Shots of many poses by the real rig, understood with the one that is said."""
    health = new_health(3)
    for _ in range(shots):
        distance_m, tilt = rng.uniform(0.3, 1.0), rng.uniform(-0.2, 0.2, 2)
        scene = scene_of(
            real, distance_m=float(distance_m), tilt_rad=tuple(tilt), turn_rad=float(rng.uniform(-0.2, 0.2))
        )
        pose = estimate_pose(face_points(scene, 0.3, 0.02, rng), said)
        if pose.plane_evidence is not None:
            health = health_after(health, pose.plane_evidence)
    return health


@pytest.fixture
def rig(scene_of):
    return scene_of("B").rig


def test_noise_alone_leaves_the_lasers_healthy(scene_of, face_points, rng, rig):
    health = health_of_stream(scene_of, face_points, rng, rig, rig)

    assert health.figure.max() < 1.0
    assert drift_warning(health, rig.lasers.names) is None


@pytest.mark.parametrize("laser", range(3))
@pytest.mark.parametrize("drift", [{"tilt_rad": (0.0, 2e-3)}, {"shift_m": 0.4e-3}], ids=["tilt", "shift"])
def test_a_plane_that_has_moved_is_named(scene_of, face_points, rng, rig, laser, drift):
    health = health_of_stream(scene_of, face_points, rng, rig, drifted(rig, laser, **drift))

    assert health.figure.max() > DRIFTED_FROM
    assert f"laser {rig.lasers.names[laser]} has moved" in drift_warning(health, rig.lasers.names)


def test_a_few_shots_warn_of_nothing(scene_of, face_points, rng, rig):
    health = health_of_stream(scene_of, face_points, rng, rig, drifted(rig, 1, (2e-3, 0.0)), shots=5)

    assert drift_warning(health, rig.lasers.names) is None


def test_two_stripes_say_nothing_about_the_planes(scene_of, face_points, rng, rig):
    scene = scene_of("B", distance_m=0.25)
    points = face_points(scene, 0.3, 0.02, rng)
    for part in (points.position_px, points.covariance_px2, points.face_start_px):
        part[2] = np.nan

    evidence = estimate_pose(points, rig).plane_evidence

    assert np.isnan(health_after(new_health(3), evidence).figure[2])
