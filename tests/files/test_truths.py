import json

import numpy as np
import pytest

from ringpose.errors import DataError
from ringpose.files.records.truths import read_truths

LINE = {
    "shot": "a",
    "center_m": [0.1, 0.2, 0.5],
    "normal": [0, 0.6, -0.8],
    "radius_inner_m": 0.567,
    "radius_outer_m": 0.597,
    "break_points_px": [[[1, 2], None], [None, None]],
    "expect": "partial",
    "groups": {"rig": "B", "distance_m": 0.5},
}


FRAME = {"stamp_s": 3.0, "center_m": [0.1, 0.2, 0.5], "normal": [0, 0.6, -0.8], "break_points_px": [[[1, 2], None]]}


def written(path, *lines):
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


def test_missing_break_points_are_nan(tmp_path):
    (truth,) = read_truths(written(tmp_path / "truth.jsonl", LINE))

    assert (truth.shot, truth.expect, truth.groups) == ("a", "partial", {"rig": "B", "distance_m": 0.5})
    nan = [np.nan, np.nan]
    np.testing.assert_array_equal(truth.break_points_px, [[[1, 2], nan], [nan, nan]])


@pytest.mark.parametrize(
    ("key", "value", "finding"),
    [
        ("expect", "poses", "expect: is 'poses', must be one of pose, partial, no_target; did you mean 'pose'?"),
        ("frames", [FRAME, FRAME], "frames: are not in chronological order"),
        ("frames", [FRAME | {"normal": [0, 0, 2]}], "frames[0].normal: has length 2"),
        ("frames", [FRAME | {"velocity": 0}], "frames[0]: unknown key 'velocity'"),
        ("normal", [0, 0, 1.5], "normal: has length 1.5, must be 1"),
        ("radius_outer_m", 597, "radius_outer_m: is 597, must be 0.02 to 5; give metres: 0.597 if"),
        ("break_points_px", [[[1, 2]]], "break_points_px: has 1 x 1 x 2 numbers, must have n x 2 x 2"),
        ("center_m", None, "center_m: is null or missing, must have a value where expect is partial"),
        ("centre_m", [0, 0, 0], "unknown key 'centre_m'; did you mean 'center_m'?"),
        (
            "center_m",
            [100, 200, 500],
            "center_m: has a length that is 547.723, must be 0.05 to 200; give metres: 0.5477 if",
        ),
        ("shot", "z", "shot: 'z' occurs twice"),
    ],
)
def test_an_invalid_truth_is_rejected_with_its_line(tmp_path, key, value, finding):
    file = written(tmp_path / "truth.jsonl", LINE | {"shot": "z"}, LINE | {key: value})

    with pytest.raises(DataError) as caught:
        list(read_truths(file))

    assert str(caught.value).startswith(f"{file}:2: {finding}")
