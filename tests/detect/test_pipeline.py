"""A shot's break points, from drawn stripes whose truth is a formula."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from drawn_scene import DrawnScene, draw_shot, true_break_points
from recorded_shots import make_shot
from ring_scenes import RIGS

from ringpose.detect import edge_search, pipeline, ring_edges
from ringpose.detect.break_points import break_points
from ringpose.detect.pipeline import Prior, detect
from ringpose.detect.ring_edges import edges_lit
from ringpose.files.images.shots import read_shot
from ringpose.files.rigs import read_rig
from ringpose.types.detection import BreakPointFlag, BreakPoints, NoBreakPoints
from ringpose.types.image import Shot
from ringpose.types.options import StripeSource
from ringpose.types.rig import Rig

SWITCHED = [0, 1, 2, 4]
ALL_ON = [7]


def found(shot: Shot, rig: Rig) -> BreakPoints:
    points = detect(shot, rig).break_points
    assert isinstance(points, BreakPoints), points
    return points


@pytest.mark.parametrize("masks", [SWITCHED, [0, 7], ALL_ON], ids=["switched", "off and all", "all"])
@pytest.mark.parametrize("depth_m", [0.3, 0.5, 1.0])
def test_break_points_lie_within_a_seventh_of_a_pixel_of_the_formula(rig, rng, masks, depth_m):
    scene = DrawnScene(center_m=(0.58, 0.02, depth_m))

    points = found(draw_shot(scene, rig, masks, rng), rig)

    error_px = points.position_px - true_break_points(scene, rig)
    assert np.abs(error_px).max() < 0.14
    assert points.labelled == (masks == SWITCHED)
    assert points.repeated is None


def test_reported_sigmas_explain_the_errors_under_speckle(rig, rng):
    errors = []
    for depth_m in (0.35, 0.5, 0.7):
        scene = DrawnScene(center_m=(0.58, 0.02, depth_m), speckle=0.2)
        points = found(draw_shot(scene, rig, SWITCHED, rng), rig)
        error_px = (points.position_px - true_break_points(scene, rig))[..., 0]
        errors.append(error_px**2 / points.covariance_px2[..., 0, 0])

    assert 0.2 < np.mean(errors) < 2.0


def test_a_ring_on_the_other_side_swaps_the_edges(rig, rng):
    shot = draw_shot(DrawnScene(), rig, SWITCHED, rng)
    mirrored = replace(shot, images=np.ascontiguousarray(shot.images[:, :, ::-1]))

    points, turned = found(shot, rig), found(mirrored, rig)

    assert np.all(points.position_px[:, 0, 0] > points.position_px[:, 1, 0])
    assert np.all(turned.position_px[:, 0, 0] < turned.position_px[:, 1, 0])


@pytest.mark.parametrize("order", [[0, 4, 2, 1], [0, 2, 4, 1], [0, 2, 1, 4]], ids=["1-3", "rotated", "1-2"])
def test_swapped_wiring_is_not_believed(rig, rng, order):
    swapped = replace(draw_shot(DrawnScene(), rig, order, rng), lasers=np.array(SWITCHED, dtype=np.uint8))

    assert detect(swapped, rig).break_points is NoBreakPoints.CONTRADICTED_MASKS


def test_a_bar_over_one_end_is_called_occluded_and_left_out(rig, rng):
    scene = DrawnScene()
    truth = true_break_points(scene, rig)
    shot = draw_shot(scene, rig, SWITCHED, rng)
    images = shot.images.copy()
    left = int(truth[2, 1, 0])
    images[:, int(truth[2, 1, 1]) - 40 : int(truth[2, 1, 1]) + 40, left - 30 : left + 35] = 10

    points = found(replace(shot, images=images), rig)

    assert points.flags[2, 1] & BreakPointFlag.OCCLUDED
    assert not points.seen[2, 1]
    assert np.count_nonzero(points.seen) >= 4
    assert np.nanmax(np.abs(points.position_px - truth)) < 0.15


def test_two_lasers_in_view_give_four_break_points(rig, rng):
    scene = DrawnScene(center_m=(0.58, 0.05, 0.235))
    truth = true_break_points(scene, rig)

    points = found(draw_shot(scene, rig, SWITCHED, rng), rig)

    inside = (truth[..., 1] > 0) & (truth[..., 1] < 1199)
    assert np.array_equal(points.seen, inside)
    assert np.nanmax(np.abs(points.position_px - truth)) < 0.2


def test_a_saturated_stripe_is_flagged(rig, rng):
    scene = DrawnScene(peaks_dn=(600.0, 600.0, 600.0))

    points = found(draw_shot(scene, rig, SWITCHED, rng), rig)

    assert np.all(points.flags & BreakPointFlag.SATURATED)


def test_edges_with_a_chamfer_are_flagged_blunt_and_known_worse(rig, rng):
    points = found(draw_shot(DrawnScene(edge_sigma_px=3.0), rig, SWITCHED, rng), rig)

    assert np.all(points.flags & BreakPointFlag.BLUNT)
    assert np.all(points.covariance_px2[..., 0, 0] > 1.0)


def test_the_paper_segments_find_the_same_ring(rig, rng):
    scene = DrawnScene(noise_dn=0.5)
    shot = draw_shot(scene, rig, SWITCHED, rng)

    detection = detect(shot, rig, source=StripeSource.SEGMENTS)

    assert isinstance(detection.break_points, BreakPoints)
    assert detection.segments is not None
    assert np.abs(detection.break_points.position_px - true_break_points(scene, rig)).max() < 0.15


def flat_shot(value: int, lasers: int = 7) -> Shot:
    return make_shot(np.full((1, 1200, 1600), value, dtype=np.uint8), [lasers], exposure_s=0.001)


@pytest.mark.parametrize(
    ("shot", "reason"),
    [
        (flat_shot(0), NoBreakPoints.IMAGE_DARK),
        (flat_shot(255), NoBreakPoints.IMAGE_SATURATED),
        (flat_shot(90), NoBreakPoints.NO_STRIPE),
        (flat_shot(90, lasers=0), NoBreakPoints.NO_LASER_FRAME),
    ],
    ids=["black", "white", "grey", "lasers off"],
)
def test_an_image_without_stripes_has_a_reason(rig, shot, reason):
    assert detect(shot, rig).break_points is reason


def test_noise_alone_is_no_ring(rig, rng):
    images = rng.integers(0, 60, (2, 1200, 1600)).astype(np.uint8)
    noise = replace(draw_shot(DrawnScene(), rig, [0, 7], rng), images=images)

    assert detect(noise, rig).break_points in (NoBreakPoints.NO_STRIPE, NoBreakPoints.NO_RING)


def test_detection_does_not_depend_on_the_order_of_frames(rig, rng):
    shot = draw_shot(DrawnScene(), rig, SWITCHED, rng)
    order = np.array([2, 0, 3, 1])
    parts = {name: getattr(shot, name)[order] for name in ("images", "lasers", "stamp_s", "exposure_s")}

    first, second = found(shot, rig), found(replace(shot, **parts), rig)

    np.testing.assert_allclose(second.position_px, first.position_px, atol=1e-9)


def count_calls(monkeypatch):
    """Counts frames that are searched whole."""
    calls = []
    whole = pipeline.find_stripes

    def counted(*frames, bands=None, **more):
        if bands is None:
            calls.append(1)
        return whole(*frames, bands=bands, **more)

    monkeypatch.setattr(pipeline, "find_stripes", counted)
    return calls


def test_a_prediction_restricts_the_search_and_changes_little(rig, rng, monkeypatch):
    scene = DrawnScene(speckle=0.1)
    shot = draw_shot(scene, rig, SWITCHED, rng)
    predicted = found(draw_shot(DrawnScene(center_m=(0.575, 0.022, 0.502)), rig, SWITCHED, rng), rig)
    whole = found(shot, rig)
    calls = count_calls(monkeypatch)

    tracked = detect(shot, rig, Prior(predicted=predicted)).break_points

    assert calls == []
    assert isinstance(tracked, BreakPoints)
    np.testing.assert_allclose(tracked.position_px, whole.position_px, atol=0.05)


def test_a_lost_prediction_falls_back_to_the_whole_frame(rig, rng, monkeypatch):
    shot = draw_shot(DrawnScene(), rig, SWITCHED, rng)
    predicted = found(draw_shot(DrawnScene(center_m=(0.58, 0.02, 0.7)), rig, SWITCHED, rng), rig)
    calls = count_calls(monkeypatch)

    tracked = detect(shot, rig, Prior(predicted=predicted)).break_points

    assert len(calls) == 3
    assert isinstance(tracked, BreakPoints)
    np.testing.assert_array_equal(tracked.position_px, found(shot, rig).position_px)


@pytest.fixture
def with_off_frame(carried_data):
    """A rendered shot after a frame without lasers: the same without its thin bright stripes."""

    def shot_of(name: str) -> tuple[Shot, Rig]:
        rig = read_rig(carried_data / "rig_b" / "rig.yaml")
        shot = read_shot(carried_data / "rig_b" / "shots" / f"{name}.npz", rig=rig)
        off = cv2.morphologyEx(shot.images[-1], cv2.MORPH_OPEN, np.ones((31, 1), np.uint8))
        stamps = {"stamp_s": np.array([0.0, 0.1]), "exposure_s": np.repeat(shot.exposure_s[-1:], 2)}
        return replace(shot, images=np.stack([off, shot.images[-1]]), lasers=np.array([0, 7], np.uint8), **stamps), rig

    return shot_of


@pytest.mark.parametrize(("name", "lit"), [("B_z0500_p01_dim", False), ("B_z0500_p01_normal", True)])
def test_ambient_light_should_show_edges_in_a_lit_shot_only_whatever_the_black_level(with_off_frame, name, lit):
    shot, rig = with_off_frame(name)
    points = found(shot, rig)

    for black_level_dn in (0, 20):
        raised = np.clip(shot.images.astype(int) + black_level_dn, 0, 255).astype(np.uint8)
        assert edges_lit(points, replace(shot, images=raised)) == lit


def test_visible_edges_do_not_replace_clear_ends(with_off_frame, monkeypatch):
    """The shadow of a ring on a flat body has edges, too; in the light beside it the stripes go on, but fainter."""

    def with_unclear_ends(*arguments):
        points = break_points(*arguments)
        return replace(points, flags=points.flags | int(BreakPointFlag.UNCLEAR))

    shot, rig = with_off_frame("B_z0500_p01_normal")
    assert detect(shot, rig).ring_edges is not None

    monkeypatch.setattr(pipeline, "break_points", with_unclear_ends)

    assert detect(shot, rig).break_points is NoBreakPoints.NO_RING


def test_lit_edges_that_are_not_found_are_recorded(with_off_frame, monkeypatch):
    monkeypatch.setattr(ring_edges, "found_edges", lambda *_: None)

    detection = detect(*with_off_frame("B_z0500_p01_normal"))

    assert [each.what for each in detection.rejected] == ["edge"]


def test_edges_along_which_no_ring_can_be_fitted_are_not_found(with_off_frame, monkeypatch):
    monkeypatch.setattr(edge_search, "refine_ring", lambda *_: None)

    detection = detect(*with_off_frame("B_z0500_p01_normal"))

    assert detection.ring_edges is None
    assert isinstance(detection.break_points, BreakPoints)


def test_a_frame_with_all_lasers_after_the_single_ones_is_a_second_measurement(rig, rng):
    scene = DrawnScene(center_m=(0.58, 0.02, 0.5))

    points = found(draw_shot(scene, rig, [*SWITCHED, 7], rng), rig)

    truth = true_break_points(scene, rig)
    assert points.repeated is not None
    assert points.repeated.seen.all()
    assert np.abs(points.repeated.position_px - truth).max() < 1 / 3
    np.testing.assert_array_equal(points.repeated.stamp_s, np.full(3, 4.0005))


def test_stripes_of_the_second_measurement_halfway_between_two_belong_to_neither(rng):
    rig = RIGS["A"]  # its stripes are 25 px apart
    shot = draw_shot(DrawnScene(), rig, [*SWITCHED, 7], rng)
    half = np.roll(shot.images[-1], 12, axis=0)

    points = found(replace(shot, images=np.stack([*shot.images[:-1], half])), rig)

    assert points.repeated is None
