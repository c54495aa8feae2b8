"""Shots of a moving ring in ambient light: every feature at its own frame's place, with its stamp."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_edges import Surroundings, measured, off_edge_px, picture
from drawn_scene import DrawnScene, drawn_rig, light, true_break_points
from recorded_shots import make_shot
from ring_scenes import without

from ringpose.detect.motion import moved_to, ring_motion
from ringpose.detect.pipeline import detect
from ringpose.types.assumptions import motion_prior
from ringpose.types.detection import BreakPoints, Detection
from ringpose.types.image import Shot, shot_with_frames
from ringpose.types.rig import Rig

MASKS = (0, 1, 2, 4, 0)
PERIOD_S = 1 / 30
PRIOR = motion_prior()
STAMPS_S = 100.0 + PERIOD_S * np.arange(len(MASKS))
EXPOSURE_S = 0.002
VELOCITY_M_S = np.array([0.05, 0.02, 0.01])
"""6 px between neighbouring frames."""


@pytest.fixture(scope="module")
def rig() -> Rig:
    drawn = drawn_rig()
    return replace(drawn, camera=replace(drawn.camera, distortion_coefficients=np.zeros(5)))


def scene_at(stamp_s: float, velocity_m_s: np.ndarray = VELOCITY_M_S) -> DrawnScene:
    """The ring at mid exposure of a frame; at the middle frame it is where `DrawnScene` puts it."""
    center_m = np.array(DrawnScene().center_m) + velocity_m_s * (stamp_s - STAMPS_S[2] - EXPOSURE_S / 2)
    return DrawnScene(center_m=tuple(center_m.tolist()))


def drawn_shot(rig: Rig, velocity_m_s: np.ndarray, around: Surroundings) -> Shot:
    rng = np.random.default_rng(3)
    images = []
    for stamp_s, mask in zip(STAMPS_S + EXPOSURE_S / 2, MASKS, strict=True):
        scene = scene_at(stamp_s, velocity_m_s)
        image = picture(scene, rig, around, rng).astype(np.float64)
        image += sum(light(scene, rig, laser) for laser in range(3) if mask >> laser & 1)
        images.append(np.clip(np.rint(image), 0, 255).astype(np.uint8))
    return make_shot(np.array(images), MASKS, start_s=100.0, period_s=PERIOD_S, exposure_s=EXPOSURE_S)


@pytest.fixture(scope="module")
def moving(rig) -> Shot:
    return drawn_shot(rig, VELOCITY_M_S, Surroundings(face_dn=40.0, outside_dn=70.0, clutter_dn=5.0))


@pytest.fixture(scope="module")
def resting(rig) -> Shot:
    return drawn_shot(rig, np.zeros(3), Surroundings(face_dn=40.0, outside_dn=70.0))


@pytest.fixture(scope="module")
def detection(moving, rig) -> Detection:
    return detect(moving, rig)


def test_edges_are_found_in_both_frames_without_lasers_where_they_were(detection, rig):
    edges = detection.ring_edges
    assert edges is not None
    for frame in (0, 4):
        stamp_s = STAMPS_S[frame] + EXPOSURE_S / 2
        here = np.abs(edges.stamp_s - stamp_s) < 1e-6
        names = ("position_px", "normal", "sigma_px", "edge", "stamp_s")
        points = replace(edges, **{name: getattr(edges, name)[here] for name in names})
        error_px = off_edge_px(points, scene_at(stamp_s), rig)
        assert len(error_px) > 100
        assert abs(np.mean(error_px)) < 0.05
        assert np.abs(error_px / points.sigma_px).max() < 3.0


def test_break_points_are_where_their_own_frames_show_them(detection, rig):
    points = detection.break_points
    assert isinstance(points, BreakPoints)
    np.testing.assert_allclose(points.stamp_s, STAMPS_S[1:4] + EXPOSURE_S / 2)
    for laser in range(3):
        truth_px = true_break_points(scene_at(points.stamp_s[laser]), rig)[laser]
        seen = points.seen[laser]
        error_px = points.position_px[laser, seen] - truth_px[seen]
        variance = points.covariance_px2[laser, seen]
        chi2 = [error @ np.linalg.solve(each, error) for error, each in zip(error_px, variance, strict=True)]
        assert np.abs(error_px).max() < 0.3
        assert max(chi2) < 16


def test_the_motion_is_measured_to_a_fifth(moving, rig, rng):
    points = replace(measured(DrawnScene(), rig, rng), stamp_s=STAMPS_S[1:4])

    motion = ring_motion(points, moving, rig, PRIOR)

    assert motion is not None
    np.testing.assert_allclose(motion.velocity_m_s[0], VELOCITY_M_S[0], rtol=0.2)
    shown_px_s = rig.camera.camera_matrix[0, 0] * VELOCITY_M_S[0] / DrawnScene().center_m[2]
    np.testing.assert_allclose(motion.edge_speed_px_s, shown_px_s, rtol=0.3)


def test_a_ring_at_rest_shows_no_motion(resting, rig, rng):
    motion = ring_motion(measured(DrawnScene(), rig, rng), resting, rig, PRIOR)

    assert motion is not None
    assert motion.edge_speed_px_s * 4 * PERIOD_S < 0.2


@pytest.mark.parametrize("seen", [[], [(0, 0)], [(0, 0), (1, 0)], [(0, 0), (1, 1), (2, 0)]])
def test_few_break_points_show_no_motion_or_a_plausible_one(moving, rig, rng, seen):
    points = replace(measured(DrawnScene(), rig, rng), stamp_s=STAMPS_S[1:4])
    hidden = [place for place in np.ndindex(3, 2) if place not in seen]

    motion = ring_motion(without(points, *hidden), moving, rig, PRIOR)

    assert motion is None or np.abs(motion.velocity_m_s).max() < 0.1


def test_frames_in_the_dark_show_no_motion(moving, rig, rng):
    noise = rng.integers(2, 5, moving.images.shape, dtype=np.uint8)

    assert ring_motion(measured(DrawnScene(), rig, rng), replace(moving, images=noise), rig, PRIOR) is None


def test_a_shot_declared_as_still_uses_the_first_frame_without_lasers_only(resting, rig):
    still = detect(replace(resting, meta={"still": True}), rig).ring_edges

    assert still is not None
    np.testing.assert_allclose(still.stamp_s, STAMPS_S[0] + EXPOSURE_S / 2)


def test_stripes_moved_to_one_instant_lie_on_the_ring_of_that_instant(moving, rig, rng):
    exact = measured(DrawnScene(), rig, rng)
    seen = np.array([true_break_points(scene_at(STAMPS_S[1 + laser]), rig)[laser] for laser in range(3)])
    points = replace(exact, position_px=seen, stamp_s=STAMPS_S[1:4])
    motion = ring_motion(points, shot_with_frames(moving, np.arange(5)), rig, PRIOR)
    assert motion is not None
    motion = replace(motion, velocity_m_s=VELOCITY_M_S, rate_rad_s=np.zeros(3))

    moved, moved_rig = moved_to(STAMPS_S[0], points, rig, motion)

    truth_px = true_break_points(scene_at(STAMPS_S[0]), moved_rig)
    np.testing.assert_allclose(moved.position_px, truth_px, atol=1e-6)
