"""Break points on shots that this project did not make."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from ringpose.detect.pipeline import detect
from ringpose.files.images.shots import read_shot
from ringpose.files.rigs import read_rig
from ringpose.types.detection import BreakPointFlag, BreakPoints, NoBreakPoints
from ringpose.types.image import Shot

pytestmark = pytest.mark.slow

FOLDERS = ["rig_a", "rig_b", "variants_a", "variants_b"]


@pytest.fixture(scope="module")
def errors(shared_data):
    """Along-stripe error, its sigma, flags and truth of every break point, and shots without any."""
    rows, lost, missed, false = [], [], [], []
    for folder in FOLDERS:
        root = shared_data / "rendered" / folder
        rig = read_rig(root / "rig.yaml")
        for line in (root / "truth.jsonl").read_text().splitlines():
            truth = json.loads(line)
            found = detect(read_shot(root / "shots" / f"{truth['shot']}.npz"), rig).break_points
            if isinstance(found, NoBreakPoints):
                lost.append((truth["shot"], found))
                continue
            _compare(truth, found, rows, missed, false)
    return {"rows": rows, "lost": lost, "missed": missed, "false": false}


def _compare(truth: dict, found: BreakPoints, rows: list, missed: list, false: list) -> None:
    for laser, edges in enumerate(truth["break_points_px"]):
        for edge, position in enumerate(edges):
            seen = bool(found.seen[laser, edge])
            if position is None and seen:
                false.append((truth["shot"], laser, edge))
            if position is not None and not seen:
                missed.append((truth["shot"], laser, edge, int(found.flags[laser, edge])))
            if position is not None and seen:
                error = found.position_px[laser, edge] - position
                sigma = np.sqrt(found.covariance_px2[laser, edge, 0, 0])
                rows.append((truth["groups"]["kind"], *error, sigma, int(found.flags[laser, edge]), truth["shot"]))


def test_no_shot_is_lost(errors):
    assert errors["lost"] == []


def test_occluded_break_points_are_not_reported(errors):
    assert errors["false"] == []


def test_what_is_missed_is_flagged_and_rare(errors):
    assert len(errors["missed"]) <= 2
    assert all(flags for *_, flags in errors["missed"])


def test_errors_along_the_stripe_are_a_quarter_of_a_pixel(errors):
    along = np.array([row[1] for row in errors["rows"] if row[0] != "chamfer"])

    assert 1.4826 * np.median(np.abs(along)) < 0.25
    assert abs(np.median(along)) < 0.05


def test_errors_across_the_stripe_are_below_a_tenth_of_a_pixel(errors):
    across = np.array([row[2] for row in errors["rows"]])

    assert 1.4826 * np.median(np.abs(across)) < 0.06


def test_gross_errors_carry_a_flag(errors):
    said = BreakPointFlag.SATURATED | BreakPointFlag.KINK | BreakPointFlag.OCCLUDED | BreakPointFlag.EDGE_UNKNOWN
    unsaid = [row for row in errors["rows"] if row[0] != "chamfer" and abs(row[1]) > 1.5 and not row[4] & said]

    assert unsaid == []


def _all_on(shot: Shot) -> Shot:
    one = [int(np.argmax(shot.lasers))]
    parts = {name: getattr(shot, name)[one] for name in ("images", "lasers", "stamp_s", "exposure_s")}
    return replace(shot, **parts)


@pytest.fixture(scope="module")
def single_errors(shared_data):
    """The same rows from the frame with all lasers alone."""
    rows: list = []
    for folder in FOLDERS:
        root = shared_data / "rendered" / folder
        rig = read_rig(root / "rig.yaml")
        for line in (root / "truth.jsonl").read_text().splitlines():
            truth = json.loads(line)
            shot = _all_on(read_shot(root / "shots" / f"{truth['shot']}.npz"))
            found = detect(shot, rig).break_points
            if isinstance(found, BreakPoints):
                _compare(truth, found, rows, [], [])
    return rows


def test_without_a_dark_frame_wrong_ends_are_flagged(single_errors):
    unsaid = [row for row in single_errors if not row[4] & ~int(BreakPointFlag.SATURATED)]

    assert [row for row in unsaid if abs(row[1]) > min(1.5, 5 * row[3])] == []


def test_without_a_dark_frame_unflagged_ends_have_consistent_covariances(single_errors):
    clear = np.array([row[1] / row[3] for row in single_errors if row[4] == 0])

    low, high = chi2.interval(0.99, len(clear))
    assert low < np.sum(clear**2) < high


def test_without_a_dark_frame_nearly_all_ends_are_found(single_errors):
    assert len(single_errors) > 230
