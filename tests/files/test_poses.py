import json
import math
from dataclasses import replace
from importlib.resources import files

import jsonschema
import numpy as np
import pytest

from ringpose.errors import DataError
from ringpose.files import records
from ringpose.files.poses import pose_line_of, pose_record
from ringpose.types.options import PoseFrame
from ringpose.types.pose import PoseFlag, PoseLine, RingPose

SCHEMA = json.loads(files("ringpose.files").joinpath("pose.schema.json").read_text())


def square(rng, size):
    root = rng.normal(size=(size, size))
    return root @ root.T


@pytest.fixture
def pose(rng) -> RingPose:
    normal = rng.normal(size=3)
    return RingPose(
        center_m=rng.normal(size=3),
        normal=normal / np.linalg.norm(normal),
        radius_inner_m=0.567,
        radius_outer_m=0.597,
        grasp_m=rng.normal(size=3),
        method="paper",
        condition_number=30.0,
        residual_rms_px=0.1,
        covariance=square(rng, 7),
        covariance_center_m2=square(rng, 3),
        covariance_grasp_m2=square(rng, 3),
        flags=PoseFlag.CENTER_WEAK | PoseFlag.POINT_REJECTED,
    )


def line(pose, **changes) -> PoseLine:
    return PoseLine(**({"shot": "a", "stamp_s": 1.7e9, "pose": pose, "latency_s": 0.02, "rig": "0" * 64} | changes))


def record(line: PoseLine) -> dict:
    return records.parsed_record(records.line_of(pose_record(line)), "x")


def test_schema_is_a_schema():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)


def test_line_with_everything_fits_the_schema(pose):
    jsonschema.validate(record(line(pose)), SCHEMA)


@pytest.mark.parametrize(
    "changes",
    [
        {"covariance": None, "covariance_center_m2": None, "covariance_grasp_m2": None},
        {"covariance": np.full((7, 7), math.nan)},
        {"radius_inner_m": math.nan, "residual_rms_px": math.nan, "condition_number": math.inf},
        {"center_m": np.full(3, math.nan)},
        {"grasp_m": np.full(3, math.nan), "covariance_grasp_m2": np.full((3, 3), math.nan)},
        {"flags": PoseFlag(0)},
        {"normal": np.full(3, math.nan)},
        {"ring_posterior": {"R597": 0.9, "none of these": 0.1}},
    ],
)
def test_line_of_a_pose_that_is_known_in_part_fits_the_schema(pose, changes):
    jsonschema.validate(record(line(replace(pose, **changes))), SCHEMA)


def test_line_without_a_pose_fits_the_schema():
    jsonschema.validate(record(line(None, reason="no laser stripe found", latency_s=math.nan, rig="")), SCHEMA)


@pytest.mark.parametrize(
    "changes",
    [
        {"status": "none"},
        {"flags": []},
        {"reason": ""},
        {"pose": None},
        {"more": 1},
        {"stamp_s": "now"},
        {"rig": "abc"},
    ],
)
def test_schema_refuses_what_contradicts_itself(pose, changes):
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(record(line(pose)) | changes, SCHEMA)


@pytest.mark.parametrize("key", sorted(SCHEMA["required"]))
def test_schema_refuses_a_line_without_a_key(pose, key):
    values = record(line(pose))
    del values[key]

    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(values, SCHEMA)


def test_line_is_read_as_it_was_written(pose):
    before = line(pose, frame=PoseFrame.TOOL, dropped=2, laser_health={"left": 0.9})

    after = pose_line_of(record(before), "x")

    assert (after.shot, after.stamp_s, after.frame, after.dropped) == ("a", 1.7e9, "tool", 2)
    assert (after.latency_s, after.rig, after.laser_health) == (0.02, "0" * 64, {"left": 0.9})
    assert (after.status, after.flags) == ("degraded", ("center_weak", "damped"))
    assert all(np.array_equal(getattr(after.pose, name), getattr(pose, name)) for name in RingPose.__slots__)


def test_record_of_another_kind_is_told_by_its_schema():
    with pytest.raises(DataError, match=r"schema: is 'ringpose/detection/1', .*; give the output of ringpose pose"):
        pose_line_of({"schema": "ringpose/detection/1", "break_points": None}, "x:1")


def test_what_is_not_known_is_read_as_nan(pose):
    unknown = replace(
        pose, center_m=np.full(3, math.nan), radius_outer_m=math.nan, condition_number=math.inf, flags=PoseFlag(0)
    )

    after = pose_line_of(record(line(unknown)), "x")

    assert np.isnan([*after.pose.center_m, after.pose.radius_outer_m]).all()
    assert after.pose.condition_number == math.inf


def test_covariance_of_a_radius_that_is_not_known_leaves_the_rest_known(pose):
    covariance = pose.covariance.copy()
    covariance[5], covariance[:, 5] = math.nan, math.nan

    after = pose_line_of(record(line(replace(pose, covariance=covariance))), "x")

    np.testing.assert_array_equal(after.pose.covariance, covariance)


def test_reason_is_read_as_it_was_written():
    after = pose_line_of(record(line(None, reason="no laser stripe found")), "x")

    assert (after.pose, after.reason, after.status, after.flags) == (None, "no laser stripe found", "none", ())


def test_angles_are_those_of_the_normal(pose):
    away = -pose.normal

    values = record(line(pose))["pose"]

    assert math.sin(values["pitch_rad"]) == pytest.approx(away[1])
    assert math.tan(values["yaw_rad"]) == pytest.approx(away[0] / away[2])


@pytest.mark.parametrize(
    ("key", "value", "finding"),
    [
        ("schema", "ringpose/pose/2", "schema: is 'ringpose/pose/2', must be 'ringpose/pose/1'"),
        ("flags", ["center_week"], "flags: unknown flag 'center_week'"),
        ("frame", "world", "frame: is 'world', must be one of camera, tool"),
        ("dropped", -1, "dropped: is -1, must be at least 0"),
        ("poses", {}, "unknown key 'poses'; did you mean 'pose'?"),
    ],
)
def test_impossible_line_is_refused_with_its_place(pose, key, value, finding):
    with pytest.raises(DataError) as caught:
        pose_line_of(record(line(pose)) | {key: value}, "x:1")

    assert str(caught.value).startswith(f"x:1: {finding}")


@pytest.mark.parametrize("normal", [[0.0, 0.0, 0.0], [0.0, 0.0, 5.0]])
def test_a_normal_that_has_not_length_1_is_refused(pose, normal):
    values = record(line(pose))

    with pytest.raises(DataError, match=r"x:1: pose\.normal: .*must be 1"):
        pose_line_of(values | {"pose": values["pose"] | {"normal": normal}}, "x:1")


@pytest.mark.parametrize(
    ("center", "finding"),
    [
        ([[1, 5, 0], [0, 1, 0], [0, 0, 1]], "symmetric"),
        ([[1, 5, 0], [5, 1, 0], [0, 0, 1]], "semidefinite"),
        ([[-1, 0, 0], [0, 1, 0], [0, 0, 1]], "negative variance"),
    ],
)
def test_a_covariance_that_no_errors_have_is_refused(pose, center, finding):
    values = record(line(pose))
    values["pose"]["covariance"]["center"] = center

    with pytest.raises(DataError, match=rf"x:1: pose\.covariance\.center: .*{finding}"):
        pose_line_of(values, "x:1")
