"""Motion within a shot, the form of the ring and the stability of the rig: covered by the covariance, or flagged."""

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from calibrated import DRAWS, assert_calibrated
from ring_scenes import edges_in_frames, face_points_of, make_scene, nees, scene_of
from ring_streams import within_stability

from ringpose.estimate.explanation import explain
from ringpose.estimate.factors.prior import Prior
from ringpose.estimate.measurements import measurements_of
from ringpose.estimate.pose_errors import mahalanobis_squared
from ringpose.files.scenes.scene import read_scene
from ringpose.files.studies.specification import PRESETS
from ringpose.geometry.rays import intersect, project, rays
from ringpose.geometry.ring import motion_derivatives, ring_arcs
from ringpose.geometry.rotations import tilt_basis
from ringpose.measure.stream import pose_line, pose_result
from ringpose.simulate.features import drawn_features
from ringpose.types.assumptions import (
    IDEAL,
    NOISE_ONLY,
    TYPICAL_STABILITY,
    USUAL,
    Assumptions,
    MotionPrior,
    RigStability,
    motion_prior,
)
from ringpose.types.pose import NoPose, PoseFlag
from ringpose.types.scene import Approach
from ringpose.types.target import RingForm

PERIOD_S = 1 / 30
STAMPS_S = 100.0 + PERIOD_S * np.arange(3)
PRIOR = MotionPrior(speed_sd_m_s=0.025, rate_sd_rad_s=np.radians(2.5))
MOVING = Assumptions(motion=PRIOR)


def moved(ring, time_s, velocity_m_s, rate_rad_s):
    """A rigid motion of the ring about its centre."""
    rotation = cv2.Rodrigues(np.asarray(rate_rad_s) * time_s)[0]
    return replace(ring, center_m=ring.center_m + np.asarray(velocity_m_s) * time_s, normal=rotation @ ring.normal)


def moving_scene(scene, velocity_m_s, rate_rad_s, reference_s=STAMPS_S[1]):
    """The scene as its lasers show it one after the other; its ring is that at the reference time."""
    points_m = np.array(
        [
            moved(scene.ring, stamp_s - reference_s, velocity_m_s, rate_rad_s).break_points_m(scene.rig.lasers)[laser]
            for laser, stamp_s in enumerate(STAMPS_S)
        ]
    )
    return scene_of(scene.rig, scene.ring, points_m)


def edges_of_frames(scene, velocity_m_s, rate_rad_s, stamps_s, rng):
    """Visible edges in frames before and after those of the lasers."""
    rings = {each: moved(scene.ring, each - STAMPS_S[1], velocity_m_s, rate_rad_s) for each in stamps_s}
    return edges_in_frames(scene.rig, rings, 40, 0.3, rng)


def drawn_motion(rng, ring):
    rate = PRIOR.rate_sd_rad_s * rng.normal(size=2) @ tilt_basis(ring.normal)
    return PRIOR.speed_sd_m_s * rng.normal(size=3), rate


# Derivatives


def test_the_derivatives_of_a_moved_ring_are_those_of_differences(rng):
    normal = np.array([0.1, -0.2, -0.97])
    normal /= np.linalg.norm(normal)
    arcs = ring_arcs(np.array([0.5, 0.1, 0.6]), normal, np.array([0.567, 0.597]), np.array([-0.05, 0.0, 0.5]))
    velocity, rate, time_s = np.array([0.05, 0.02, -0.04]), np.array([0.1, -0.08]) @ arcs.axes[:2], 0.1
    after = arcs.predict(time_s, velocity, rate)

    def increments(other):
        shift = other.origin - after.origin
        turn = after.axes[1] @ other.axes[0] + after.curvature * (after.axes[1] @ shift)
        plane = [after.axes[0] @ other.normal, after.axes[1] @ other.normal, after.normal @ shift]
        return np.array([*plane, after.axes[0] @ shift, turn, other.curvature, other.half_band_m])

    step = 1e-6
    derivatives = motion_derivatives(arcs, after, time_s)
    for column in range(7):
        ahead, behind = (
            arcs.retract(sign * step * np.eye(7)[column]).predict(time_s, velocity, rate) for sign in (1, -1)
        )
        difference = (increments(ahead) - increments(behind)) / (2 * step)
        np.testing.assert_allclose(derivatives[:, column], difference, atol=2e-4)
    axes = [*np.eye(3), *arcs.axes[:2]]
    for column, axis in enumerate(axes):
        by = (axis, np.zeros(3)) if column < 3 else (np.zeros(3), axis)
        ahead, behind = (
            arcs.predict(time_s, velocity + sign * step * by[0], rate + sign * step * by[1]) for sign in (1, -1)
        )
        difference = (increments(ahead) - increments(behind)) / (2 * step)
        np.testing.assert_allclose(derivatives[:, 7 + column], difference, atol=2e-4)


# Motion


@DRAWS
@pytest.mark.parametrize("lit", [False, True], ids=["dark", "edges in both frames without lasers"])
def test_errors_of_a_moving_ring_are_as_stated(rng, lit, draws):
    errors = {"center": [], "normal": [], "grasp": [], "velocity": []}
    for _ in range(draws):
        tilt = rng.uniform(-0.2, 0.2, 2)
        scene = make_scene("B", distance_m=float(rng.uniform(0.35, 0.6)), tilt_rad=tuple(tilt))
        motion = drawn_motion(rng, scene.ring)
        points = replace(face_points_of(moving_scene(scene, *motion), 0.3, 0.02, rng), stamp_s=STAMPS_S)
        frames = (STAMPS_S[0] - PERIOD_S, STAMPS_S[2] + PERIOD_S)
        edges = edges_of_frames(scene, *motion, frames, rng) if lit else None

        result = pose_result(points, scene.rig, ring_edges=edges, assumptions=MOVING)

        pose, velocity = result.pose, result.velocity
        assert not isinstance(pose, NoPose)
        truth = moved(scene.ring, result.stamp_s - STAMPS_S[1], *motion)
        weak = result.flags & (PoseFlag.CENTER_WEAK | PoseFlag.SIDE_UNKNOWN)
        for name, value in nees(pose, truth).items():
            if name != "center" or not weak:
                errors[name].append(value)
        if velocity is not None:
            rates = tilt_basis(pose.normal) @ (velocity.rate_rad_s - motion[1])
            error = np.concatenate([velocity.center_m_s - motion[0], rates])
            errors["velocity"].append(mahalanobis_squared(error, velocity.covariance) / 5)

    assert_calibrated(errors["normal"], 2)
    assert_calibrated(errors["grasp"], 2)
    assert_calibrated(errors["velocity"], 5)
    if lit:
        assert len(errors["center"]) > 0.8 * draws
        assert_calibrated(errors["center"], 3)


@DRAWS
def test_a_fast_target_of_unknown_radius_has_no_wrong_grasp_point_without_a_flag(draws):
    """Radial velocity and curvature exchange roles: the centre may come to lie beyond the outer edge."""
    rng = np.random.default_rng(7)
    fast = motion_prior(0.2, 8.0)
    errors = []
    for _ in range(draws):
        scene = make_scene("B", distance_m=float(rng.uniform(0.3, 0.7)), tilt_rad=tuple(rng.uniform(-0.2, 0.2, 2)))
        velocity_m_s = fast.speed_sd_m_s * rng.normal(size=3)
        motion = velocity_m_s, fast.rate_sd_rad_s * rng.normal(size=2) @ tilt_basis(scene.ring.normal)
        points = replace(face_points_of(moving_scene(scene, *motion), 0.3, 0.02, rng), stamp_s=STAMPS_S)
        result = pose_result(points, scene.rig, assumptions=Assumptions(motion=fast))
        if not isinstance(result.pose, NoPose) and PoseFlag.GRASP_WEAK not in result.flags:
            truth = moved(scene.ring, result.stamp_s - STAMPS_S[1], *motion)
            errors.append(nees(result.pose, truth)["grasp"])

    assert len(errors) > 0.65 * draws
    assert_calibrated(errors, 2, at_most=True)


def test_a_moving_ring_that_is_assumed_still_is_flagged(rng):
    flagged = 0
    for _ in range(5):
        scene = moving_scene(make_scene("B", distance_m=0.5), (0.0, 0.0, 0.15), (0.2, 0.0, 0.0))
        points = replace(face_points_of(scene, 0.3, 0.02, rng), stamp_s=STAMPS_S)
        flagged += bool(pose_result(points, scene.rig).flags & ~PoseFlag.RIG_UNCHECKED)

    assert flagged == 5


def test_a_target_faster_than_assumed_is_flagged_as_motion(rng):
    scene = make_scene("B", distance_m=0.5)
    motion = (np.array([0.15, 0.1, -0.1]), np.zeros(3))
    points = replace(face_points_of(moving_scene(scene, *motion), 0.3, 0.02, rng), stamp_s=STAMPS_S)
    frames = (STAMPS_S[0] - PERIOD_S, STAMPS_S[2] + PERIOD_S)
    edges = edges_of_frames(scene, *motion, frames, rng)

    result = pose_result(points, scene.rig, ring_edges=edges, assumptions=MOVING)

    assert PoseFlag.MOTION in result.flags
    assert result.priors.assumptions.motion.speed_sd_m_s > PRIOR.speed_sd_m_s
    error_m_s = result.velocity.center_m_s - motion[0]
    assert mahalanobis_squared(error_m_s, result.velocity.covariance[:3, :3]) < 25


@pytest.mark.parametrize("zero", ["speed_sd_m_s", "rate_sd_rad_s"])
def test_a_rate_that_is_assumed_to_be_zero_is_the_limit_of_a_small_one(rng, zero):
    scene = make_scene("B", distance_m=0.5)
    points = replace(face_points_of(scene, 0.3, 0.02, rng), stamp_s=STAMPS_S)

    none, small = (
        pose_result(points, scene.rig, assumptions=Assumptions(motion=replace(PRIOR, **{zero: sd})))
        for sd in (0.0, 1e-9)
    )

    assert none.flags == small.flags
    np.testing.assert_allclose(none.pose.center_m, small.pose.center_m, atol=1e-6)
    np.testing.assert_allclose(none.pose.covariance, small.pose.covariance, rtol=1e-3)


def test_frames_of_one_instant_do_not_depend_on_the_motion_prior(rng):
    scene = make_scene("B", distance_m=0.5)
    points = replace(face_points_of(scene, 0.3, 0.02, rng), stamp_s=np.full(3, 100.0))

    still, moving = (pose_result(points, scene.rig, assumptions=each) for each in (Assumptions(), MOVING))

    np.testing.assert_array_equal(still.pose.center_m, moving.pose.center_m)
    assert moving.velocity is None


# Form of the ring


def deformed(scene, points_m, amplitude_m, phase_rad, order, axial=False):
    """Break points of a ring with one deviation from circle or plane, on their own light planes, to first order."""
    ring, lasers = scene.ring, scene.rig.lasers
    first, moved_m = tilt_basis(ring.normal), points_m.copy()
    for laser, edge in np.ndindex(points_m.shape[:2]):
        outward = scene.points_m[laser, edge] - ring.center_m
        outward /= np.linalg.norm(outward)
        angle = np.arctan2(outward @ first[1], outward @ first[0])
        deviation_m = amplitude_m * np.cos(order * angle + phase_rad)
        rows = np.array([lasers.normal[laser], ring.normal, outward])
        moved_m[laser, edge] += np.linalg.solve(rows, [0.0, deviation_m * axial, deviation_m * (not axial)])
    return moved_m


@DRAWS
@pytest.mark.parametrize("axial", [False, True], ids=["out of round", "warped"])
def test_a_ring_within_its_tolerance_has_errors_as_stated(rng, axial, draws):
    tolerance_m, errors = 0.5e-3, {"normal": [], "grasp": []}
    for _ in range(draws):
        scene = make_scene("B", distance_m=float(rng.uniform(0.35, 0.6)))
        points_m = scene.points_m
        for order in (2, 3, 4):  # the variance tolerance^2 at any angle
            amplitude_m = tolerance_m * np.sqrt(2 / 3) * np.sqrt(rng.chisquare(2) / 2)
            points_m = deformed(scene, points_m, amplitude_m, rng.uniform(0, 2 * np.pi), order, axial)
        seen = scene_of(scene.rig, scene.ring, points_m)
        points = face_points_of(seen, 0.3, 0.02, rng)

        result = pose_result(points, scene.rig, assumptions=Assumptions(ring_tolerance_m=tolerance_m))

        for name, values in errors.items():
            values.append(nees(result.pose, scene.ring)[name])

    for values in errors.values():
        assert_calibrated(values, 2, at_most=True)


def test_a_larger_tolerance_never_reduces_the_covariance(rng):
    scene = make_scene("B", distance_m=0.5)
    points = face_points_of(scene, 0.3, 0.02, rng)

    covariances = [
        pose_result(points, scene.rig, assumptions=Assumptions(ring_tolerance_m=tolerance_m)).pose.covariance
        for tolerance_m in (0.0, 1e-4, 1e-3)
    ]

    for smaller, larger in pairwise(covariances):
        assert (np.diag(larger) >= np.diag(smaller) * (1 - 1e-9)).all()


def test_a_wave_of_the_edge_beyond_the_tolerance_is_flagged(rng):
    scene = make_scene("B", distance_m=0.5)
    points_m = deformed(scene, scene.points_m, 3e-3, 0.4, 12, axial=True)
    seen = scene_of(scene.rig, scene.ring, points_m)
    points = face_points_of(seen, 0.1, 0.01, rng)

    result = pose_result(points, scene.rig, assumptions=Assumptions(ring_tolerance_m=1e-4))

    assert result.flags & (
        PoseFlag.RING_FORM | PoseFlag.INCONSISTENT | PoseFlag.POINT_REJECTED | PoseFlag.STRIPE_REJECTED
    )


def with_form(distance_m, light, seed, amplitude_m=0.0, phase_rad=0.0):
    """A drawn detection of a ring whose edges have waves of order 4 in opposite phase, and its rig and truth."""
    scene, wave = read_scene(PRESETS / "paper-physical-scene.yaml"), np.array([np.cos(phase_rad), np.sin(phase_rad)])
    radial_m = np.zeros((2, 3, 2))
    radial_m[:, 2] = amplitude_m * np.outer([-1.0, 1.0], wave)
    view = Approach(count=1, distances_m=(distance_m,), lights=(light,), seed=seed, name="r", tilt_rad=0.15)
    ring = replace(scene.ring, form=RingForm(radial_m=radial_m, axial_m=np.zeros((3, 2))))
    (shot,) = drawn_features(replace(scene, ring=ring, seed=seed, views=(), approaches=(view,)))
    return shot, scene.rig


def test_waves_of_the_edges_beyond_the_tolerance_are_flagged_and_in_the_covariance():
    for seed, phase_rad in enumerate((0.0, 1.4)):
        shot, rig = with_form(0.5, "normal", seed, 1e-3, phase_rad)

        line = pose_line(shot.detection, rig)

        assert "ring_form" in line.flag_names
        error_m = line.pose.center_m - shot.truth.center_m
        assert mahalanobis_squared(error_m, line.pose.covariance_center_m2) < 25.0


@pytest.mark.slow
def test_edges_of_a_round_ring_are_not_flagged():
    """Chi-squared of the stripes has more degrees of freedom beside edges, which determine a part of the ring."""
    chi2, expected = [], []
    for seed in range(12):
        shot, rig = with_form(0.7, "strong", seed)

        result = pose_result(shot.detection.break_points, rig, ring_edges=shot.detection.ring_edges)

        assert not result.flags & (PoseFlag.RING_FORM | PoseFlag.INCONSISTENT | PoseFlag.MOTION)
        best = explain(
            measurements_of(shot.detection.break_points, rig, shot.detection.ring_edges),
            Prior(),
            labelled=True,
            edges_named=True,
        )
        chi2.append(best.estimate.chi2)
        expected.append(best.estimate.expected_chi2)
        assert best.estimate.expected_chi2 > 1.2 * best.estimate.degrees_of_freedom
    assert sum(chi2) == pytest.approx(sum(expected), rel=0.45)


def test_visible_edges_beside_the_ends_of_stripes_by_a_chamfer_are_used():
    """0.3 mm at 0.5 m; with a perfect ring they contradict the stripes."""
    shot, rig = with_form(0.5, "normal", 0)
    edges = shot.detection.ring_edges
    beside = replace(edges, position_px=edges.position_px + edges.normal)
    detection = replace(shot.detection, ring_edges=beside)

    line, strict = (pose_line(detection, rig, options=each) for each in (USUAL, NOISE_ONLY))

    assert line.status == "ok"
    error_m = line.pose.center_m - shot.truth.center_m
    assert mahalanobis_squared(error_m, line.pose.covariance_center_m2) < 11.3
    assert "edge_rejected" in strict.flag_names


@pytest.mark.parametrize("depth_m", [0.004, 0.01])
def test_the_foot_of_a_wall_as_bright_as_the_face_may_look_like_the_edge(depth_m):
    """The outer wall faces the camera; its foot is up to 15 px beside the edge."""
    shot, rig = with_form(0.5, "normal", 7)
    edges, truth = shot.detection.ring_edges, shot.truth
    directions = rays(edges.position_px, rig.camera)
    points = intersect(directions, truth.normal, np.asarray(truth.normal @ truth.center_m))
    foot_px = project(points - depth_m * truth.normal, rig.camera)
    position_px = np.where((edges.edge == 1)[:, None], foot_px, edges.position_px)
    at_foot = replace(shot.detection, ring_edges=replace(edges, position_px=position_px))

    on_face, line = (pose_line(each, rig) for each in (shot.detection, at_foot))

    assert line.status == "ok"
    np.testing.assert_allclose(line.pose.center_m, on_face.pose.center_m, atol=5e-4)


# Stability of the rig


@DRAWS
def test_errors_with_a_rig_that_has_changed_within_its_stability_are_as_stated(rng, draws):
    errors = {"normal": [], "grasp": [], "center": []}
    for _ in range(draws):
        said = replace(make_scene("B").rig, stability=TYPICAL_STABILITY)
        scene = make_scene(within_stability(said, rng), distance_m=float(rng.uniform(0.35, 0.6)))
        points = face_points_of(scene, 0.3, 0.02, rng)

        pose = pose_result(points, said, assumptions=Assumptions(stability=TYPICAL_STABILITY)).pose

        for name, value in nees(pose, scene.ring).items():
            errors[name].append(value)

    for name, values in errors.items():
        assert_calibrated(values, 3 if name == "center" else 2)


def test_stability_raises_the_normals_error_as_the_design_states(rng):
    """MATH.md, section 11: at 0.3, 0.5 and 1 m from 0.04, 0.14, 0.46 to 0.16, 0.29, 0.94 degrees."""
    for distance_m, expected_deg in ((0.3, 0.16), (0.5, 0.29), (1.0, 0.94)):
        scene = make_scene("B", distance_m=distance_m)
        points = face_points_of(scene, 0.3, 0.02, rng)
        exact, changing = (
            pose_result(points, scene.rig, assumptions=Assumptions(stability=each)).pose.covariance
            for each in (RigStability(), TYPICAL_STABILITY)
        )
        sd_deg = np.degrees(np.sqrt(np.linalg.eigvalsh(changing[:2, :2])[-1]))
        assert sd_deg == pytest.approx(expected_deg, rel=0.5)
        assert np.trace(changing[:2, :2]) > 2 * np.trace(exact[:2, :2])


# A second measurement of each stripe, by a frame with all lasers on

AGAIN_S = STAMPS_S[-1] + PERIOD_S


def seen_twice(scene, velocity_m_s, rng, sigma_px=0.1):
    """Break points of a ring in steady motion by one frame for each laser, then by one with all of them."""
    first = face_points_of(moving_scene(scene, velocity_m_s, np.zeros(3)), sigma_px, sigma_px / 10, rng)
    later = scene_of(scene.rig, moved(scene.ring, AGAIN_S - STAMPS_S[1], velocity_m_s, np.zeros(3)))
    again = replace(face_points_of(later, sigma_px, sigma_px / 10, rng), stamp_s=np.full(3, AGAIN_S))
    return replace(first, stamp_s=STAMPS_S, repeated=again)


@pytest.mark.parametrize(("speed_m_s", "flagged"), [(0.0, False), (0.05, True)])
def test_a_frame_with_all_lasers_shows_that_a_target_that_is_assumed_still_moves(rng, speed_m_s, flagged):
    scene = make_scene("B", distance_m=0.5)
    points = seen_twice(scene, np.array([0.0, speed_m_s, 0.0]), rng)

    result = pose_result(points, scene.rig)

    assert bool(result.flags & PoseFlag.MOTION) == flagged
    assert result.measurement.degrees_of_freedom == 5  # twelve distinct numbers less seven parameters


@pytest.mark.parametrize("assumptions", [Assumptions(), MOVING], ids=["still", "moving"])
def test_a_frame_with_all_lasers_that_no_steady_motion_explains_is_left_out_and_flagged_as_motion(rng, assumptions):
    scene = make_scene("B", distance_m=0.5)
    points = seen_twice(scene, np.zeros(3), rng)
    jumped = seen_twice(scene, np.array([0.0, 0.0, 0.1]), rng).repeated

    result = pose_result(replace(points, repeated=jumped), scene.rig, assumptions=assumptions)

    assert PoseFlag.MOTION in result.flags
    error_m = result.pose.center_m - scene.ring.center_m
    assert mahalanobis_squared(error_m, result.pose.covariance_center_m2) < 21.1  # 99.99 % of 3


def test_a_frame_with_all_lasers_measures_the_velocity_and_never_the_ring_better_than_a_still_shot(rng):
    scene, velocity_m_s = make_scene("B", distance_m=0.5), np.array([0.01, -0.02, 0.015])
    points = seen_twice(scene, velocity_m_s, rng)

    twice = pose_result(points, scene.rig, assumptions=MOVING)
    once = pose_result(replace(points, repeated=None), scene.rig, assumptions=MOVING)
    still = pose_result(replace(seen_twice(scene, np.zeros(3), rng), repeated=None), scene.rig)

    error = twice.velocity.center_m_s - velocity_m_s
    assert mahalanobis_squared(error, twice.velocity.covariance[:3, :3]) < 16.3  # 99.9 %
    assert np.trace(twice.velocity.covariance[:3, :3]) < 0.5 * np.trace(once.velocity.covariance[:3, :3])
    assert np.linalg.eigvalsh(twice.pose.covariance - 0.9 * still.pose.covariance)[0] > -1e-9


def conical_scene(slope_rad, **pose):
    """A ring whose face rises outwards: its edges lie in two parallel planes, as far apart as the slope makes them."""
    scene = make_scene("B", **pose)
    inner_m, outer_m = scene.ring.radius_m
    rise_m = 0.5 * np.tan(slope_rad) * (outer_m - inner_m) * scene.ring.normal
    points_m = np.stack(
        [
            replace(scene.ring, center_m=scene.ring.center_m + sign * rise_m).break_points_m(scene.rig.lasers)[:, edge]
            for edge, sign in enumerate((-1.0, 1.0))
        ],
        axis=1,
    )
    return scene_of(scene.rig, scene.ring, points_m)


@DRAWS
def test_errors_on_sloping_faces_are_as_large_as_reported_if_the_slope_is_assumed(draws):
    """The slopes are drawn from the prior that is stated."""
    rng = np.random.default_rng(17)
    options = replace(NOISE_ONLY, face_slope_deg=1.5)
    errors = {"normal": [], "grasp": [], "center": []}
    for _ in range(draws):
        scene = conical_scene(np.radians(1.5) * rng.normal(), tilt_rad=tuple(rng.uniform(-0.2, 0.2, 2)))
        points = face_points_of(scene, 0.3, 0.05, rng)
        assumed = options.about_shot(scene.rig.stability, still=True)
        pose = pose_result(points, scene.rig, assumptions=assumed).pose
        for name, value in nees(pose, scene.ring).items():
            errors[name].append(value)
    assert_calibrated(errors["normal"], 2)
    assert_calibrated(errors["grasp"], 2)
    assert_calibrated(errors["center"], 3)


def test_a_sloping_face_turns_the_normal_if_no_slope_is_assumed():
    scene = conical_scene(np.radians(1.5))
    pose = pose_result(face_points_of(scene, 0.15, 0.02), scene.rig, assumptions=IDEAL).pose
    assert 2.0 * nees(pose, scene.ring)["normal"] > 25.0
