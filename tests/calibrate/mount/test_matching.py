"""Which pose of the robot belongs to which view."""

import numpy as np
import pytest

from ringpose.calibrate.mount.matching import matched_poses
from ringpose.errors import DataError
from ringpose.types.robot import ReportedPose


def pose(stamp_s, x_m=0.0, name=""):
    return ReportedPose("poses.csv:1", name, stamp_s, np.array([x_m, 0.0, 0.0]), np.eye(3))


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1)])
def test_the_pose_nearest_in_time_is_taken_whatever_the_order(order):
    poses = [pose(1000.0, 0.1), pose(1005.0, 0.2), pose(1010.0, 0.3)]

    matched = matched_poses(["a", "b"], [1005.1, 1009.8], [poses[index] for index in order], "poses.csv")

    assert [found.position_m[0] for found in matched] == [0.2, 0.3]


def test_a_robot_that_moves_has_no_pose_for_the_view():
    (found,) = matched_poses(["a"], [1000.5], [pose(1001.0, 0.2), pose(1000.0, 0.1)], "poses.csv")

    assert isinstance(found, DataError)
    assert "moved while it was taken, by 100 mm" in str(found)


def test_images_and_poses_are_paired_by_the_numbers_in_their_names():
    matched = matched_poses(
        ["img2", "img10"], [0.0, 0.0], [pose(None, 0.3, "pose_010"), pose(None, 0.1, "pose_002")], "p"
    )

    assert [found.position_m[0] for found in matched] == [0.1, 0.3]


def test_targets_of_a_robots_program_belong_to_as_many_images_in_their_order():
    poses = [pose(None, 0.1, "p10"), pose(None, 0.2, "p20"), pose(None, 0.3, "p30")]

    matched = matched_poses(["view10", "view11", "view12"], [0.0, 0.0, 0.0], poses, "p")

    assert [found.position_m[0] for found in matched] == [0.1, 0.2, 0.3]


def test_stamps_of_another_clock_are_reported_once_for_all_images():
    with pytest.raises(DataError, match=r"poses\.tum: its stamps are all 994 s or more away.*leave the stamps out"):
        matched_poses(["a", "b"], [2000.0, 2004.0], [pose(1000.0), pose(1006.0)], "poses.tum")


def test_a_pose_that_names_no_shot_beside_others_that_do_is_named_by_its_line():
    unnamed = pose(None)._replace(location="poses.jsonl:2")

    with pytest.raises(DataError, match=r"poses\.jsonl:2: names no shot"):
        matched_poses(["a", "b"], [0.0, 0.0], [pose(None, name="a"), unnamed], "poses.jsonl")
