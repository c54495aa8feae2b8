import math
from dataclasses import replace

import numpy as np
import pytest
from schemas import validated
from whole_records import full_detection, record_of

from ringpose.errors import DataError
from ringpose.files.npz import Archive
from ringpose.files.records.detections import detection_in, detection_of, detection_record, write_detection
from ringpose.types.detection import BreakPoints, Detection, NoBreakPoints, Segments


def same(first, second) -> bool:
    names = type(first).__slots__
    pairs = [(getattr(first, name), getattr(second, name)) for name in names]
    return all(
        a is b or np.array_equal(a, b, equal_nan=isinstance(a, np.ndarray) and a.dtype.kind == "f") for a, b in pairs
    )


def through_json(detection, full=True):
    return detection_of(validated(record_of(detection_record(detection, full))), "x")


def written(detection, folder):
    write_detection(folder / "a.npz", detection)
    return folder / "a.npz"


def through_file(detection, folder):
    return detection_in(Archive(written(detection, folder)))


@pytest.fixture(params=["json", "npz"])
def there_and_back(request, tmp_path):
    return through_json if request.param == "json" else lambda detection: through_file(detection, tmp_path)


def test_axes_of_a_ring_that_are_not_perpendicular_are_rejected(rng):
    before = full_detection(rng)
    before = replace(before, ring=replace(before.ring, axes=before.ring.axes[[0, 0, 2]]))

    with pytest.raises(DataError, match="perpendicular"):
        through_json(before)


def test_a_file_has_what_the_record_has(rng, tmp_path):
    before = full_detection(rng)

    assert record_of(detection_record(through_file(before, tmp_path))) == record_of(detection_record(before))


def test_detection_without_time_stamps_is_read_without(rng, there_and_back):
    before = full_detection(rng)
    parts = {name: replace(getattr(before, name), stamp_s=None) for name in ("break_points", "stripes", "segments")}

    after = there_and_back(replace(before, **parts, lasers_on=None, rejected=()))

    assert [getattr(after, name).stamp_s for name in parts] == [None] * 3
    assert (after.lasers_on, after.rejected) == (None, ())


def test_version_1_is_read_without_time_stamps(rng):
    record = record_of(detection_record(full_detection(rng))) | {"schema": "ringpose/detection/1"}
    for part in ("break_points", "stripes", "segments"):
        del record[part]["stamp_s"]
    del record["lasers_on"], record["rejected"], record["rig"]

    after = detection_of(record, "x")

    assert after.found
    unknown = after.break_points.stamp_s, after.stripes.stamp_s, after.lasers_on
    assert (unknown, after.rejected, after.rig) == ((None,) * 3, (), "")


def test_rejections_that_are_not_json_are_refused(rng, tmp_path):
    arrays = dict(np.load(written(full_detection(rng), tmp_path)))
    np.savez(tmp_path / "b.npz", **arrays | {"rejected": np.array("[{")})

    with pytest.raises(DataError, match=r"b\.npz: rejected: is not valid JSON"):
        detection_in(Archive(tmp_path / "b.npz"))


@pytest.mark.parametrize("key", ["break_points", "shot.name"])
def test_a_key_beside_its_parts_is_refused(key, rng, tmp_path):
    arrays = dict(np.load(written(full_detection(rng), tmp_path)))
    np.savez(tmp_path / "b.npz", **arrays | {key: np.array("a")})

    with pytest.raises(DataError, match=r"b\.npz: .* is given beside its parts"):
        detection_in(Archive(tmp_path / "b.npz"))


def test_nothing_found_is_read_as_nothing(there_and_back):
    nothing = Segments(start_px=np.empty((0, 2)), end_px=np.empty((0, 2)), support=np.empty(0, np.int64))
    before = Detection(shot="a", stamp_s=math.nan, break_points=NoBreakPoints.NO_STRIPE, segments=nothing)

    after = there_and_back(before)

    assert (after.break_points, after.stripes) == (NoBreakPoints.NO_STRIPE, None)
    assert same(after.segments, nothing)
    assert math.isnan(after.stamp_s)


@pytest.mark.parametrize("reason", NoBreakPoints)
def test_every_reason_survives(reason, there_and_back):
    assert there_and_back(Detection(shot="a", stamp_s=0.0, break_points=reason)).break_points is reason


def test_short_record_leaves_stripes_and_segments_out(rng):
    after = through_json(full_detection(rng), full=False)

    assert (after.stripes, after.segments) == (None, None)
    assert isinstance(after.break_points, BreakPoints)


def changed_record(rng, part, key, value):
    record = record_of(detection_record(full_detection(rng)))
    (record[part] if part else record)[key] = value
    return record


@pytest.mark.parametrize(
    ("part", "key", "value", "finding"),
    [
        ("", "schema", "ringpose/pose/1", "schema: is 'ringpose/pose/1', must be 'ringpose/detection/2' or "),
        ("", "lasers_on", [True, 1, False], "lasers_on: must be a list of true or false"),
        ("", "lasers_on", [True], "lasers_on: has 1 lasers, break_points has 3"),
        ("", "rejected", {}, "rejected: is a mapping, must be a list"),
        ("", "rejected", [{"what": "point", "edge": "upper"}], "rejected[0].edge: is 'upper', must be one of inner"),
        ("break_points", "stamp_s", [1.0], "break_points.stamp_s: has 1 numbers, must have 3"),
        ("stripes", "stamp_s", [None] * 4, "stripes.stamp_s: has null or NaN among its numbers"),
        ("segments", "stamp_s", ["now"] * 7, "segments.stamp_s: must be 7 numbers"),
        ("", "shot", "", "shot: is the text '', must be a text"),
        ("", "break_points", None, "is a detection with neither break_points nor a reason"),
        ("break_points", "flags", [[0, 0], [0, 1.5], [0, 0]], "break_points.flags: has a number that is not whole"),
        ("break_points", "flags", [[0, 0]], "break_points.flags: has 1 x 2 numbers, must have 3 x 2"),
        ("break_points", "flags", [[0, 0], [0, 1e30], [0, 0]], "break_points.flags: has a number that is not whole"),
        ("break_points", "face_sigma_px", [[1, 1], [1, -1], [1, 1]], "break_points.face_sigma_px: has a st"),
        ("break_points", "face_sigma_px", [[1, 1], [1, 1e9], [1, 1]], "break_points.face_sigma_px: has a st"),
        ("break_points", "covariance_px2", [[[[1, 2], [2, 1]]] * 2] * 3, "break_points.covariance_px2: has a m"),
        ("break_points", "covariance_px2", [[[[1, 0], [0.1, 1]]] * 2] * 3, "break_points.covariance_px2: has a matri"),
        ("break_points", "covariance_px2", [[[[-1, 0], [0, 1]]] * 2] * 3, "break_points.covariance_px2: has a matrix"),
        ("break_points", "covariance_px2", [[[[1e9, 0], [0, 1]]] * 2] * 3, "break_points.covariance_px2: has a stand"),
        ("break_points", "position_px", [[[1, None], [1, 2]]] * 3, "break_points.position_px: has a point"),
        ("break_points", "face_end_px", [[None, 2]] * 3, "break_points.face_end_px: has a point of which one coordina"),
        ("break_points", "labelled", 1, "break_points.labelled: is 1, must be true or false"),
        ("stripes", "piece", [9] * 50, "stripes.piece: has an index out of range"),
        ("stripes", "sigma_px", [1.0], "stripes.sigma_px: has 1 numbers, must have 50"),
        ("segments", "end_px", [], "segments.end_px: has 0 numbers, must have 7 x 2"),
        ("ring_edges", "edge", [0] * 8 + [2], "ring_edges.edge: has a value other than 0 (inner) and 1 (outer)"),
        ("ring_edges", "normal", [[0, 1]] * 8 + [[0, 0]], "ring_edges.normal: has a vector of length 0"),
    ],
)
def test_impossible_record_is_refused_with_its_place(rng, part, key, value, finding):
    with pytest.raises(DataError) as caught:
        detection_of(changed_record(rng, part, key, value), "x:1")

    assert str(caught.value).startswith(f"x:1: {finding}")


def test_unknown_reason_is_refused(rng):
    with pytest.raises(DataError, match="unknown reason 'because'"):
        detection_of(changed_record(rng, "", "break_points", None) | {"reason": "because"}, "x:1")
