"""A light plane that has moved is detected over a stream of shots, named, and corrected."""

from dataclasses import replace

import numpy as np
import pytest
from ring_scenes import make_scene, nees, visible_edges_of, with_stripes
from ring_streams import measured_stream, moved, poses_before, within_stability

from ringpose.pose.rig_monitor import RigEvidence
from ringpose.types.pose import PoseFlag

SHOTS = 50
TILT_RAD, SHIFT_M = np.radians(0.1), 0.3e-3


def camera_turned(rig, angle_rad):
    """All light planes turned alike about x, as they are for a camera that was turned against them."""
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])
    return replace(rig, lasers=replace(rig.lasers, normal=rig.lasers.normal @ turn.T))


@pytest.fixture
def poses(rng):
    """Draws scenes at many poses, seen by a rig, and their noisy break points."""
    return lambda real, shots=SHOTS: poses_before(real, rng, shots)


@pytest.fixture
def rig():
    return make_scene("B").rig


def test_a_rig_within_its_stability_is_healthy(poses, rng, rig):
    lines, warnings = measured_stream(rig, poses(within_stability(rig, rng), 15))

    assert not warnings
    assert max(lines[-1].rig_health.values()) < 3.0
    assert not any(PoseFlag.RIG_DRIFT in line.flags for line in lines)


@pytest.mark.parametrize(
    ("by", "laser"),
    [
        pytest.param({"tilt_rad": (2 * TILT_RAD, 0.0)}, 0, id="tilt-0"),
        pytest.param({"shift_m": 2 * SHIFT_M}, 2, id="shift-2", marks=pytest.mark.slow),
    ],
)
def test_a_plane_that_has_moved_is_named(poses, rng, rig, laser, by):
    lines, warnings = measured_stream(rig, poses(moved(within_stability(rig, rng), laser, **by), 15))

    named = [text for text in warnings.values() if "the light plane of laser" in text]
    assert named
    assert all(f"laser {rig.lasers.names[laser]} " in text for text in named)
    assert PoseFlag.RIG_DRIFT in lines[-1].flags
    assert lines[-1].status != "ok"


@pytest.mark.slow
def test_a_plane_that_has_moved_is_named_where_the_edges_are_visible(poses, rng, rig):
    real = moved(rig, 1, (0.0, TILT_RAD))
    scenes = [(scene, points, visible_edges_of(scene, 40, 0.3, rng)) for scene, points in poses(real, 6)]

    _, warnings = measured_stream(rig, scenes)

    assert any("laser middle " in text for text in warnings.values())


@pytest.mark.slow
def test_visible_edges_do_not_bias_the_evidence_for_errors_of_the_rig(poses, rng, rig):
    scenes = [(scene, points, visible_edges_of(scene, 80, 0.3, rng)) for scene, points in poses(rig, 50)]
    evidence = RigEvidence(rig, rig.stability)

    for line in measured_stream(rig, scenes)[0]:
        evidence.add(line.plane_evidence)

    for laser in range(3):
        plane = evidence.moved_plane(laser)
        assert (np.abs(plane.change) < 3.5 * np.sqrt(np.diag(plane.covariance))).all()


def test_after_a_drift_was_named_the_poses_are_right_again(poses, rng, rig):
    """And a shot of two stripes, of which the corrected plane gives one, is inconsistent."""
    scenes = list(poses(moved(rig, 0, (0.0, 0.01), 0.002), 18))
    scene, points = scenes[-1]

    (*lines, of_two), warnings = measured_stream(rig, [*scenes, (scene, with_stripes(points, 1, 2))])

    assert any("laser left" in text for text in warnings.values())
    drift = [line.flags & (PoseFlag.RIG_DRIFT | PoseFlag.INCONSISTENT) == PoseFlag.RIG_DRIFT for line in lines]
    corrected = drift.index(True)
    assert corrected < 14
    assert all(drift[corrected:])
    for (scene, _), line in list(zip(scenes, lines, strict=True))[corrected:]:
        errors = nees(line.pose, scene.ring)
        assert 2 * errors["normal"] < 25
        assert 3 * errors["center"] < 25
    assert {PoseFlag.RIG_DRIFT, PoseFlag.RIG_UNCHECKED, PoseFlag.INCONSISTENT} <= set(of_two.flags)


def test_a_camera_that_has_turned_is_reported_and_every_quantity_flagged(poses, rig):
    lines, warnings = measured_stream(rig, poses(camera_turned(rig, np.radians(0.2)), 5))

    assert any("the camera has" in text for text in warnings.values())
    assert {PoseFlag.RIG_DRIFT, PoseFlag.INCONSISTENT} <= set(lines[-1].flags)


def test_a_target_at_rest_counts_once(poses, rig):
    scene = next(poses(rig))

    lines, warnings = measured_stream(rig, [scene] * 20)

    assert not warnings
    assert lines[0].rig_health == lines[-1].rig_health


def test_wrong_break_points_in_a_few_shots_are_no_drift(poses, rng, rig):
    scenes = list(poses(rig, 15))
    for _, points in scenes[5:15:5]:
        points.position_px[rng.integers(3), rng.integers(2), 0] += 12.0

    _, warnings = measured_stream(rig, scenes)

    assert not warnings


@pytest.mark.parametrize(("laser", "shift_px"), [(0, 2.0), (1, 8.0)])
def test_a_wrong_stripe_in_one_shot_is_no_drift(poses, rig, laser, shift_px):
    scenes = list(poses(rig, 8))
    _, points = scenes[3]
    points.position_px[laser, :, 1] += shift_px
    points.face_start_undistorted_px[laser, 1] += shift_px
    points.face_end_undistorted_px[laser, 1] += shift_px

    lines, warnings = measured_stream(rig, scenes)

    assert not warnings
    assert not any(PoseFlag.RIG_DRIFT in line.flags for line in lines)


def test_shots_without_a_pose_since_a_plane_has_moved_count_too(poses, rig):
    lines, warnings = measured_stream(rig, poses(moved(rig, 1, (0.0, 0.02)), 8))

    assert any(line.pose is None for line in lines[:3])
    assert any("laser middle" in text for text in warnings.values())


@pytest.mark.slow
def test_no_false_alarm_in_many_streams(poses, rng, rig):
    for _ in range(100):
        _, warnings = measured_stream(rig, poses(within_stability(rig, rng)))
        assert not warnings


@pytest.mark.slow
@pytest.mark.parametrize("by", ["tilt", "shift"])
def test_nine_in_ten_planes_that_have_moved_are_named_within_fifty_shots(poses, rng, rig, by):
    named = 0
    for _ in range(60):
        laser, direction = int(rng.integers(3)), rng.uniform(0, 2 * np.pi)
        tilt_rad = TILT_RAD * np.array([np.cos(direction), np.sin(direction)]) if by == "tilt" else np.zeros(2)
        real = moved(within_stability(rig, rng), laser, tilt_rad, SHIFT_M if by == "shift" else 0.0)
        name = f"laser {rig.lasers.names[laser]} "
        _, warnings = measured_stream(rig, list(poses(real)), until=name)
        named += any(name in text for text in warnings.values())

    assert named >= 51  # 90 % less two binomial standard deviations
