"""Views in which stripes cross, leave the image or are not there: simulated with the paper's physical light planes."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from ring_scenes import PROJECTED, make_camera

from ringpose.detect.pipeline import detect
from ringpose.files.scenes.scene import read_scene
from ringpose.files.studies.specification import PRESETS
from ringpose.simulate.pipeline import simulate, simulated_shot
from ringpose.simulate.placement import ring_views
from ringpose.types.detection import BreakPointFlag, BreakPoints, NoBreakPoints
from ringpose.types.image import Shot
from ringpose.types.rig import Rig
from ringpose.types.scene import Approach, Light, RingView, Scene, Sensor
from ringpose.types.session import parsed_sequence
from ringpose.types.target import Body, RingShape

OUTER_M = 0.597
SWITCHED, ALL_ON = [0, 1, 2, 3], [4]


def rig_of(focal_px: float, width: int, height: int) -> Rig:
    return Rig(camera=make_camera((width, height), (focal_px, focal_px), (width / 2, height / 2)), lasers=PROJECTED)


WIDE = rig_of(560.0, 960, 720)
"""A lens so wide that all stripes are in view where they cross, below 170 mm."""
NARROW = rig_of(889.0, 800, 600)
"""The paper's lens, before pixels of 9 um."""


@functools.cache
def simulated(rig: Rig, depth_m: float, x_m: float, target: str):
    """A shot of a ring whose centre lies at that depth and that far to the right, and the truth."""
    view = RingView(
        name="view", center_m=np.array([x_m, -0.03, depth_m]), normal=np.array([0.0, 0.0, -1.0]), target=target
    )
    scene = Scene(
        rig=rig,
        ring=RingShape(profile_m=np.array([[0.567, 0.0], [0.567, 0.06], [OUTER_M, 0.06], [OUTER_M, 0.0]])),
        body=Body(size_m=np.array([2.2, 2.2, 1.0])),
        lights={"dim": Light(name="dim")},
        sensor=Sensor(pixel_m=9e-6),
        exposure_s=0.001,
        stripe_dn=170.0 if target == "ring" else None,
        sequence=(0, 1, 2, 4, 7),
        views=(view,),
    )
    return next(iter(simulate(scene)))


def shot_of(rig: Rig, depth_m: float, frames: list[int], x_m: float = 0.582, target: str = "ring"):
    """Some frames of such a shot, and its true break points."""
    shot, truth = simulated(rig, depth_m, x_m, target)
    parts = {name: getattr(shot, name)[frames] for name in ("images", "lasers", "stamp_s", "exposure_s")}
    return replace(shot, **parts, device_stamp_s=None, gain_db=None, frame_id=None), truth.break_points_px


def found(shot: Shot, rig: Rig) -> BreakPoints:
    points = detect(shot, rig).break_points
    assert isinstance(points, BreakPoints), points
    return points


@pytest.mark.parametrize(("depth_m", "right_is_lower"), [(0.15, True), (0.16, True), (0.18, False), (0.2, False)])
def test_labels_are_right_on_both_sides_of_where_stripes_cross(depth_m, right_is_lower):
    shot, truth_px = shot_of(WIDE, depth_m, ALL_ON)

    points = found(shot, WIDE)

    # the lines hardly determine on which side the centre is, so that inner and outer edge may be exchanged
    assert np.abs(np.sort(points.position_px, axis=1) - np.sort(truth_px, axis=1)).max() < 1.0
    assert np.abs(points.position_px - truth_px).max() < 1.0 or np.all(points.flags & BreakPointFlag.EDGE_UNKNOWN)
    assert (points.position_px[2, 0, 1] > points.position_px[1, 0, 1]) == right_is_lower


@pytest.mark.parametrize("depth_m", [0.168, 0.17, 0.172])
def test_labels_of_crossing_stripes_are_called_ambiguous(depth_m):
    shot, _ = shot_of(WIDE, depth_m, ALL_ON)

    assert detect(shot, WIDE).break_points is NoBreakPoints.AMBIGUOUS_LABELS


def test_switched_lasers_resolve_crossing_stripes():
    shot, truth_px = shot_of(WIDE, 0.17, SWITCHED)

    points = found(shot, WIDE)

    assert points.labelled
    assert np.abs(np.sort(points.position_px[..., 0]) - np.sort(truth_px[..., 0])).max() < 1.0


def test_one_stripe_in_view_is_handed_on_with_its_line_but_without_a_side():
    shot, truth_px = shot_of(NARROW, 0.2, SWITCHED)

    points = found(shot, NARROW)

    assert points.seen.sum(axis=1).tolist() == [2, 0, 0]
    assert np.all(points.flags[0] & BreakPointFlag.EDGE_UNKNOWN)
    assert np.abs(np.sort(points.position_px[0, :, 0]) - np.sort(truth_px[0, :, 0])).max() < 1.0
    assert np.isfinite(points.face_start_undistorted_px[0]).all()


def test_an_edge_beyond_the_border_leaves_the_other_edge_and_whole_lines():
    rig = rig_of(1400.0, 1000, 900)
    shot, truth_px = shot_of(rig, 0.35, SWITCHED, x_m=0.467)

    points = found(shot, rig)

    left = points.flags & BreakPointFlag.CLIPPED
    assert points.seen.sum() == 3
    assert np.count_nonzero(left) == 3
    seen_x = np.nanmax(points.position_px[..., 0], axis=1)
    assert np.abs(seen_x - np.nanmax(truth_px[..., 0], axis=1)).max() < 1.0
    assert np.isfinite(points.face_end_undistorted_px).all()


@pytest.mark.parametrize("target", ["none", "body"])
def test_without_a_ring_there_are_no_break_points(target):
    shot, _ = shot_of(NARROW, 0.5, SWITCHED, target=target)

    assert isinstance(detect(shot, NARROW).break_points, NoBreakPoints)


@pytest.mark.slow
def test_a_dark_frame_of_all_lasers_shows_the_ends_as_precisely_as_one_frame_for_each():
    """Where no ambient light is, residuals of speckle are not those of a lit surface behind the stripes."""
    sigma_px = {}
    for sequence in ("off,1,2,3", "all"):
        scene = read_scene(PRESETS / "paper-physical-scene.yaml")
        view = Approach(count=1, distances_m=(0.3,), lights=("dim",), seed=1, name="d", tilt_rad=0.1)
        steps = tuple(step.mask(3) for step in parsed_sequence(sequence))
        scene = replace(scene, sequence=steps, views=(), approaches=(view,))
        points = detect(simulated_shot(scene, ring_views(scene), 0)[0], scene.rig).break_points
        sigma_px[sequence] = np.sqrt(np.nanmean(points.covariance_px2[..., 0, 0]))

    assert sigma_px["all"] == pytest.approx(sigma_px["off,1,2,3"], rel=0.2)
