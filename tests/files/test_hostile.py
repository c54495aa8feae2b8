"""Property tests: any contents of a file are read, or rejected with one line that names the location."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from schemas import validated

from ringpose.errors import DataError
from ringpose.files import records
from ringpose.files.boards import read_board
from ringpose.files.cameras.formats import read_camera
from ringpose.files.images.shots import read_shot, write_shot
from ringpose.files.records.detections import detection_of, detection_record
from ringpose.files.records.poses import pose_line_of, pose_record
from ringpose.files.records.truths import read_truths
from ringpose.files.rigs import read_rig
from ringpose.types.image import Shot
from ringpose.types.pose import MEASURED_PARAMETERS

NUMBERS = [0, -1, 1e308, -1e-308, 10**400, math.nan, math.inf]
ODD = st.sampled_from([None, True, *NUMBERS, "", "a", "1e3", [], [[]], {}, {"a": 1}, [None], [[1], 2]])

MATRIX = {"rows": 3, "cols": 3, "data": [700.0, 0, 320.5, 0, 710.0, 240.25, 0, 0, 1]}
COEFFICIENTS = {"rows": 1, "cols": 5, "data": [-0.1, 0.12, 1e-4, -2e-4, 0.03]}
CAMERA = {
    "image_width": 640,
    "image_height": 480,
    "camera_matrix": MATRIX,
    "distortion_model": "plumb_bob",
    "distortion_coefficients": COEFFICIENTS,
    "covariance": {"parameters": ["fx", "k1"], "data": [[1.0, 1e-4], [1e-4, 1e-6]]},
}
RIG = {
    "ringpose": "rig/1",
    "provenance": {"version": "0"},
    "camera": CAMERA,
    "lasers": [{"name": "l", "normal": [0, 0.6, -0.8], "distance_m": -0.04, "projector_m": [0, 0, 0]}],
    "covariance": {"parameters": ["fx", "l.tilt_1"], "data": [[1.0, 1e-4], [1e-4, 1e-6]]},
    "mount": {"tool_from_camera": np.eye(4).tolist()},
}
BOARD = {"kind": "four_markers", "width_m": 0.3, "height_m": 0.2, "marker_m": 0.05, "margin_m": 0}
BOARD["dictionary"] = "DICT_4X4_50"
TRUTH = {
    "shot": "a",
    "expect": "pose",
    "center_m": [0, 0, 1],
    "normal": [0, 0, -1],
    "radius_inner_m": 0.5,
    "break_points_px": [[[1, 2], None]],
    "groups": {"a": 1},
}
POINTS = {
    "position_px": [[[1, 2], [None, None]]],
    "covariance_px2": [[[[1, 0], [0, 1]]] * 2],
    "flags": [[0, 1]],
    "face_start_px": [[1, 2]],
    "face_end_px": [[3, 4]],
    "face_sigma_px": [[1, 1]],
    "labelled": True,
    "stamp_s": [1.0],
}
STRIPES = {"position_px": [[1, 2]], "sigma_px": [1], "peak_dn": [9], "piece": [0], "laser": [-1], "stamp_s": [1.0]}
DETECTION = {
    "schema": "ringpose/detection/2",
    "shot": "a",
    "stamp_s": 1.0,
    "reason": None,
    "lasers_on": [True],
    "rejected": [{"what": "point", "laser": "l", "edge": "inner", "chi2": 30.0}],
    "break_points": POINTS,
    "stripes": STRIPES,
    "segments": {"start_px": [[1, 2]], "end_px": [[3, 4]], "support": [20]},
}
POSE = {
    "center_m": [0, 0, 1],
    "normal": [0, 0, -1],
    "pitch_rad": 0,
    "yaw_rad": 0,
    "radius_inner_m": 0.5,
    "radius_outer_m": None,
    "grasp_m": [0, 0, 1],
    "covariance": {"full": np.eye(7).tolist(), "center": None, "grasp": None},
    "ring_posterior": None,
    "method": "paper",
    "residual_rms_px": 0.1,
    "condition_number": 10,
}
MEASUREMENT = {
    "linearized_at": {
        "center_m": [0, 0, 1],
        "normal": [0, 0, -1],
        "radius_inner_m": None,
        "radius_outer_m": 0.5,
        "velocity_m_s": [0, 0, 0],
        "rate_rad_s": [0, 0, 0],
    },
    "parameters": list(MEASURED_PARAMETERS),
    "nuisance_parameters": ["fx"],
    "square_root": np.eye(3, 14).tolist(),
    "degrees_of_freedom": 2,
    "chi2": 1.5,
    "camera_motion": "none",
}
PRIORS = {
    "motion": {"speed_sd_m_s": 0.025, "rate_sd_rad_s": 0.04},
    "radius": {"inner_m": None, "outer_m": 0.5, "sd_m": 0.001, "source": "given"},
    "ring_tolerance_m": 0.0001,
    "rig": {"covariance": "none", "stability": {"plane_tilt_rad": 0, "plane_distance_m": 0, "focal_ratio": 0}},
    "regularization": np.eye(2, 13).tolist(),
}
LINE = {
    "schema": "ringpose/pose/2",
    "pose_stamp_s": 1.05,
    "velocity": {"center_m_s": [0, 0, 0], "rate_rad_s": [0, 0, 0], "covariance": np.eye(5).tolist()},
    "measurement": MEASUREMENT,
    "priors": PRIORS,
    "lasers": {"l": "used"},
    "rejected": [{"what": "point", "laser": "l", "edge": "inner", "chi2": 30.0}],
    "stage_s": {"pose": 0.01},
    "shot": "a",
    "stamp_s": 1.0,
    "frame": "camera",
    "status": "degraded",
    "reason": None,
    "flags": ["center_weak"],
    "pose": POSE,
    "rig_health": {"l": 0.5},
    "shots_dropped": 0,
    "latency_s": 0.1,
    "rig": None,
}
LINE_1 = {
    **{key: value for key, value in LINE.items() if key in ("shot", "stamp_s", "frame", "status", "reason", "flags")},
    "schema": "ringpose/pose/1",
    "pose": POSE | {"condition": 10},
    "laser_health": {"l": 0.5},
    "dropped": 0,
}


def paths(values, here=()):
    """The path of every value in nested values."""
    items = values.items() if isinstance(values, dict) else enumerate(values) if isinstance(values, list) else ()
    for key, item in items:
        yield (*here, key)
        yield from paths(item, (*here, key))


def spoiled(values, path, value):
    if not path:
        return value
    copy = values.copy()
    copy[path[0]] = spoiled(values[path[0]], path[1:], value)
    return copy


def spoiled_once(values):
    return st.builds(lambda path, odd: spoiled(values, path, odd), st.sampled_from(sorted(paths(values), key=str)), ODD)


def outcome(read, source, location: str):
    """The result of reading, or None after a `DataError` of one line that begins with the location."""
    try:
        return read(source)
    except DataError as error:
        message = str(error)
    assert message.startswith(location)
    assert "\n" not in message
    return None


def outcome_of_text(read, folder: Path, text: str):
    file = folder / "file"
    file.write_text(text)
    return outcome(read, file, str(file))


relaxed = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


YAML = pytest.mark.parametrize(
    ("read", "values"),
    [(read_rig, RIG), (read_camera, {"ringpose": "camera/1"} | CAMERA), (read_camera, CAMERA), (read_board, BOARD)],
    ids=["rig", "camera", "ros", "board"],
)


@YAML
def test_valid_yaml_values_are_read(tmp_path, read, values):
    assert outcome_of_text(read, tmp_path, yaml.safe_dump(values)) is not None


@YAML
@relaxed
@given(data=st.data())
def test_invalid_yaml_values_are_read_or_rejected(tmp_path, read, values, data):
    outcome_of_text(read, tmp_path, yaml.safe_dump(data.draw(spoiled_once(values))))


@pytest.mark.parametrize(
    ("read", "write", "values"),
    [
        (detection_of, detection_record, DETECTION),
        (pose_line_of, pose_record, LINE),
        (pose_line_of, pose_record, LINE_1),
    ],
    ids=["detection", "pose line", "pose line of version 1"],
)
@relaxed
@given(data=st.data())
def test_invalid_record_values_are_rejected_or_read_as_a_record_that_fits_the_schema(read, write, values, data):
    assert read(values, "x") is not None

    found = outcome(lambda record: read(record, "x"), data.draw(spoiled_once(values)), "x: ")

    if found is not None:
        rewritten = json.loads(records.line_of(write(found)))
        validated(rewritten | ({"rig": None} if "rig" in rewritten else {}))  # tests may call a rig by any name


@relaxed
@given(values=spoiled_once(TRUTH))
def test_invalid_truth_values_are_read_or_rejected(tmp_path, values):
    outcome_of_text(lambda file: list(read_truths(file)), tmp_path, json.dumps(values) + "\n")


@relaxed
@given(encoded=st.binary(max_size=80))
def test_arbitrary_text_is_read_or_rejected(encoded):
    record = outcome(lambda line: records.parsed_record(line, "x"), encoded.decode(errors="replace"), "x: ")

    assert record is None or isinstance(record, dict)


@pytest.fixture(scope="module")
def whole_shot(tmp_path_factory) -> bytes:
    file = tmp_path_factory.mktemp("shot") / "a.npz"
    images = np.random.default_rng(0).integers(0, 255, (2, 6, 8), dtype=np.uint8)
    times = np.array([1.0, 2.0])
    shot = Shot(
        name="a", images=images, lasers=np.array([0, 1], np.uint8), stamp_s=times, exposure_s=times, meta={"a": 1}
    )
    write_shot(file, shot)
    return file.read_bytes()


@relaxed
@given(data=st.data())
def test_a_shot_with_damaged_bytes_is_read_or_rejected(tmp_path, whole_shot, data):
    damaged = bytearray(whole_shot)
    for offset in data.draw(st.lists(st.integers(0, len(damaged) - 1), min_size=1, max_size=4)):
        damaged[offset] = data.draw(st.integers(0, 255))
    file = tmp_path / "a.npz"
    file.write_bytes(damaged)

    shot = outcome(read_shot, file, str(file))

    assert shot is None or shot.images.shape[0] == 2
