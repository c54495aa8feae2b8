"""Pose lines as estimates, and estimates matched with truths."""

import pytest
from known_poses import estimate_of, pose_of, truth_of

from ringpose.bench import score
from ringpose.bench.score import Outcome, matching, scores
from ringpose.errors import DataError
from ringpose.types.options import PoseFrame
from ringpose.types.pose import PoseLine


def outcomes(found):
    return [(each.method, each.shot, each.outcome) for each in found]


def test_every_true_shot_is_scored_for_each_method_in_the_order_of_the_truth():
    truths = [truth_of(shot=name) for name in "abc"]
    estimates = [estimate_of(shot="c"), estimate_of(shot="a"), estimate_of(shot="b", method="other")]

    assert outcomes(scores(estimates, truths, None)) == [
        ("paper", "a", Outcome.OK),
        ("paper", "b", Outcome.LOST),
        ("paper", "c", Outcome.OK),
        ("other", "a", Outcome.LOST),
        ("other", "b", Outcome.OK),
        ("other", "c", Outcome.LOST),
    ]
    assert outcomes(scores([], [truth_of()], None)) == [("", "a", Outcome.LOST)]
    found = matching(estimates[:2], truths)
    assert (found.matched, found.truths, found.unsorted) == (2, 3, True)
    assert not matching(estimates[1::-1], truths).unsorted


def test_a_line_without_a_method_counts_for_every_method():
    none = score.estimate_of(PoseLine(shot="b", stamp_s=0.0, pose=None), "poses:1")

    found = scores([none, estimate_of(shot="a")], [truth_of(shot="a"), truth_of(shot="b")], None)

    assert outcomes(found) == [("paper", "a", Outcome.OK), ("paper", "b", Outcome.MISSED)]


def test_a_line_is_an_estimate_in_the_camera_frame_with_the_method_of_its_pose():
    line = PoseLine(shot="a", stamp_s=0.0, pose=pose_of(method="paper"))
    without_pose = score.estimate_of(PoseLine(shot="a", stamp_s=0.0, pose=None, reason="dark"), "poses:1")

    assert (score.estimate_of(line, "poses:1").shot, score.estimate_of(line, "poses:1").method) == ("a", "paper")
    assert (without_pose.line.pose, without_pose.method) == (None, "")
    with pytest.raises(DataError, match="poses:7: is in the tool frame"):
        score.estimate_of(PoseLine(shot="a", stamp_s=0.0, pose=pose_of(), frame=PoseFrame.TOOL), "poses:7")
