"""The paper's break points: where the chords of its line detector end, against the true ends of drawn stripes."""

import json

import numpy as np
import pytest
from benchmarks.stripe_images import Kind, shot_of, stripe_image, stripe_rig

from ringpose.cli.main import main
from ringpose.detect.pipeline import detect
from ringpose.errors import DataError
from ringpose.measure.stream import Setup
from ringpose.types.options import Method


@pytest.fixture(scope="module")
def dark():
    return stripe_image(Kind.DARK, 1, stripe_rig(lens=False))


def test_pixel_ends_are_pixels_beside_the_true_ends(dark):
    found = detect(shot_of(dark), dark.rig, pixel_ends=True).break_points

    off_px = found.position_px - dark.break_points_px
    assert found.seen.all()
    np.testing.assert_array_equal(2 * found.position_px % 1, 0.0)  # the middle between two pixels
    assert 0.1 < np.abs(off_px).max() < 4.0


def test_pixel_ends_are_less_accurate_than_measured_ones(dark):
    measured, pixels = (detect(shot_of(dark), dark.rig, pixel_ends=ends).break_points for ends in (False, True))

    off = [np.sqrt(np.nanmean((each.position_px - dark.break_points_px) ** 2)) for each in (measured, pixels)]
    assert 3 * off[0] < off[1]


def test_the_pose_by_pixel_ends_has_its_own_name_and_larger_errors(carried_data, capsys):
    data, names = carried_data / "rig_b", ("paper", "paper-detector")
    shot = str(data / "shots" / "B_z0500_p01_dim.npz")
    tilts = {}
    for name in names:
        assert main(["pose", shot, "--rig", str(data / "rig.yaml"), "--method", name]) == 0
        record = json.loads(capsys.readouterr().out)
        assert record["pose"]["method"] == name
        truths = map(json.loads, (data / "truth.jsonl").read_text().splitlines())
        normal = next(each["normal"] for each in truths if each["shot"] == record["shot"])
        tilts[name] = np.degrees(np.linalg.norm(np.cross(normal, record["pose"]["normal"])))
    assert tilts["paper"] < 0.5 < tilts["paper-detector"]


def test_a_detection_has_no_pixel_ends(dark):
    setup = Setup(rig=dark.rig, method=Method.PAPER_DETECTOR)

    with pytest.raises(DataError, match="give the shot"):
        setup.measure(detect(shot_of(dark), dark.rig))
