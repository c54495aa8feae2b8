"""Answers joined with truths."""

from ringpose.bench.score import Outcome, PoseEstimate, matching, scores


def outcomes(found):
    return [(score.method, score.shot, score.outcome) for score in found]


def test_every_true_shot_is_scored_in_the_order_of_the_truth(truth_of, estimate_of):
    truths = [truth_of(shot=name) for name in "abc"]

    found = scores([estimate_of(shot="c"), estimate_of(shot="a")], truths, None)

    assert outcomes(found) == [("paper", "a", Outcome.OK), ("paper", "b", Outcome.LOST), ("paper", "c", Outcome.OK)]


def test_each_method_is_scored_by_itself(truth_of, estimate_of):
    truths = [truth_of(shot=name) for name in "ab"]

    found = scores([estimate_of(shot="a"), estimate_of(shot="b", method="other")], truths, None)

    assert outcomes(found) == [
        ("paper", "a", Outcome.OK),
        ("paper", "b", Outcome.LOST),
        ("other", "a", Outcome.LOST),
        ("other", "b", Outcome.OK),
    ]


def test_a_line_without_a_method_counts_for_every_method(truth_of, estimate_of):
    none = PoseEstimate(shot="b", method="", pose=None)

    found = scores([none, estimate_of(shot="a")], [truth_of(shot="a"), truth_of(shot="b")], None)

    assert outcomes(found) == [("paper", "a", Outcome.OK), ("paper", "b", Outcome.MISSED)]


def test_no_answer_at_all_leaves_every_shot_lost(truth_of):
    assert outcomes(scores([], [truth_of()], None)) == [("", "a", Outcome.LOST)]


def test_answers_without_a_truth_are_named_once(truth_of, estimate_of):
    estimates = [estimate_of(shot="z"), estimate_of(), estimate_of(shot="z", method="other"), estimate_of(shot="y")]

    found = matching(estimates, [truth_of()])

    assert (found.matched, found.truths, found.without_truth) == (1, 1, ("z", "y"))


def test_a_shot_answered_twice_by_one_method_is_repeated(truth_of, estimate_of):
    estimates = [estimate_of(), estimate_of(method="other"), estimate_of(shot="b"), estimate_of()]

    assert matching(estimates, [truth_of(), truth_of(shot="b")]).repeated == ("a",)


def test_answers_in_another_order_than_the_truth_are_matched_all_the_same(truth_of, estimate_of):
    truths = [truth_of(shot=name) for name in "abc"]
    estimates = [estimate_of(shot="c"), estimate_of(shot="a")]

    found = matching(estimates, truths)

    assert (found.matched, found.truths, found.unsorted) == (2, 3, True)
    assert not matching(estimates[::-1], truths).unsorted
