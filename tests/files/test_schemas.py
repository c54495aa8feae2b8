"""Each JSON Schema accepts what is written, and refuses a broken record; pose lines have their own tests."""

import copy
import re
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import yaml
from schemas import SCHEMAS, validated
from whole_records import record_of

from ringpose.files.images.sessions import write_session
from ringpose.files.records.detections import detection_record
from ringpose.files.records.truths import truth_record
from ringpose.types.detection import Detection, NoBreakPoints
from ringpose.types.pose import LaserState, PoseFlag
from ringpose.types.session import Capture, Session
from ringpose.types.truth import Truth

DETECTION = record_of(detection_record(Detection(shot="a", stamp_s=1.0, break_points=NoBreakPoints.NO_RING)))
_TRUTH = Truth(
    shot="a", expect="pose", center_m=np.array([0.1, 0.2, 0.5]), normal=np.array([0.0, 0.6, -0.8]),
    radius_inner_m=0.567, radius_outer_m=0.597, break_points_px=np.array([[[1.0, 2.0], [np.nan, np.nan]]]),
    stamp_s=3.0, velocity_m_s=np.zeros(3), groups={"rig": "B", "distance_m": 0.5, "foil": True},
)  # fmt: skip
TRUTH = record_of(truth_record(_TRUTH))


@pytest.mark.parametrize("name", SCHEMAS)
def test_schema_is_a_schema(name):
    jsonschema.Draft202012Validator.check_schema(SCHEMAS[name])


def refused(record: dict, name: str) -> bool:
    try:
        validated(record, name)
    except jsonschema.ValidationError:
        return True
    return False


def changed(values: dict, path: tuple, value: object) -> dict:
    """A copy of nested values with another value at one place."""
    values = copy.deepcopy(values)
    place = values
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return values


@pytest.mark.parametrize(
    ("name", "record", "key", "value"),
    [
        *(
            ("detection", DETECTION | {"more": 1}, key, value)
            for key, value in (
                ("schema", "ringpose/detection/1"),
                ("reason", None),
                ("break_points", {}),
                ("lasers_on", [1, 0]),
                ("rejected", None),
                ("ring_edges", {"edge": [2]}),
                ("stripes", {"piece": [-1]}),
            )
        ),
        *(
            ("truth", TRUTH, key, value)
            for key, value in (
                ("shot", ""),
                ("expect", "poses"),
                ("center_m", [0.0, 1.0]),
                ("center_m", None),
                ("break_points_px", [[[1.0, 2.0]]]),
                ("groups", {"a": []}),
                ("frames", [{"stamp_s": 1.0}]),
            )
        ),
        ("truth", record_of(truth_record(Truth(shot="b", expect="no_target"))), "shot", ""),
    ],
)
def test_a_broken_record_does_not_fit_its_schema(name, record, key, value):
    validated(record, name)

    assert refused(record | {key: value}, name)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("ringpose",), "session/2"),
        (("captures",), None),
        (("captures", 0, "state"), "done"),
        (("captures", 0, "shots"), ["a", "a"]),
        (("captures", 1, "laser_count"), 9),
    ],
)
def test_a_broken_session_does_not_fit_its_schema(tmp_path, path, value):
    full = Capture(
        camera="sim:scene.yaml", lasers="sim:", sequence="off,1,2,3,off", exposure_s=0.01, rate_hz=10.0,
        camera_name="drawn", laser_count=3, laser_names=("left", "middle", "right"), state="finished",
        shots=("a", "b"), provenance={"version": "0"},
    )  # fmt: skip
    write_session(tmp_path, Session(captures=(Capture(camera="files:x", lasers="none:", shots=("c",)), full)))
    session = yaml.safe_load((tmp_path / "session.yaml").read_text())

    validated(session, "session")

    assert refused(changed(session, path, value), "session")


def words_of(page: str) -> set[str]:
    return set(re.findall(r"\w+", (Path(__file__).parents[2] / "man" / page).read_text()))


def test_the_manual_and_the_schema_name_every_flag_and_every_state_of_a_laser():
    flags = {str(flag.name).lower() for flag in PoseFlag}

    described = set(re.findall(r"\w+", SCHEMAS["pose"]["properties"]["flags"]["description"]))
    assert flags - described == set()
    assert flags | set(LaserState) <= words_of("ringpose-records.5")
    assert set(SCHEMAS["pose"]["properties"]["lasers"]["additionalProperties"]["enum"]) == set(LaserState)
