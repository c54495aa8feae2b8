"""Property tests: any contents of a file are read, or rejected with one line that names the location."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recorded_shots import make_shot
from spoiled_values import outcome, spoiled_once

from ringpose.files import records
from ringpose.files.boards import read_board
from ringpose.files.cameras.formats import read_camera
from ringpose.files.images.shots import read_shot, write_shot
from ringpose.files.rigs import read_rig

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
@pytest.mark.filterwarnings("ignore::ringpose.errors.ImplausibleValueWarning")
def test_invalid_yaml_values_are_read_or_rejected(tmp_path, read, values, data):
    outcome_of_text(read, tmp_path, yaml.safe_dump(data.draw(spoiled_once(values))))


@relaxed
@given(encoded=st.binary(max_size=80))
def test_arbitrary_text_is_read_or_rejected(encoded):
    record = outcome(lambda line: records.parsed_record(line, "x"), encoded.decode(errors="replace"), "x: ")

    assert record is None or isinstance(record, dict)


@pytest.fixture(scope="module")
def whole_shot(tmp_path_factory) -> bytes:
    file = tmp_path_factory.mktemp("shot") / "a.npz"
    images = np.random.default_rng(0).integers(0, 255, (2, 6, 8), dtype=np.uint8)
    shot = make_shot(images, [0, 1], meta={"a": 1})
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
