"""From a shot or a detection to its pose line, and what is reported about it."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_scene import DrawnScene, draw_shot, drawn_rig

from ringpose.detect.pipeline import detect
from ringpose.files.records import plain
from ringpose.files.records.detections import detection_of, detection_record
from ringpose.measure.stream import Setup, pose_line
from ringpose.pose.advice import remarks_on
from ringpose.pose.rig_monitor import SHOTS_NEEDED, DriftMonitor
from ringpose.types.assumptions import AssumptionOptions
from ringpose.types.detection import NoBreakPoints, Rejection
from ringpose.types.pose import LaserState, PoseFlag


@pytest.fixture(scope="module")
def shot():
    return draw_shot(DrawnScene(), drawn_rig(), [0, 1, 2, 4], np.random.default_rng(1))


def test_a_shot_and_its_detection_give_the_same_pose_line(shot):
    rig = drawn_rig()

    of_shot, of_detection = Setup(rig=rig).measure(shot), pose_line(detect(shot, rig), rig)

    np.testing.assert_array_equal(of_shot.pose.center_m, of_detection.pose.center_m)
    assert of_shot.latency_s > 0
    assert (of_shot.shot, of_shot.stamp_s, of_shot.flags) == (shot.name, of_detection.stamp_s, of_detection.flags)


def test_a_dark_shot_gives_a_line_with_the_reason(shot):
    line = Setup(rig=drawn_rig()).measure(replace(shot, images=np.zeros_like(shot.images)))

    assert line.pose is None
    assert line.status == "none"
    assert remarks_on(line) == line.reason
    assert line.lasers == dict.fromkeys(drawn_rig().lasers.names, LaserState.NOT_SEEN)


def test_stripes_that_are_on_no_ring_are_stated_as_rejected(shot):
    detection = replace(detect(shot, drawn_rig()), break_points=NoBreakPoints.NO_RING)

    line = pose_line(detection, drawn_rig())

    assert line.lasers == dict.fromkeys(drawn_rig().lasers.names, LaserState.REJECTED)


def test_edges_that_ambient_light_should_show_and_that_were_not_found_are_not_ok(shot):
    detection = replace(detect(shot, drawn_rig()), rejected=(Rejection(what="edge"),))

    line = pose_line(detection, drawn_rig(), options=AssumptionOptions(still=True))

    assert {PoseFlag.EDGE_REJECTED, PoseFlag.INCONSISTENT} <= set(line.flags)
    assert line.status == "degraded"
    assert "ambient light" in line.reason


@pytest.mark.parametrize("is_detected", [False, True])
def test_a_change_of_ambient_light_within_a_shot_is_flagged_and_named(shot, is_detected):
    rig = drawn_rig()
    changed = replace(shot, meta={**shot.meta, "ambient_change_dn": 9.0})

    source = detection_of(plain(detection_record(detect(changed, rig))), "a") if is_detected else changed
    line = Setup(rig=rig).measure(source)

    assert line.status == "degraded"
    assert line.flags & ~Setup(rig=rig).measure(shot).flags == PoseFlag.AMBIENT_CHANGED
    assert "ambient light" in (line.reason or "")


def test_a_weak_center_is_remarked_with_the_measurement_that_would_help(shot):
    line = pose_line(detect(shot, drawn_rig()), drawn_rig(), options=AssumptionOptions(still=True))
    weak = replace(line, pose=replace(line.pose, flags=PoseFlag.CENTER_WEAK))

    assert "the centre is known to" in remarks_on(weak)


def test_a_drift_is_warned_of_once(shot):
    rig = drawn_rig()
    line = Setup(rig=rig).measure(shot)
    contradicted = replace(line, plane_evidence=None, flags=line.flags | PoseFlag.STRIPE_REJECTED)
    monitor = DriftMonitor(rig, rig.stability)

    warnings = [monitor.update(contradicted)[1] for _ in range(2 * int(SHOTS_NEEDED))]

    assert sum(warning is not None for warning in warnings) == 1


def test_every_line_of_a_stream_has_the_health_of_each_laser(shot):
    rig = drawn_rig()
    line, _ = DriftMonitor(rig, rig.stability).update(Setup(rig=rig).measure(shot))

    assert set(line.rig_health) == set(rig.lasers.names)


def test_a_switched_shot_without_stamps_of_its_own_is_weak_unless_it_is_still(shot):
    undated = replace(shot, stamp_s=np.full(len(shot.stamp_s), 1.0))

    line = Setup(rig=drawn_rig()).measure(undated)
    still = Setup(rig=drawn_rig(), options=AssumptionOptions(still=True)).measure(undated)

    assert {PoseFlag.CENTER_WEAK, PoseFlag.NORMAL_WEAK, PoseFlag.GRASP_WEAK} <= set(line.flags)
    assert "--still" in (line.reason or "")
    assert PoseFlag.NORMAL_WEAK not in still.flags
