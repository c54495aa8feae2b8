"""Records of every kind: read as they were written, and with any value spoiled read or rejected with one clear line."""

import json
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from schemas import validated
from spoiled_values import outcome, spoiled_once
from whole_records import VERSION_1, complete_line, complete_track, complete_truth, full_detection, record_of

from ringpose.files import records
from ringpose.files.cameras.ros import CameraFile, CameraInfo, Matrix
from ringpose.files.records.detections import detection_of
from ringpose.files.records.poses import pose_line_of
from ringpose.files.rigs import LaserEntry, MountEntry, RigFile
from ringpose.files.schemas import RECORDS
from ringpose.types.assumptions import RigStability
from ringpose.types.board import Board
from ringpose.types.rig import ParameterCovariance, RobotPose, ToolPose
from ringpose.types.session import Capture, Session

Values = dict[str, Any]


RNG = np.random.default_rng(1)
SESSION = Session(
    captures=(
        Capture(camera="files:x", lasers="none:", shots=("c",)),
        Capture(
            camera="sim:scene.yaml", camera_name="drawn", lasers="sim:", laser_count=3, laser_names=("a", "b", "c"),
            sequence="off,1,2,3,off", exposure_s=0.01, rate_hz=10.0, state="finished", shots=("a", "b"),
            provenance={"version": "0"},
        ),
    )
)  # fmt: skip
TOOL = ToolPose(position_m=np.array([0.5, 0.0, 1.0]), orientation_xyzw=np.array([0.0, 0.6, 0.0, 0.8]))
CAMERA = CameraFile(
    image_width=640, image_height=480, camera_name="a",
    camera_matrix=Matrix(rows=3, cols=3, data=np.array([700.0, 0, 320.5, 0, 710.0, 240.25, 0, 0, 1])),
    distortion_model="plumb_bob",
    distortion_coefficients=Matrix(rows=1, cols=5, data=np.array([-0.1, 0.12, 1e-4, -2e-4, 0.03])),
    covariance=ParameterCovariance(parameters=("fx", "k1"), data=np.array([[1.0, 1e-4], [1e-4, 1e-6]])),
    provenance={"version": "0"},
)  # fmt: skip
RIG = RigFile(
    camera=CameraInfo(**{field.name: getattr(CAMERA, field.name) for field in fields(CameraInfo)}),
    lasers=(
        LaserEntry(name="l", normal=np.array([0.0, 0.6, -0.8]), distance_m=-0.04, projector_m=np.array([0.1, 0, 0])),
        LaserEntry(name="r", normal=np.array([0.0, 0.6, -0.8]), distance_m=0.04),
    ),
    covariance=ParameterCovariance(parameters=("l.tilt_1",), data=np.array([[1e-8]])),
    stability=RigStability(plane_tilt_rad=1e-3),
    mount=MountEntry(tool_from_camera=np.eye(4), covariance=np.eye(6), delay_s=0.1, delay_sd_s=0.01),
)
KNOWN: Mapping[str, Any] = {
    "pose": complete_line(RNG),
    "track": complete_track(RNG),
    "detection": full_detection(RNG, centers=2),
    "truth": complete_truth(RNG),
    "session": SESSION,
    "rig": RIG,
    "camera": CAMERA,
    "board": Board(
        kind="charuco",
        squares_x=7,
        squares_y=5,
        square_m=0.03,
        marker_m=0.02,
        dictionary="DICT_4X4_50",
        legacy_pattern=True,
    ),
    "robot-pose": RobotPose(stamp_s=1.7e9, base_from_tool=TOOL),
}
"""Of each kind a record in which everything is known."""

WRITTEN: Mapping[str, Values] = {name: record_of(RECORDS[name].write(known)) for name, known in KNOWN.items()}


def earlier_detection(values: Values) -> Values:
    """As version 1 had it."""
    added = ("lasers_on", "rejected", "rig", "ring", "repeated", "software")
    parts = ("break_points", "stripes", "segments", "ring_edges")
    older = {part: {key: value for key, value in values[part].items() if key != "stamp_s"} for part in parts}
    kept = {key: value for key, value in (values | older).items() if key not in added}
    return kept | {"schema": "ringpose/detection/1"}


EARLIER: Mapping[str, Values] = {"pose": VERSION_1, "detection": earlier_detection(WRITTEN["detection"])}

READ: Mapping[str, Callable[[Values, str], Any]] = {
    **{name: each.read for name, each in RECORDS.items()},
    "pose": pose_line_of,
    "detection": detection_of,
}


def rewritten(name: str, found: Any) -> Values:
    """The record that is written of what was read; it fits its schema."""
    values: Values = json.loads(records.line_of(RECORDS[name].write(found)))
    return validated(values, name)


def test_there_is_an_example_of_every_kind():
    assert set(KNOWN) == set(RECORDS)


@pytest.mark.parametrize("name", WRITTEN)
def test_a_record_is_read_as_it_was_written_and_other_keys_are_ignored(name):
    values = WRITTEN[name]

    found = READ[name](values | {"x_more": {"a": [1]}}, "x")

    assert rewritten(name, found) == values


@pytest.mark.parametrize("name", WRITTEN)
def test_unknown_keys_are_ignored_in_records_and_rejected_in_what_people_write(name):
    found = outcome(lambda values: READ[name](values, "x"), WRITTEN[name] | {"more": 1}, "x: unknown key 'more'; ")

    assert (found is None) == RECORDS[name].strict


@pytest.mark.parametrize(
    ("name", "values"),
    [*WRITTEN.items(), *EARLIER.items()],
    ids=[*WRITTEN, *(f"{name} of version 1" for name in EARLIER)],
)
@given(data=st.data())
def test_a_spoiled_record_is_rejected_with_its_place_or_read(name, values, data):
    assert READ[name](values, "x") is not None

    found = outcome(lambda spoiled: READ[name](spoiled, "x"), data.draw(spoiled_once(values)), "x: ")

    if found is not None:
        once = json.loads(records.line_of(RECORDS[name].write(found)))
        validated(once | ({"rig": None} if "rig" in once else {}), name)  # tests call a rig by any name
        assert json.loads(records.line_of(RECORDS[name].write(READ[name](once, "x")))) == once
