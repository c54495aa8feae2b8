"""Outcomes of captures by constructed grippers, bounds against published values, and claims that chance refutes."""

from dataclasses import replace
from math import nan, radians

import numpy as np
import pytest

from ringpose.bench.capture.score import (
    CaptureOutcome,
    CaptureStatistics,
    captures_text,
    missed_limits,
    outcome_of,
    refuted_claims,
)
from ringpose.files.records import line_of
from ringpose.files.records.captures import RECORD, read_captures
from ringpose.geometry.ring import rotation_by
from ringpose.types.capture import CaptureLine, GripperState, TrueRing

RING = TrueRing(
    center_m=np.array([1.0, 2.0, 3.0]), normal=np.array([0.0, 0.0, -1.0]), radius_inner_m=0.57, radius_outer_m=0.6
)


def line_with(off_m=(0.0, 0.0, 0.0), tilt_rad=0.0, probability=0.99, **keys):
    """A gripper on the middle of the band at x, displaced and tilted."""
    gripper = GripperState(
        grasp_m=RING.center_m + np.array([0.585, 0.0, 0.0]) + off_m,
        approach=rotation_by(np.array([0.0, tilt_rad, 0.0])) @ [0.0, 0.0, 1.0],
    )
    given = {"run": "r", "method": "track", "closed_s": 10.0, "ring": RING, "capture_probability": probability}
    return CaptureLine(**{**given, "gripper": gripper, **keys})


@pytest.mark.parametrize(
    ("off_m", "tilt_deg", "outcome"),
    [
        ((0.0019, 0.0, 0.0), 0.9, CaptureOutcome.SUCCESS),
        ((0.0, 0.0, 0.0021), 0.0, CaptureOutcome.MISS),
        ((0.0015, 0.0, 0.0015), 0.0, CaptureOutcome.MISS),
        ((0.0, 0.0, 0.0), 1.1, CaptureOutcome.MISS),
    ],
)
def test_a_closing_counts_if_band_and_normal_are_within_the_window(off_m, tilt_deg, outcome):
    assert outcome_of(line_with(off_m, radians(tilt_deg))).outcome is outcome


def test_where_along_the_ring_the_gripper_closes_does_not_matter():
    turn = rotation_by(np.array([0.0, 0.0, 1.3]))
    line = line_with()
    moved = replace(line.gripper, grasp_m=RING.center_m + turn @ [0.5855, 0.0, 0.0005])
    scored = outcome_of(replace(line, gripper=moved))

    assert scored.outcome is CaptureOutcome.SUCCESS
    assert scored.radial_m == pytest.approx(0.0005 * np.sqrt(2.0))


def test_a_run_without_closing_has_no_errors():
    scored = outcome_of(line_with(gripper=None, ring=None, closed_s=nan, capture_probability=None))

    assert scored.outcome is CaptureOutcome.NO_CLOSING
    assert scored.radial_m != scored.radial_m


def test_the_bound_of_a_success_share_is_that_of_clopper_and_pearson():
    perfect, one_less = CaptureStatistics(), CaptureStatistics()
    for number in range(50):
        perfect.add(line_with())
        one_less.add(line_with((0.01 * (number == 0), 0.0, 0.0)))

    assert perfect.success_bound == pytest.approx(0.05 ** (1 / 50))  # no failure: alpha^(1/n)
    assert one_less.success_bound == pytest.approx(0.9086, abs=1e-4)  # the 5 % quantile of beta(49, 2)


def test_claims_are_refuted_by_more_misses_than_chance_allows():
    good = [line_with(probability=0.99) for _ in range(95)]
    bad = [line_with((0.01, 0.0, 0.0), probability=0.99) for _ in range(5)]
    doubtful = [line_with((0.01, 0.0, 0.0), probability=0.5) for _ in range(50)]

    # of 100 closings with 0.99 each, four misses have the probability 1.8 %, five 0.3 %
    assert not refuted_claims([*good, *bad[:4], *doubtful])
    assert "5 of 100" in refuted_claims([*good, *bad, *doubtful])[0]


def test_limits_are_missed_by_cells_of_their_own():
    lines = [line_with(groups={"light": "dark"}), line_with((0.01, 0.0, 0.0), groups={"light": "bright"})]
    missed = missed_limits({"min_success_share": 0.9, "max_miss_share": 0.5}, "track", lines, ("light",))

    assert len(missed) == 2
    assert all("light bright" in each for each in missed)
    assert missed_limits({"min_success_share": 0.9}, "ml", lines, ())  # none of this method
    assert "bright" in captures_text(lines, ("light",))


def test_a_record_is_read_as_it_was_written(tmp_path):
    lines = [
        line_with(groups={"light": "dark", "floating_base": True}),
        line_with(gripper=None, ring=None, closed_s=nan),
    ]
    lines[1] = replace(lines[1], reason="no ring is seen", capture_probability=None)
    file = tmp_path / "captures.jsonl"
    file.write_text("".join(line_of(RECORD.write(line)) for line in lines))
    first, second = read_captures(file)

    assert first.groups == {"light": "dark", "floating_base": True}
    np.testing.assert_allclose(first.gripper.grasp_m, lines[0].gripper.grasp_m)
    assert not second.is_closed
    assert second.reason == "no ring is seen"
