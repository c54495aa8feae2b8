"""Shots that the track predicts: where their stripes are, and to which lasers they belong."""

from dataclasses import replace

import numpy as np
import pytest
from moving_rings import START_S, Shots, drawn_motion, stream
from recorded_shots import make_shot
from ring_scenes import RIGS, pixels_of
from tracked_rings import track_of

from ringpose.detect.pipeline import detect
from ringpose.measure.warm_start import BACKGROUND_SHARE, WarmStart, shared_inflation
from ringpose.track.pipeline import Tracker
from ringpose.track.prediction import motion_px, predicted_ring, predicted_stripes
from ringpose.types.image import Shot

RIG = RIGS["B"]


def predicted_at(tracker: Tracker, ahead_s: float, rig=RIG):
    stamp_s = tracker.track.stamp_s + ahead_s
    ring = predicted_ring(tracker.track, stamp_s, tracker.camera)
    return stamp_s - START_S, predicted_stripes([ring] * len(rig.lasers.names), rig)


@pytest.fixture(scope="module")
def tracker(records) -> Tracker:
    return track_of(records)


@pytest.mark.parametrize("ahead_s", [0.03, 0.3])
def test_break_points_are_predicted_within_their_errors(tracker, moving, ahead_s):
    time_s, predicted = predicted_at(tracker, ahead_s)

    truth_px = pixels_of(moving.at(time_s).break_points_m(RIG.lasers), RIG.camera).reshape(-1, 2, 2)
    seen = predicted.seen
    sigma_px = np.sqrt(predicted.covariance_px2[..., [0, 1], [0, 1]])
    assert seen.sum() >= 4
    assert (np.abs(predicted.position_px - truth_px)[seen] < 4.5 * sigma_px[seen]).all()
    assert sigma_px[seen].max() < 6.0
    assert predicted.labelled


def test_a_prediction_that_is_too_uncertain_is_none(tracker):
    assert predicted_at(tracker, 60.0)[1] is None


def test_a_prediction_does_not_assign_stripes_that_are_closer_than_five_sigmas(tracker):
    parallel = replace(RIG.lasers, normal=np.repeat(RIG.lasers.normal[1:2], 3, axis=0))
    sigma_px = predicted_at(tracker, 0.3)[1].face_sigma_px.max()
    focal, depth_m = RIG.camera.camera_matrix[1, 1], tracker.line_at(0.0).grasp.point_m[2]
    labelled = []
    for sigmas in (3.0, 8.0):
        apart_m = sigmas * sigma_px / focal * depth_m * np.array([-1.0, 0.0, 1.0])
        lasers = replace(parallel, distance_m=RIG.lasers.distance_m[1] + apart_m)
        labelled.append(predicted_at(tracker, 0.3, replace(RIG, lasers=lasers))[1].labelled)

    assert labelled == [False, True]


def test_the_motion_of_the_edges_in_the_image_is_that_of_the_ring(rng):
    motion = replace(drawn_motion(rng, rate_deg_s=0.0), velocity_m_s=np.array([0.03, 0.0, 0.0]), rate_rad_s=np.zeros(3))
    tracker = track_of(stream(motion, 2.0, Shots(known_radius_sd_m=5e-4), rng))
    stamp_s = tracker.track.stamp_s

    found_px = motion_px(tracker.track, stamp_s - 0.1, stamp_s, RIG)

    depth_m = tracker.line_at(0.0).grasp.point_m[2]
    assert found_px == pytest.approx(0.003 / depth_m * RIG.camera.camera_matrix[0, 0], rel=0.15)


def shot(masks, stamp_s: float) -> Shot:
    images = np.zeros((len(masks), RIG.camera.image_height, RIG.camera.image_width), np.uint8)
    return make_shot(images, masks, start_s=stamp_s, period_s=1 / 30, exposure_s=1e-3)


def test_each_stripe_of_a_switched_shot_is_predicted_at_the_time_of_its_own_frame(tracker, moving):
    shots, switched = WarmStart(tracker), shot([0, 1, 2, 4, 0], tracker.track.stamp_s + 0.1)

    predicted = shots.prediction(switched, RIG)

    for laser in range(3):
        ring = predicted_ring(tracker.track, switched.mid_exposure_s(1 + laser))
        alone = predicted_stripes([ring] * 3, RIG)
        np.testing.assert_allclose(predicted.face_start_undistorted_px[laser], alone.face_start_undistorted_px[laser])


def test_without_a_track_nothing_is_predicted_and_lasers_are_switched():
    shots = WarmStart(Tracker(None))

    assert shots.prediction(shot([7], START_S), RIG) is None
    assert not shots.assigns_lasers(RIG)


def test_lasers_are_assigned_while_shots_continue_the_track_and_not_after_one_that_does_not(records):
    shots = WarmStart(Tracker(None))
    found = []
    for line in records[:8]:
        shots.added(line)
        found.append(shots.assigns_lasers(RIG))
    shots.added(replace(records[9], measurement=None))

    assert found[-1]
    assert not shots.assigns_lasers(RIG)


@pytest.mark.parametrize("count", range(1, 11))
def test_shots_with_one_background_contribute_the_information_of_their_mean(count):
    covariance = np.full((count, count), BACKGROUND_SHARE) + (1.0 - BACKGROUND_SHARE) * np.eye(count)

    information = sum(1.0 / shared_inflation(number) for number in range(1, count + 1))

    assert information == pytest.approx(np.linalg.inv(covariance).sum())


def test_shots_are_counted_from_their_background_on(rng, monkeypatch):
    still = drawn_motion(rng, speed_m_s=0.0, rate_deg_s=0.0)
    tracker, inflations = Tracker(None), []
    shots, add = WarmStart(tracker), tracker.add
    monkeypatch.setattr(
        tracker, "add", lambda line, now_s, factor: inflations.append(factor) or add(line, now_s, factor)
    )
    lines = stream(still, 3.0, Shots(), rng)
    for line in lines[:10]:
        shots.added(line)
    inflations.clear()
    for line, masks in zip(lines[10:16], ([7], [0, 7], [7], [7], [0, 7], [7]), strict=True):
        taken = shot(masks, line.pose_stamp_s)
        shots.after(taken, detect(taken, RIG), shots.before(taken, RIG))
        shots.added(line)

    assert inflations == [shared_inflation(number) for number in (0, 1, 2, 3, 1, 2)]
