"""One tolerance of the ring's form for all shots of a track."""

from dataclasses import replace

import numpy as np
import pytest
from tracked_rings import track_of
from whole_records import measurement_with

from ringpose.estimate.nuisance import FORM_PARAMETERS, form_amplitude_m
from ringpose.track.common_errors import common_errors
from ringpose.track.explanations import track_after
from ringpose.track.form_evidence import FormEvidence
from ringpose.track.observation import observation
from ringpose.types.assumptions import Assumptions
from ringpose.types.pose import PoseLine, Priors

ASSUMED_M, OVAL_M = 1e-4, 1e-3
WAVE_SD_M = 2e-4
"""Standard deviation of a wave's amplitude by one shot."""


def seen(wave_m, tolerance_m, rng):
    """A record whose rows show a wave of the inner edge beside the ring, and its measurement."""
    columns = 12 + len(FORM_PARAMETERS) + 1
    rows = np.zeros((14, columns))
    rows[:12, :12] = 1e3 * np.eye(12) + np.triu(100.0 * rng.normal(size=(12, 12)), 1)
    rows[:12, 12:-1] = 300.0 * rng.normal(size=(12, len(FORM_PARAMETERS)))
    rows[12, 12 + FORM_PARAMETERS.index("form.inner.a3")] = 1.0 / WAVE_SD_M
    rows[12, -1] = wave_m / WAVE_SD_M + rng.normal()
    measurement = measurement_with(FORM_PARAMETERS, rows)
    priors = Priors(assumptions=Assumptions(ring_tolerance_m=tolerance_m))
    return PoseLine(shot="a", stamp_s=0.0, pose=None, priors=priors, measurement=measurement)


def judged_m(lines) -> float:
    """The tolerance after these records."""
    evidence = FormEvidence()
    for line in lines:
        common = common_errors(line, line.measurement, None)
        evidence = evidence.with_shot(line, line.measurement, common, 1.0)
    return evidence.tolerance_m(common)


def test_one_shot_in_many_that_is_out_of_round_by_chance_does_not_widen_the_others(rng):
    by_chance, others = seen(5.0 * WAVE_SD_M, OVAL_M, rng), [seen(0.0, ASSUMED_M, rng) for _ in range(60)]

    assert judged_m([by_chance]) == OVAL_M
    assert judged_m([*others, by_chance]) < 1.05 * ASSUMED_M
    assert judged_m([by_chance, *others]) < 1.05 * ASSUMED_M


def test_a_ring_that_is_out_of_round_in_every_shot_keeps_the_larger_tolerance(rng):
    unflagged = [seen(OVAL_M, ASSUMED_M, rng) for _ in range(3)]  # a shot may miss it
    lines = [*unflagged, *(seen(OVAL_M, OVAL_M, rng) for _ in range(60))]

    assert judged_m(lines[:5]) == pytest.approx(OVAL_M, rel=0.05)
    assert judged_m(lines) == pytest.approx(OVAL_M, rel=0.01)


def test_what_a_shot_assumes_beyond_the_common_tolerance_is_an_error_of_its_own(rng):
    """Its information about the ring is that of the rows with independent waves of the difference in variance."""
    others, flagged = [seen(0.0, ASSUMED_M, rng) for _ in range(60)], seen(0.0, OVAL_M, rng)
    evidence = FormEvidence()
    for line in (*others, flagged):
        common = common_errors(line, line.measurement, None)
        evidence = evidence.with_shot(line, line.measurement, common, 1.0)

    shared, found = evidence.judged(flagged.measurement, common)

    tolerance_m = evidence.tolerance_m(common)
    own = form_amplitude_m(1.0) * flagged.measurement.square_root[:, 12:-1]
    covariance = np.eye(14) + (OVAL_M**2 - tolerance_m**2) * own @ own.T
    rows = flagged.measurement.square_root
    np.testing.assert_allclose(
        found.square_root.T @ found.square_root, rows.T @ np.linalg.solve(covariance, rows), rtol=1e-9, atol=1e-6
    )
    np.testing.assert_array_equal(found.square_root[12:, :12], 0.0)
    np.testing.assert_allclose(shared.root, form_amplitude_m(tolerance_m) * np.eye(len(FORM_PARAMETERS)))


def test_many_shots_count_as_if_they_were_kept_one_by_one(rng):
    lines = [seen(0.3 * WAVE_SD_M, ASSUMED_M, rng) for _ in range(40)] + [seen(3.0 * WAVE_SD_M, OVAL_M, rng)] * 2
    common = common_errors(lines[0], lines[0].measurement, None)
    at_once, step_by_step = FormEvidence(), FormEvidence()
    for line in lines:
        at_once = at_once.with_shot(line, line.measurement, common, 1.0)
        step_by_step = step_by_step.with_shot(line, line.measurement, common, 1.0).reduced()

    assert step_by_step.tolerance_m(common) == pytest.approx(at_once.tolerance_m(common), rel=1e-6)
    assert 1.01 * ASSUMED_M < at_once.tolerance_m(common) < 0.99 * OVAL_M


def test_errors_of_a_track_grow_with_the_tolerance_that_its_shots_turn_out_to_have(records, rng):
    """The ring's form has displaced the track as it is, whatever was assumed when the shots before were used."""

    def with_form(line):
        wrt_form = 300.0 * rng.normal(size=(len(line.measurement.square_root), len(FORM_PARAMETERS)))
        root = np.insert(line.measurement.square_root, [12], wrt_form, axis=1)
        triangle = np.asarray(np.linalg.qr(root, mode="r"))
        measurement = replace(line.measurement, nuisance_parameters=FORM_PARAMETERS, square_root=triangle)
        assumptions = replace(line.priors.assumptions, ring_tolerance_m=ASSUMED_M)
        return replace(line, measurement=measurement, priors=replace(line.priors, assumptions=assumptions))

    lines = [with_form(line) for line in records[:6]]
    tracker = track_of(lines[:5])
    before = tracker.track
    common = common_errors(lines[5], lines[5].measurement, None).with_tolerance(10.0 * ASSUMED_M)
    nothing = replace(lines[5].measurement, square_root=1e-9 * lines[5].measurement.square_root)
    observed = observation(lines[5], nothing, common, 1.0)
    as_before = observation(lines[5], nothing, common.with_tolerance(ASSUMED_M), 1.0)

    wider, narrow = (
        track_after(before, each, None, tracker.options)[0].likeliest.common for each in (observed, as_before)
    )

    assert np.abs(narrow).max() > 0.0
    np.testing.assert_allclose(wider, 10.0 * narrow, rtol=1e-6, atol=1e-9 * np.abs(wider).max())
