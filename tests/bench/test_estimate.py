"""Pose lines as estimates."""

import pytest

from ringpose.bench.score import estimate_of
from ringpose.errors import DataError
from ringpose.types.options import PoseFrame
from ringpose.types.pose import PoseLine


def test_a_line_with_a_pose_names_its_method(pose_of):
    estimate = estimate_of(PoseLine(shot="a", stamp_s=0.0, pose=pose_of(method="paper")), "poses:1")

    assert (estimate.shot, estimate.method) == ("a", "paper")


def test_a_line_without_a_pose_names_none():
    estimate = estimate_of(PoseLine(shot="a", stamp_s=0.0, pose=None, reason="dark"), "poses:1")

    assert (estimate.pose, estimate.method) == (None, "")


def test_poses_in_the_tools_frame_cannot_be_compared(pose_of):
    with pytest.raises(DataError, match="poses:7: is in the tool frame"):
        estimate_of(PoseLine(shot="a", stamp_s=0.0, pose=pose_of(), frame=PoseFrame.TOOL), "poses:7")
