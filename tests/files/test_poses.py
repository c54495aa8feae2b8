import math
from dataclasses import replace
from importlib.metadata import version

import jsonschema
import numpy as np
import pytest
from schemas import SCHEMAS, validated
from whole_records import VERSION_1, complete_line, complete_pose, line, record_of

from ringpose.errors import DataError
from ringpose.files.records.poses import pose_line_of, pose_record, recorded_status
from ringpose.types.options import PoseFrame
from ringpose.types.pose import MEASURED_PARAMETERS, PoseFlag, PoseLine, RingPose

SCHEMA = SCHEMAS["pose"]


@pytest.fixture
def pose(rng) -> RingPose:
    return complete_pose(rng)


@pytest.fixture
def complete(rng) -> PoseLine:
    return complete_line(rng)


def record(line: PoseLine, brief: bool = False) -> dict:
    return record_of(pose_record(line, brief))


KEYS = [
    "schema", "software", "shot", "stamp_s", "pose_stamp_s", "frame", "status", "reason", "flags", "pose", "velocity",
    "protection", "measurement", "plane_evidence", "priors", "lasers", "rejected", "rig_health", "shots_dropped",
    "latency_s", "stage_s", "lines_skipped", "rig",
]  # fmt: skip
"""Of a pose line, in their order."""


def test_record_has_the_keys_in_their_order(complete):
    assert list(record(complete)) == KEYS


def test_a_line_states_the_version_that_wrote_it(pose):
    assert record(line(pose, software=""))["software"] == f"ringpose {version('ringpose')}"
    assert record(line(pose, software="ringpose 0.1.0"))["software"] == "ringpose 0.1.0"


@pytest.mark.parametrize("frame", PoseFrame)
def test_line_in_every_frame_fits_the_schema(pose, frame):
    validated(record(line(pose, frame=frame)))


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
    validated(record(line(replace(pose, **changes))))


def test_line_without_a_pose_fits_the_schema():
    validated(record(line(None, reason="no laser stripe found", latency_s=math.nan, rig="")))


@pytest.mark.parametrize("flags", [PoseFlag.RIG_UNCHECKED | PoseFlag.RADIUS_UNVERIFIED, PoseFlag(0)])
def test_harmless_flags_leave_the_status_ok(pose, flags):
    values = validated(record(line(replace(pose, flags=flags))))

    assert values["status"] == pose_line_of(values, "x").status == "ok"


def test_line_without_a_pose_may_have_flags(pose):
    values = validated(record(line(None, reason="too dark", flags=PoseFlag.LASER_MISSING)))

    assert (values["status"], values["flags"]) == ("none", ["laser_missing"])
    assert pose_line_of(values, "x").flags == PoseFlag.LASER_MISSING


@pytest.mark.parametrize(
    "changes",
    [
        {"status": "none"},
        {"flags": []},
        {"status": "ok"},
        {"flags": ["rig_unchecked"]},
        {"reason": ""},
        {"pose": None},
        {"stamp_s": "now"},
        {"rig": "abc"},
        {"lasers": {"left": "lost"}},
        {"rejected": [{"what": "point"}]},
        {"priors": {"motion": "moving"}},
        {"measurement": {}},
    ],
)
def test_schema_refuses_what_contradicts_itself(pose, changes):
    with pytest.raises(jsonschema.ValidationError):
        validated(record(line(pose)) | changes)


def test_schema_accepts_keys_and_flags_of_later_versions(complete):
    values = record(complete)

    validated(values | {"more": 1, "flags": [*values["flags"], "new_flag"], "pose": values["pose"] | {"more": {}}})


@pytest.mark.parametrize("key", sorted(SCHEMA["required"]))
def test_schema_refuses_a_line_without_a_key(pose, key):
    values = record(line(pose))
    del values[key]

    with pytest.raises(jsonschema.ValidationError):
        validated(values, "pose")


def test_version_1_is_read_under_its_own_names():
    after = pose_line_of(VERSION_1, "x")

    assert (after.shots_dropped, after.rig_health["left"], after.pose.condition_number) == (3, 0.9, 20.0)
    assert (after.status, after.flag_names) == ("degraded", ("center_weak",))
    assert (after.priors, after.measurement, after.velocity, after.rejected) == (None, None, None, ())
    assert math.isnan(after.pose_stamp_s)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("point_left_out", ["point_rejected"]),
        ("stripe_left_out", ["stripe_rejected"]),
        ("relabelled", ["assignment_ambiguous"]),
        ("radius_disagrees", ["radius_inconsistent"]),
        ("side_unknown", ["side_unknown"]),
        ("damped", ["center_weak", "radius_weak"]),
    ],
)
def test_flags_of_version_1_have_their_present_names(before, after):
    assert pose_line_of(VERSION_1 | {"flags": [before]}, "x").flag_names == tuple(after)


@pytest.mark.parametrize("flags", [["new_flag"], ["rig_unchecked", "new_flag"]])
def test_a_line_whose_only_serious_flag_is_unknown_stays_degraded(pose, flags):
    values = record(line(pose)) | {"flags": flags}

    after = pose_line_of(values, "x")

    assert recorded_status(values, after) == "degraded"
    assert set(after.flag_names) == set(flags) & {"rig_unchecked"}


def test_laser_states_and_rejections_of_a_later_version_are_ignored(complete):
    values = record(complete)
    more = values | {"lasers": {"left": "lost", "middle": "used"}, "rejected": [{"what": "facet"}]}

    after = pose_line_of(more, "x")

    assert (dict(after.lasers), after.rejected) == ({"middle": "used"}, ())


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

    assert (after.pose, after.reason, after.status, after.flags) == (None, "no laser stripe found", "none", PoseFlag(0))


def test_angles_are_those_of_the_normal(pose):
    away = -pose.normal

    values = record(line(pose))["pose"]

    assert math.sin(values["pitch_rad"]) == pytest.approx(away[1])
    assert math.tan(values["yaw_rad"]) == pytest.approx(away[0] / away[2])


@pytest.mark.parametrize(
    ("key", "value", "finding"),
    [
        ("schema", "ringpose/pose/3", "schema: is 'ringpose/pose/3', must be 'ringpose/pose/2' or 'ringpose/pose/1'"),
        ("flags", "center_weak", "flags: must be a list of texts"),
        ("flags", [], "status: is 'degraded', but there is no flag"),
        ("status", "ok", "status: is 'ok', but there is the flag 'center_weak'"),
        ("status", "none", "status: is 'none', but there is a pose"),
        ("pose", None, "status: is 'degraded', but pose is null"),
        ("status", "good", "status: is 'good', must be one of ok, degraded, none"),
        ("frame", "world", "frame: is 'world', must be one of camera, tool"),
        ("shots_dropped", -1, "shots_dropped: is -1, must be at least 0"),
        ("rig_health", {"left": "good"}, "rig_health.left: is the text 'good', must be a number"),
        ("stage_s", {"pose": -0.1}, "stage_s.pose: is -0.1, must be at least 0"),
        ("lasers", {"left": 1}, "lasers.left: is 1, must be a text"),
        ("velocity", {"center_m_s": [0, 0]}, "velocity.center_m_s: has 2 numbers, must have 3"),
        ("pose_stamp_s", "now", "pose_stamp_s: is the text 'now', must be a number"),
        ("priors", {"motion": "slow", "rig": {}}, "priors.motion: is 'slow', must be one of still"),
        ("priors", {"motion": {"speed_sd_m_s": -1}, "rig": {}}, "priors.motion.speed_sd_m_s: is -1"),
    ],
)
def test_impossible_line_is_refused_with_its_place(pose, key, value, finding):
    with pytest.raises(DataError) as caught:
        pose_line_of(record(line(pose)) | {key: value}, "x:1")

    assert str(caught.value).startswith(f"x:1: {finding}")


@pytest.mark.parametrize(
    ("key", "value", "finding"),
    [
        ("parameters", ["tilt_1"], "parameters: must be tilt_1, tilt_2"),
        ("parameters", list(reversed(MEASURED_PARAMETERS)), "parameters: must be"),
        ("nuisance_parameters", ["fx"], "square_root: has 9 x 15 numbers, must have n x 14"),
        ("square_root", [[0.0] * 15, [1.0] * 15], "square_root: has a number below its diagonal"),
        ("chi2", -1.0, "chi2: is -1"),
        ("degrees_of_freedom", 1.5, "degrees_of_freedom: is 1.5, must be a whole number"),
        ("camera_motion", "fast", "camera_motion: is 'fast'"),
    ],
)
def test_impossible_measurement_is_refused_with_its_place(complete, key, value, finding):
    values = record(complete)
    values["measurement"][key] = value

    with pytest.raises(DataError) as caught:
        pose_line_of(values, "x:1")

    assert str(caught.value).startswith(f"x:1: measurement.{finding}")


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
