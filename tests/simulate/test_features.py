"""Drawn detections are exact without noise, as uncertain as they state, and wrong where the truth says."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from turned_cameras import turned_rig

from ringpose.errors import DataError
from ringpose.estimate.nuisance import FORM_ORDERS
from ringpose.geometry.rays import undistort
from ringpose.measure.stream import estimate_pose
from ringpose.simulate.features import Deviations, draw_detection, drawn_features
from ringpose.simulate.pipeline import simulate
from ringpose.simulate.placement import target_placement
from ringpose.types.arrays import EDGES
from ringpose.types.assumptions import MotionPrior, RigStability
from ringpose.types.detection import BreakPointFlag, BreakPoints, NoBreakPoints
from ringpose.types.rig import ParameterCovariance
from ringpose.types.target import FreeMotion, Gap, RingForm

EXACT = Deviations(noise=False)


@pytest.fixture
def switched(scene):
    return replace(scene, sequence=(0, 1, 2, 4), stripe_dn=170.0)


def found(drawn) -> BreakPoints:
    assert isinstance(drawn.detection.break_points, BreakPoints)
    return drawn.detection.break_points


def test_features_of_stripes_along_columns_are_refused(switched):
    upright = replace(switched, rig=turned_rig(switched.rig))

    with pytest.raises(DataError, match=r"rig \(stripes along columns\): has no model"):
        next(drawn_features(upright))


def test_features_without_noise_give_the_exact_pose(switched, view, rng):
    drawn = draw_detection(switched, view, rng, EXACT)

    pose = estimate_pose(found(drawn), switched.rig)

    assert np.abs(pose.center_m - view.center_m).max() < 1e-6
    assert np.abs(pose.normal - view.normal).max() < 1e-6
    assert abs(pose.radius_inner_m - 0.567) < 1e-6


def test_break_points_are_those_of_the_rendered_truth(switched, view, rng):
    (_, truth), drawn = next(simulate(switched)), draw_detection(switched, view, rng)

    assert np.abs(drawn.truth.break_points_px - truth.break_points_px).max() < 1e-9
    assert (drawn.truth.expect, drawn.truth.groups) == (truth.expect, truth.groups)


def test_stamps_are_those_of_each_lasers_frame(switched, view, rng):
    shot, _ = next(simulate(switched))

    drawn = draw_detection(switched, view, rng, stamp_s=switched.start_s)

    assert drawn.detection.stamp_s == pytest.approx(shot.measured_at_s, abs=1e-6)
    assert np.abs(found(drawn).stamp_s - (shot.stamp_s + shot.exposure_s / 2)[1:]).max() < 1e-6
    assert found(drawn).labelled
    assert drawn.detection.lasers_on.all()
    assert drawn.detection.ring_edges is None  # without ambient light


def test_scatter_of_drawn_features_is_as_stated(switched, view, rng):
    exact = found(draw_detection(switched, view, rng, EXACT))
    draws = [found(draw_detection(switched, view, rng)) for _ in range(200)]

    off_px = np.array([each.position_px for each in draws]) - exact.position_px
    whitened = np.linalg.solve(np.linalg.cholesky(exact.covariance_px2), off_px[..., None])[..., 0]
    ends_px = np.array([[each.face_start_undistorted_px[:, 1], each.face_end_undistorted_px[:, 1]] for each in draws])
    ends = (
        ends_px - [exact.face_start_undistorted_px[:, 1], exact.face_end_undistorted_px[:, 1]]
    ) / exact.face_sigma_px.T

    assert whitened.mean() == pytest.approx(0.0, abs=0.08)
    assert whitened.var() == pytest.approx(1.0, abs=0.1)
    assert ends.var() == pytest.approx(1.0, abs=0.2)
    assert np.mean(ends[:, 0] * ends[:, 1]) == pytest.approx(-0.5, abs=0.2)  # of a fitted line's two ends


def test_more_noise_never_reduces_the_covariance_of_features(switched, view, rng):
    least = found(draw_detection(switched, view, rng)).covariance_px2[..., 0, 0]
    for noisier in (
        replace(switched, speckle=replace(switched.speckle, contrast=0.4)),
        replace(switched, speckle=replace(switched.speckle, grain_px=3.0)),
        replace(switched, sensor=replace(switched.sensor, temporal_dark_noise_e=200.0)),
        replace(switched, stripe_dn=20.0),
    ):
        assert (found(draw_detection(noisier, view, rng)).covariance_px2[..., 0, 0] > least).all()


def test_a_stripe_beyond_the_border_is_clipped_and_its_line_remains(switched, view, rng):
    aside = replace(view, center_m=view.center_m + np.array([0.195, 0.0, 0.0]), name="aside")

    drawn = draw_detection(switched, aside, rng, EXACT)

    points = found(drawn)
    outside = drawn.truth.break_points_px[..., 0] != drawn.truth.break_points_px[..., 0]
    assert outside.any()
    assert np.array_equal(np.isnan(points.position_px[..., 0]), outside)
    assert (points.flags[outside] == BreakPointFlag.CLIPPED).all()
    assert np.isfinite(points.face_end_undistorted_px).all()
    assert drawn.truth.expect == "partial"


def test_motion_displaces_each_lasers_features_by_its_own_time(switched, view, rng):
    moving = draw_detection(
        switched, view, rng, replace(EXACT, motion=MotionPrior(speed_sd_m_s=0.1, rate_sd_rad_s=0.1))
    )

    points, truth = found(moving), moving.truth
    assert truth.angular_velocity_rad_s @ view.normal == pytest.approx(0.0, abs=1e-12)
    for laser, time_s in enumerate(points.stamp_s - moving.detection.stamp_s):
        turn = cv2.Rodrigues(truth.angular_velocity_rad_s * time_s)[0]
        then = replace(view, center_m=view.center_m + truth.velocity_m_s * time_s, normal=turn @ view.normal)
        still = found(draw_detection(switched, then, rng, EXACT))
        assert np.abs(points.position_px[laser] - still.position_px[laser]).max() < 1e-6
    assert points.stamp_s[0] == moving.detection.stamp_s
    assert np.ptp(points.stamp_s) > 0


def test_form_displaces_the_edges_with_the_tolerance_as_standard_deviation(switched, view, rng):
    tolerance_m = 1e-4
    exact = found(draw_detection(switched, view, rng, EXACT)).position_px
    off_px = []
    for _ in range(100):
        drawn = draw_detection(switched, view, rng, replace(EXACT, ring_tolerance_m=tolerance_m))
        off_px.append(found(drawn).position_px[1] - exact[1])

    # a radial deviation moves a point along the stripe, an axial one along the ray's trace in the light plane
    depth_m = 0.47
    radial_px = tolerance_m * switched.rig.camera.camera_matrix[0, 0] / depth_m
    assert np.std(off_px, axis=0)[:, 0] == pytest.approx(radial_px, rel=0.25)
    assert min(FORM_ORDERS) == 2  # lower ones would be a centre, a radius, an offset or a tilt


def test_outliers_are_where_the_truth_has_them(switched, view, rng):
    exact = found(draw_detection(switched, view, rng, EXACT)).position_px
    deviations = replace(EXACT, displaced_share=0.3, displaced_px=(4.0, 6.0), missing_share=0.2)
    for _ in range(20):
        drawn = draw_detection(switched, view, rng, deviations)
        words = {key: str(drawn.truth.groups.get(key, "")).split(",") for key in ("displaced", "missing")}
        missing = np.array([laser in words["missing"] for laser in switched.rig.lasers.names])
        displaced = np.array(
            [[f"{laser}.{edge}" in words["displaced"] for edge in EDGES] for laser in switched.rig.lasers.names]
        )
        if isinstance(drawn.detection.break_points, NoBreakPoints):
            assert missing.all()
            continue
        points = found(drawn)
        off_px = np.linalg.norm(points.position_px - exact, axis=-1)
        assert np.isnan(off_px[missing]).all()
        assert (off_px[~missing & ~displaced.any(axis=1)] < 1e-9).all()
        moved_px = off_px[displaced & ~missing[:, None]]
        assert ((moved_px > 3.9) & (moved_px < 6.5)).all()


def test_a_stripe_on_the_background_lies_on_a_parallel_plane_behind(switched, view, rng):
    deviations = replace(EXACT, background_share=1.0, background_m=(0.05, 0.05))

    drawn = draw_detection(switched, view, rng, deviations)

    behind = replace(view, center_m=view.center_m - 0.05 * view.normal)
    expected = found(draw_detection(switched, behind, rng, EXACT))
    assert drawn.truth.groups["background"] == "left,middle,right"
    assert np.abs(found(drawn).position_px - expected.position_px).max() < 1e-6
    assert (
        np.abs(drawn.truth.break_points_px - found(draw_detection(switched, view, rng, EXACT)).position_px).max() < 1e-9
    )


def test_rig_errors_move_the_features_as_the_rigs_covariance_says(switched, view, rng):
    sd_m = 2e-4
    covariance = ParameterCovariance(parameters=("middle.distance",), data=np.array([[sd_m**2]]))
    calibrated = replace(switched, rig=replace(switched.rig, covariance=covariance, stability=RigStability()))
    exact = found(draw_detection(switched, view, rng, EXACT)).position_px
    off = []
    for _ in range(60):
        drawn = draw_detection(calibrated, view, rng, replace(EXACT, rig_errors=True))
        position = found(drawn).position_px
        assert np.abs(position[[0, 2]] - exact[[0, 2]]).max() < 1e-9
        off.append(drawn.common.rig.lasers.distance_m[1] - switched.rig.lasers.distance_m[1])
        assert np.sign(position[1, 0, 1] - exact[1, 0, 1]) == np.sign(off[-1])

    assert np.std(off) == pytest.approx(sd_m, rel=0.3)


def test_rig_errors_contain_what_has_changed_since_the_calibration(switched, view, rng):
    stability = RigStability(plane_tilt_rad=2e-4)
    changing = replace(switched, rig=replace(switched.rig, stability=stability))

    rigs = [draw_detection(changing, view, rng, replace(EXACT, rig_errors=True)).common.rig for _ in range(100)]

    tilts = np.array([each.lasers.normal - switched.rig.lasers.normal for each in rigs])
    assert np.sqrt((tilts**2).sum(axis=-1).mean()) == pytest.approx(np.sqrt(2) * stability.plane_tilt_rad, rel=0.1)
    np.testing.assert_allclose([each.lasers.distance_m for each in rigs], 100 * [switched.rig.lasers.distance_m])


def test_rig_errors_need_a_covariance_or_a_stability(switched, view, rng):
    exact = replace(switched, rig=replace(switched.rig, stability=RigStability()))
    with pytest.raises(DataError, match="covariance"):
        draw_detection(exact, view, rng, Deviations(rig_errors=True))


def test_a_run_has_one_rig_and_one_form(switched, view):
    views = tuple(replace(view, name=f"v{k}") for k in range(3))
    run = list(drawn_features(replace(switched, views=views), Deviations(ring_tolerance_m=1e-4)))

    assert len({id(each.common) for each in run}) == 1
    again = list(drawn_features(replace(switched, views=views), Deviations(ring_tolerance_m=1e-4)))
    assert np.array_equal(found(run[2]).position_px, found(again[2]).position_px)
    assert not np.array_equal(found(run[0]).position_px, found(run[1]).position_px)


RADII_M = np.array([0.567, 0.597])


def radii_m(edges, scene, center_m, normal) -> np.ndarray:
    """Distances from the centre at which the rays of edge points meet the ring's plane."""
    camera = scene.rig.camera
    xy = cv2.undistortPoints(edges.position_px, camera.camera_matrix, camera.distortion_coefficients).reshape(-1, 2)
    rays = np.column_stack([xy, np.ones(len(xy))])
    points = rays * ((center_m @ normal) / (rays @ normal))[:, None]
    return np.linalg.norm(points - center_m, axis=1)


@pytest.fixture
def sunlit(switched, view):
    return replace(switched, exposure_s=0.0002, stripe_dn=None), replace(view, light="strong")


def test_visible_edges_lie_on_the_ring_and_scatter_as_stated(sunlit, rng):
    scene, view = sunlit
    exact = draw_detection(scene, view, rng, EXACT).detection.ring_edges
    drawn = [draw_detection(scene, view, rng).detection.ring_edges for _ in range(50)]

    assert np.abs(radii_m(exact, scene, view.center_m, view.normal) - RADII_M[exact.edge]).max() < 1e-5
    off = [((each.position_px - exact.position_px) * exact.normal).sum(axis=1) / exact.sigma_px for each in drawn]
    assert len(exact.edge) > 12
    assert set(exact.edge) == {0, 1}
    assert np.var(off) == pytest.approx(1.0, abs=0.1)


def test_edges_move_with_the_ring_by_the_time_of_their_own_frame(sunlit, rng):
    scene, view = sunlit
    prior = MotionPrior(speed_sd_m_s=0.1, rate_sd_rad_s=0.0)
    moving = draw_detection(scene, view, rng, replace(EXACT, motion=prior))

    edges = moving.detection.ring_edges
    time_s = edges.stamp_s[0] - moving.detection.stamp_s
    assert time_s < 0  # the frame without lasers comes first
    center_m = view.center_m + time_s * moving.truth.velocity_m_s
    assert np.abs(radii_m(edges, scene, center_m, view.normal) - RADII_M[edges.edge]).max() < 1e-5


def test_a_view_without_ring_or_in_saturating_sunlight_has_no_break_points(switched, view, rng):
    glaring = replace(switched, exposure_s=0.1, stripe_dn=None)

    drawn = draw_detection(glaring, replace(view, light="strong"), rng)

    assert drawn.detection.break_points is NoBreakPoints.NO_STRIPE
    assert drawn.truth.expect == "pose"  # as of images: the ring is in view
    without = draw_detection(switched, replace(view, target="body"), rng)
    assert without.detection.break_points is NoBreakPoints.NO_RING
    assert without.truth.expect == "no_target"


def test_the_pose_holds_at_the_first_frame_with_a_laser_on(switched, view, rng):
    scene = replace(switched, sequence=(0, 7, 1, 2, 4))
    prior = MotionPrior(speed_sd_m_s=0.1, rate_sd_rad_s=0.0)

    drawn = draw_detection(scene, view, rng, replace(EXACT, motion=prior), stamp_s=100.0)

    assert drawn.truth.stamp_s == drawn.detection.stamp_s < found(drawn).stamp_s.min()


def test_lasers_that_are_on_together_are_not_labelled(switched, view, rng):
    together = found(draw_detection(replace(switched, sequence=(0, 7)), view, rng))
    mixed = draw_detection(replace(switched, sequence=(0, 1, 0)), view, rng).detection

    assert not together.labelled
    assert np.ptp(together.stamp_s) == 0.0
    assert mixed.lasers_on.tolist() == [True, False, False]
    assert np.isnan(mixed.break_points.stamp_s).tolist() == [False, True, True]


def test_motion_form_and_gaps_of_the_scene_give_the_truth_of_its_images(switched, view):
    """Break points and velocities at the time of each frame; gaps take a break point of the left laser away."""
    (_, whole) = next(simulate(switched))
    left = placed(switched, view, whole.break_points_px[0, 0])
    gap = Gap(angle_rad=float(np.arctan2(left[1], left[0])), width_m=0.014, depth_m=0.01)
    form = RingForm(radial_m=np.full((2, 3, 2), 2e-4), axial_m=np.full((3, 2), 1e-4))
    motion = FreeMotion(
        inertia_kg_m2=np.diag([3.0, 4.0, 5.0]),
        center_of_mass_m=np.array([0.0, 0.0, -1.0]),
        angular_velocity_rad_s=np.array([0.05, -0.03, 0.06]),
        velocity_m_s=np.array([0.03, 0.02, -0.02]),
    )
    ring = replace(switched.ring, form=form, gaps=(gap,))
    moving = replace(switched, ring=ring, motion=motion, stripe_dn=None, exposure_s=0.002, shots=2)

    drawn = list(drawn_features(moving, EXACT))

    for (_, truth), shot in zip(simulate(moving), drawn, strict=True):
        np.testing.assert_allclose(shot.truth.break_points_px, truth.break_points_px, atol=1e-6)
        assert np.isnan(shot.truth.break_points_px).any()
        np.testing.assert_allclose(shot.truth.center_m, truth.center_m, atol=1e-12)
        np.testing.assert_allclose(shot.truth.velocity_m_s, truth.velocity_m_s, atol=1e-12)
        np.testing.assert_allclose(shot.truth.angular_velocity_rad_s, truth.angular_velocity_rad_s, atol=1e-12)
        seen = np.isfinite(found(shot).position_px)
        assert seen.sum() >= 8
        np.testing.assert_allclose(found(shot).position_px[seen], truth.break_points_px[seen], atol=1e-6)
        assert not shot.detection.still


def placed(scene, view, pixel):
    """The point of the ring's face at a pixel, in the target frame."""
    placement = target_placement(scene, view)
    direction = placement.vectors_target(np.append(undistort(pixel[None], scene.rig.camera)[0], 1.0)[:, None])[:, 0]
    eye_m = placement.eye_m
    return eye_m + (scene.ring.height_m - eye_m[2]) / direction[2] * direction
