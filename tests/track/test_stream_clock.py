"""Stamps that go back, jump or stray: the track never grows younger without a measurement, nor mixes two clocks."""

from dataclasses import replace

import numpy as np
import pytest
from moving_rings import START_S, Shots, drawn_motion, stream
from tracked_rings import nees_at

from ringpose.track.pipeline import Tracker
from ringpose.track.stream_clock import Arrival, StreamClock
from ringpose.types.pose import PoseFlag, PoseLine
from ringpose.types.track import FusionStatus, TrackLine, Validity


def shifted(line: PoseLine, by_s: float) -> PoseLine:
    """The record of a clock that is ahead by this time."""
    return replace(line, stamp_s=line.stamp_s + by_s, pose_stamp_s=line.pose_stamp_s + by_s)


def unmeasured(stamp_s: float) -> PoseLine:
    """The record of a shot without a ring."""
    return PoseLine(shot=f"none at {stamp_s}", stamp_s=stamp_s, pose=None, reason="no stripe")


def lines_of(tracker: Tracker, records) -> list[TrackLine]:
    return [tracker.line_of(tracker.add(record)) for record in records]


@pytest.mark.parametrize("back_s", [0.5, *(pytest.param(value, marks=pytest.mark.slow) for value in (0.4, 0.75))])
def test_a_clock_that_steps_back_is_flagged_by_the_first_record_and_starts_the_track_anew_with_the_second(rng, back_s):
    motion = drawn_motion(rng)
    records = stream(motion, 3.0, Shots(), rng)
    before, after = records[:12], [shifted(record, -back_s) for record in records[12:]]
    tracker = Tracker(None)

    *_, last = lines_of(tracker, before)
    first, second, *later = lines_of(tracker, after)

    assert (first.attempt.fusion_status, first.stamp_s) == (FusionStatus.PENDING, last.stamp_s)
    assert PoseFlag.INCONSISTENT in first.flags
    assert (second.attempt.fusion_status, second.resets) == (FusionStatus.FUSED, 1)
    assert "set back" in second.attempt.reason
    assert second.stamp_s == after[1].pose_stamp_s
    assert {line.attempt.fusion_status for line in later} == {FusionStatus.FUSED}
    nees = [value for line in later for value in nees_at(motion, replace(line, stamp_s=line.stamp_s + back_s)).values()]
    assert max(nees) < 25.0


STEPS_S = [-0.23, *(pytest.param(step_s, marks=pytest.mark.slow) for step_s in (-1 / 6, -0.05, 0.05)), 0.5]


@pytest.mark.parametrize("ahead_s", STEPS_S, ids=lambda value: f"{value:.2f}")
def test_no_line_after_a_step_ahead_or_by_less_than_two_intervals_is_wrong_without_a_flag(rng, ahead_s):
    """Such a step leaves no two stamps among earlier ones: it is a motion that the gate tests."""
    motion = drawn_motion(rng)
    records = stream(motion, 3.0, Shots(), rng)
    tracker = Tracker(None)
    lines_of(tracker, records[:12])

    lines = lines_of(tracker, [shifted(record, ahead_s) for record in records[12:]])

    unflagged = [line for line in lines if PoseFlag.INCONSISTENT not in line.flags]
    found = [nees_at(motion, replace(line, stamp_s=line.stamp_s - ahead_s)) for line in unflagged]
    assert len(unflagged) >= len(lines) - 3
    assert max(value for each in found for value in each.values()) < 25.0


@pytest.mark.parametrize("measured", [True, False], ids=["measured", "without a measurement"])
def test_a_lost_track_stays_lost_when_an_earlier_record_arrives(records, measured):
    tracker = Tracker(None)
    lines_of(tracker, records[:6])
    newest_s = records[5].pose_stamp_s
    lost = lines_of(tracker, [unmeasured(newest_s + 5.0)])[0]

    (found,) = lines_of(tracker, [records[6] if measured else unmeasured(newest_s + 0.1)])

    assert (lost.validity, found.validity, found.stamp_s) == (Validity.LOST, Validity.LOST, lost.stamp_s)
    assert found.age_s > 4.0


def test_stamps_of_a_track_never_decrease_whatever_the_order_of_arrival(records, rng):
    tracker = Tracker(None)
    mixed = [*records, *(unmeasured(record.pose_stamp_s + rng.uniform(-2.0, 2.0)) for record in records)]
    lines = lines_of(tracker, [mixed[index] for index in rng.permutation(len(mixed))])

    stamps_s = [line.stamp_s for line in lines if line.pose is not None]

    assert len(stamps_s) > len(records)
    assert stamps_s == sorted(stamps_s)


def test_a_track_ages_while_only_shots_without_a_ring_arrive_from_a_clock_that_was_set_back(records):
    tracker = Tracker(None)
    lines_of(tracker, records[:6])

    lines = lines_of(tracker, [unmeasured(START_S - 100.0 + 0.2 * number) for number in range(18)])

    order = [Validity.VALID, Validity.PREDICTED, Validity.STALE, Validity.LOST]
    assert list(dict.fromkeys(line.validity for line in lines)) == order


def test_a_stray_stamp_ahead_of_a_recording_holds_the_track_only_for_as_long_as_one_is_kept(rng):
    records = stream(drawn_motion(rng), 7.0, Shots(), rng)
    tracker = Tracker(None)

    lines = lines_of(tracker, [*records[:6], replace(records[6], pose_stamp_s=START_S + 500.0), *records[7:]])

    assert lines[6].validity is Validity.LOST
    assert {line.resets for line in lines} == {0}
    assert (lines[-1].validity, lines[-1].status) == (Validity.VALID, "ok")
    assert lines[-1].stamp_s == records[-1].pose_stamp_s


def test_a_late_record_that_contradicts_the_track_flags_it(records):
    far = records[8].measurement.linearized_at
    far = replace(far, center_m=far.center_m + np.array([0.0, 0.0, 0.1]))
    tracker = Tracker(None)
    lines_of(tracker, [*records[:8], records[9]])

    (line,) = lines_of(tracker, [replace(records[8], measurement=replace(records[8].measurement, linearized_at=far))])

    assert line.attempt.fusion_status is FusionStatus.REJECTED_GATE
    assert PoseFlag.INCONSISTENT in line.flags


def arrivals(stamps_s) -> list[Arrival]:
    clock, newest_s = StreamClock(3.0), max(stamps_s)
    return [clock.arrived(stamp_s, newest_s, is_ahead=False, is_shot=True) for stamp_s in stamps_s]


def test_late_shots_fill_gaps_also_if_shots_are_not_evenly_spaced(rng):
    stamps_s = np.cumsum(rng.uniform(0.1, 0.13, 60))
    order = np.argsort(stamps_s + rng.choice([0.0, 0.35], 60, p=[0.8, 0.2]))
    order = np.concatenate([np.arange(6), order[~np.isin(order, np.arange(6))]])

    assert set(arrivals(stamps_s[order].tolist())) == {Arrival.IN_ORDER, Arrival.LATE}


def test_one_stray_stamp_among_others_does_not_set_the_clock_back():
    stamps_s = [*(0.1 * number for number in range(10)), 0.43, 1.0, 1.1]

    found = arrivals(stamps_s)

    assert found[10:] == [Arrival.IN_DOUBT, Arrival.IN_ORDER, Arrival.IN_ORDER]
