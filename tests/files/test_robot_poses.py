"""Poses of a robot that arrive on standard input while a target is measured."""

import numpy as np
import pytest

from ringpose.errors import DataError
from ringpose.files.inputs import Record
from ringpose.files.records import robot_poses
from ringpose.files.records.robot_poses import RobotPoseStream


def arriving(monkeypatch, stamps_s, failure=None):
    """Standard input that has poses with these stamps, and then ends, or fails."""

    def inputs(*_):
        for number, stamp_s in enumerate(stamps_s, start=1):
            pose = {"position_m": [min(stamp_s, 9.0), 0.0, 0.0], "orientation_xyzw": [0.0, 0.0, 0.0, 1.0]}
            yield Record(f"-:{number}", {"stamp_s": stamp_s, "base_from_tool": pose})
        if failure is not None:
            raise failure

    monkeypatch.setattr(robot_poses, "inputs", inputs)


def test_poses_that_arrived_are_given_and_bad_ones_reported(monkeypatch):
    reported = []
    arriving(monkeypatch, [1.0, 2.0, 1.5, 3.0])

    poses = RobotPoseStream(reported.append).until(10.0, 60.0)

    np.testing.assert_array_equal(poses.stamp_s, [1.0, 2.0, 3.0])
    assert ["-:3" in str(problem) for problem in reported] == [True]


def test_repeats_that_arrive_are_left_out_and_counted(monkeypatch):
    arriving(monkeypatch, [1.0, 1.0, 1.0, 2.0])

    stream = RobotPoseStream(pytest.fail)
    poses = stream.until(10.0, 60.0)

    np.testing.assert_array_equal(poses.stamp_s, [1.0, 2.0])
    assert (stream.repeats, stream.received) == (2, 4)


def test_poses_stamped_in_milliseconds_are_reported_with_the_unit(monkeypatch):
    reported = []
    arriving(monkeypatch, [1.0, 2.0, 1.7e12])

    poses = RobotPoseStream(reported.append).until(10.0, 60.0)

    np.testing.assert_array_equal(poses.stamp_s, [1.0, 2.0])
    assert ["give seconds" in str(problem) for problem in reported] == [True]


def test_a_failure_of_standard_input_is_raised_where_poses_are_needed(monkeypatch):
    arriving(monkeypatch, [1.0, 2.0], DataError("-", "has a line of more than 32 MiB"))

    with pytest.raises(DataError, match="32 MiB"):
        RobotPoseStream(lambda _: None).until(10.0, 60.0)


def test_a_pose_without_a_stamp_that_arrives_is_reported_with_its_remedy(monkeypatch):
    pose = {"base_from_tool": {"position_m": [0.0, 0.0, 0.0], "orientation_xyzw": [0.0, 0.0, 0.0, 1.0]}}
    monkeypatch.setattr(robot_poses, "inputs", lambda *_: iter([Record("-:1", {"shot": "a", **pose})]))
    reported = []

    RobotPoseStream(reported.append).until(1.0, 60.0)

    assert ["-:1: has no stamp" in str(problem) and "give stamp_s" in str(problem) for problem in reported] == [True]
