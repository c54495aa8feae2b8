"""Brief records: their rounding is small against the errors, in each combination of values."""

import json
from dataclasses import replace

import numpy as np
import pytest
from whole_records import complete_line, complete_track, record_of

from ringpose.files.records.brief import rounded
from ringpose.files.records.poses import pose_line_of
from ringpose.files.records.tracks import line_record


def with_correlated_errors(line):
    """A pose whose centre and radii are known to 3 mm, and the edges near the stripes to 0.01 mm."""
    jacobian = np.eye(7)
    jacobian[5, 3] = jacobian[6, 3] = 1.0
    sigmas = np.array([2e-3, 4e-3, 3e-4, 3e-3, 3e-3, 1e-5, 1e-5])
    return replace(line, pose=replace(line.pose, covariance=jacobian @ np.diag(sigmas**2) @ jacobian.T))


def parameters(record):
    pose = record["pose"]
    return np.array([*pose["center_m"], pose["radius_inner_m"], pose["radius_outer_m"]])


@pytest.fixture
def full(rng):
    return record_of(line_record(with_correlated_errors(complete_line(rng)), brief=True))


def test_the_edge_keeps_its_place_where_centre_and_radius_are_known_much_less(full):
    short = rounded(full)

    moved_m = np.abs(parameters(short) - parameters(full))
    assert 0 < moved_m.max() < 0.05 * 1e-5  # the edge is known to 0.01 mm, the centre to 3 mm


def test_values_have_no_more_decimals_than_their_errors_justify(full):
    short = rounded(full)

    assert all(len(repr(value).partition(".")[2]) <= 7 for value in parameters(short).tolist())
    assert all(
        len(repr(angle).partition(".")[2]) <= 5 for angle in (short["pose"]["pitch_rad"], short["pose"]["yaw_rad"])
    )
    assert len(json.dumps(short)) < 0.85 * len(json.dumps(full))


@pytest.mark.parametrize("key", ["full", "center", "grasp"])
def test_each_combination_of_values_keeps_its_variance(rng, full, key):
    exact, short = (np.array(record["pose"]["covariance"][key]) for record in (full, rounded(full)))
    directions = rng.normal(size=(1000, len(exact)))

    ratios = np.einsum("ni,ij,nj->n", directions, short, directions) / np.einsum(
        "ni,ij,nj->n", directions, exact, directions
    )

    assert np.abs(ratios - 1).max() < 0.05


def test_a_brief_line_is_read(full):
    pose_line_of(rounded(full), "x")


@pytest.mark.parametrize("missing", ["covariance", "pose"])
def test_what_has_no_errors_is_not_rounded(full, missing):
    record = full | {"pose": None if missing == "pose" else full["pose"] | {"covariance": None}}

    assert rounded(record)["pose"] == record["pose"]


def test_null_stays_null(full):
    covariance = np.array(full["pose"]["covariance"]["full"], dtype=object)
    covariance[3:, :] = covariance[:, 3:] = None
    pose = full["pose"] | {"center_m": None, "radius_inner_m": None}
    pose["covariance"] = full["pose"]["covariance"] | {"full": covariance.tolist(), "center": None}

    short = rounded(full | {"pose": pose})["pose"]

    assert (short["center_m"], short["radius_inner_m"], short["covariance"]["center"]) == (None, None, None)
    assert short["covariance"]["full"][4] == [None] * 7


def test_a_line_of_a_track_is_rounded_too(rng):
    full = record_of(line_record(complete_track(rng), brief=True))

    short = rounded(full)

    assert short.keys() == full.keys()
    assert len(json.dumps(short)) < len(json.dumps(full))
