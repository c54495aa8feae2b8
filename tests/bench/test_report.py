"""The report of `ringpose bench --json`: its schema, and the scores that are read from it."""

import json
from dataclasses import replace

import jsonschema
import pytest
from schemas import validated

from ringpose.bench.assumptions import AssumedRadii, StatedAssumptions
from ringpose.bench.report import recorded_scores, report
from ringpose.bench.score import Judgement, Matching, Outcome, Score
from ringpose.bench.summary import summaries
from ringpose.errors import DataError
from ringpose.files import records
from ringpose.files.schema import Fields
from ringpose.types.assumptions import MotionPrior, RigStability

ASSUMED = StatedAssumptions(
    motion=MotionPrior(speed_sd_m_s=0.025, rate_sd_rad_s=0.04),
    ring_tolerance_m=1e-4,
    stability=RigStability(plane_tilt_rad=1e-4, plane_distance_m=2e-5, focal_ratio=1e-4),
    radii=AssumedRadii(source="given", outer_m=0.597, sd_m=0.0005),
)
MEASURED = Score(
    shot="a", method="ml", outcome=Outcome.WRONG, status="ok", groups={"light": "dim", "distance_m": 0.5, "foil": True},
    errors={"center_m": 0.002, "center_nees": 1.5, "normal_rad": 0.01},
    judgements={"center": Judgement.WRONG, "normal": Judgement.CORRECT}, distances={"center": 7.0, "normal": 0.5},
    gross=("center",), assumptions=ASSUMED, latency_s=0.02, rig="0" * 64,
)  # fmt: skip
SCORES = [
    MEASURED,
    replace(MEASURED, shot="b", assumptions=replace(ASSUMED, motion=None, radii=None), rig=""),
    Score(shot="c", method="ml", outcome=Outcome.LOST, status="lost"),
]
MATCHING = Matching(truths=3, matched=2, without_truth=("d",), repeated=(), unsorted=False)


@pytest.fixture
def written() -> dict:
    """A report as it is read from its file."""
    made = report(summaries(SCORES, ["light"]), SCORES, ["center_m: too large"], MATCHING, ["1" * 64], {"version": "0"})
    return json.loads(records.line_of(made))


def test_a_report_fits_its_schema_and_has_the_scores_that_were_written(written):
    validated(written, "bench")

    assert recorded_scores(Fields("x", written)) == SCORES


def test_a_report_counts_wrong_quantities_and_different_assumptions(written):
    everything = written["groups"][-1]

    assert (everything["group"], everything["shots"], everything["outcomes"]["lost"]) == ({}, 3, 1)
    assert everything["wrong"] == {"count": 2, "judged": 4, "allowed": 0, "gross": 2, "none_wrong": False}
    assert everything["quantities"].keys() == {"center", "normal"}
    assert [(each["motion"] == "still", each["shots"]) for each in written["assumptions"]] == [(False, 1), (True, 1)]


@pytest.mark.parametrize(
    ("part", "key", "value"),
    [
        ("shots", "outcome", "good"),
        ("shots", "latency_s", -1.0),
        ("shots", "judgements", {"center": "good"}),
        ("shots", "errors", {"center_m": "2 mm"}),
        ("shots", "assumptions", {"motion": "slow"}),
        ("groups", "outcomes", {"ok": 1}),
        ("groups", "wrong", {"count": 1}),
        ("groups", "errors", {"center_m": {"count": 1}}),
        ("assumptions", "shots", 0),
    ],
)
def test_a_spoiled_report_does_not_fit_its_schema(written, part, key, value):
    written[part][0][key] = value

    with pytest.raises(jsonschema.ValidationError):
        validated(written, "bench")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("outcome", "lots", "x: shots[0].outcome: is 'lots', must be one of ok, degraded, missed"),
        ("errors", {"center_m": "2 mm"}, "x: shots[0].errors.center_m: is the text '2 mm', must be a number"),
        ("gross", [1], "x: shots[0].gross: must be a list of texts"),
        ("assumptions", {"motion": "still"}, "x: shots[0].assumptions: has no key 'ring_tolerance_m'"),
    ],
)
def test_a_spoiled_report_is_rejected_with_its_place(written, key, value, message):
    written["shots"][0][key] = value

    with pytest.raises(DataError) as caught:
        recorded_scores(Fields("x", written))

    assert str(caught.value).startswith(message)


def test_a_report_of_version_2_assumes_a_still_and_perfect_ring(written):
    earlier = written | {"ringpose": "bench/2"}

    assert {score.assumptions for score in recorded_scores(Fields("x", earlier))} == {StatedAssumptions()}
