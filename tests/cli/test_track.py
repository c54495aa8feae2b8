"""`ringpose track`: records in, records or messages out; bad input, rates, slow readers."""

import hashlib
import io
import json
import math
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
import yaml
from moving_rings import START_S, Motion, Shots, drawn_motion, stream
from ros_messages import fits
from schemas import validated
from small_rig import SMALL_RIG

from ringpose.cli.batch import MAX_UNNAMED
from ringpose.cli.main import main
from ringpose.files.records import line_of
from ringpose.files.records.poses import pose_record


@pytest.fixture(scope="module")
def motion() -> Motion:
    return drawn_motion(np.random.default_rng(7))


@pytest.fixture(scope="module")
def lines(motion) -> list[str]:
    """Pose records of one second."""
    records = stream(motion, 1.0, Shots(), np.random.default_rng(8))
    return [line_of(pose_record(replace(record, reason="not estimated", rig="a" * 64))) for record in records]


@pytest.fixture
def poses(tmp_path: Path, lines) -> Path:
    file = tmp_path / "poses.jsonl"
    file.write_text("".join(lines))
    return file


def tracked(capsys, *arguments) -> tuple[int, list[dict], list[str]]:
    status = main(["track", *map(str, arguments)])
    streams = capsys.readouterr()
    return status, [json.loads(line) for line in streams.out.splitlines()], streams.err.splitlines()


def test_each_pose_record_gives_one_track_record_that_fits_the_schema(capsys, poses):
    status, records, messages = tracked(capsys, poses)

    assert (status, messages) == (0, [])
    assert len(records) == 6
    for record in records:
        assert validated(record)["fusion_status"] == "fused"
        assert record["camera"] == "inertial_assumed"
        assert set(record["log_evidence"]) == {"constant_velocity", "precession"}
        assert record["log_evidence"]["precession"] is not None


def test_the_track_is_where_the_ring_is(capsys, poses, motion):
    _, records, _ = tracked(capsys, poses)

    last = records[-1]
    time_s = last["stamp_s"] - START_S
    ring = motion.at(time_s)
    center_sd_m = math.sqrt(np.trace(last["pose"]["covariance"]["center"]))
    assert np.linalg.norm(np.array(last["pose"]["center_m"]) - ring.center_m) < 3 * center_sd_m < 0.03
    assert np.array(last["pose"]["normal"]) @ ring.normal > math.cos(math.radians(1.0))
    ahead_s = last["next"]["stamp_s"] - START_S
    away = np.array(last["next"]["grasp_m"]) - motion.at(ahead_s).center_m
    assert abs(np.linalg.norm(away) - ring.radius_m.mean()) < 0.002


def test_a_gripper_gives_a_probability_of_capture(capsys, poses):
    _, records, _ = tracked(capsys, poses, "--gripper-radial-m", 0.003, "--gripper-tilt-deg", 2)
    _, narrow, _ = tracked(capsys, poses, "--gripper-radial-m", 1e-6, "--gripper-tilt-deg", 2)

    assert records[-1]["capture_probability"] > 0.99
    assert narrow[-1]["capture_probability"] < 0.01


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--gripper-radial-m", 0.01], "--gripper-tilt-deg"),
        (["--gripper-tilt-deg", 1], "--gripper-radial-m"),
        (["--lost-after", 1], "--lost-after"),
        (["--max-speed", 0], "--max-speed"),
        (["--frame-id", "base_link"], "--format ros"),
        (["--format", "ros", "--frame-id", ""], "--frame-id"),
        (["--rate", "nan"], "finite"),
    ],
    ids=str,
)
def test_options_that_contradict_each_other_are_wrong_usage(capsys, poses, options, word):
    status, records, messages = tracked(capsys, poses, *options)

    assert (status, records, len(messages)) == (2, [], 1)
    assert word in messages[0]


def without(line: str, *keys: str) -> str:
    record = json.loads(line)
    for key in keys:
        del record[key]
    return line_of(record)


def broken_measurement(line: str, value) -> str:
    record = json.loads(line)
    record["measurement"]["square_root"][0][0] = value
    return json.dumps(record) + "\n"


BAD = {
    "not JSON": (lambda line: line[:100] + "\n", "JSON"),
    "NaN": (lambda line: broken_measurement(line, math.nan), "NaN"),
    "huge": (lambda line: broken_measurement(line, 1e200), "1e+30"),
    "another rig": (lambda line: line.replace("a" * 64, "b" * 64), "rig"),
    "repeated": (lambda _: None, "repeats"),
    "no schema": (lambda line: without(line, "schema"), "schema"),
    "needs a rig file": (lambda line: line.replace('"covariance":"none"', '"covariance":"rig.yaml"'), "--rig"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_record_is_reported_in_one_line_and_the_stream_goes_on(capsys, tmp_path, lines, case):
    change, word = BAD[case]
    bad = lines[1] if case == "repeated" else change(lines[2])
    file = tmp_path / "poses.jsonl"
    file.write_text("".join([*lines[:2], bad, *lines[3:]]))

    status, records, messages = tracked(capsys, file)

    assert (status, len(messages)) == (65, 1)
    assert f"{file}:3" in messages[0]
    assert word in messages[0]
    assert case != "repeated" or json.loads(bad)["shot"] in messages[0]
    assert [record["fusion_status"] for record in records] == ["fused"] * 5


def test_records_without_a_measurement_are_reported_in_their_line(capsys, tmp_path, lines):
    file = tmp_path / "poses.jsonl"
    file.write_text("".join([lines[0], without(lines[1], "measurement"), lines[2]]))

    status, records, _ = tracked(capsys, file)

    assert status == 0
    assert [record["fusion_status"] for record in records] == ["fused", "none", "fused"]
    assert validated(records[1])["pose"] is not None
    assert records[1]["reason"] == "not estimated"
    assert records[0]["reason"] is None


def test_a_record_without_a_time_stamp_gives_a_line_at_the_time_of_the_track(capsys, tmp_path, lines):
    file = tmp_path / "poses.jsonl"
    timeless = json.dumps(json.loads(lines[1]) | {"stamp_s": None, "pose_stamp_s": None}) + "\n"
    file.write_text("".join([lines[0], timeless, lines[2]]))

    status, records, _ = tracked(capsys, file)

    assert status == 0
    assert [record["fusion_status"] for record in records] == ["fused", "none", "fused"]
    assert validated(records[1])["stamp_s"] == records[0]["stamp_s"]


def test_poses_without_measurements_are_reported_once(capsys, tmp_path, rig, detections):
    main(["pose", str(detections), "--rig", str(rig), "--brief"])
    file = tmp_path / "poses.jsonl"
    file.write_text(capsys.readouterr().out)

    status, records, messages = tracked(capsys, file)

    assert (status, len(records), len(messages)) == (3, 3, 1)
    assert f"{file}:1" in messages[0]
    assert "--brief" in messages[0]
    assert {(record["fusion_status"], validated(record)["validity"]) for record in records} == {("none", "lost")}


def test_old_records_at_a_rate_are_reported_once(capsys, poses):
    status, records, messages = tracked(capsys, poses, "--rate", 1000)

    assert (status, len(messages)) == (3, 1)
    assert "--rate" in messages[0]
    assert {record["validity"] for record in records} == {"lost"}


def test_lines_of_random_data_are_reported_up_to_a_limit_and_counted(capsys, monkeypatch, tmp_path, lines):
    stream = io.StringIO("".join([*(f"no such file {number}\n" for number in range(100)), lines[0]]))
    monkeypatch.setattr(sys, "stdin", stream)

    status, records, messages = tracked(capsys, "-")

    assert (status, len(records)) == (66, 1)
    assert len(messages) == MAX_UNNAMED + 1
    assert str(100 - MAX_UNNAMED) in messages[-1]


def test_a_file_that_does_not_exist_and_a_file_of_something_else(capsys, tmp_path):
    (tmp_path / "shot.npz").write_bytes(b"PK")

    assert tracked(capsys, tmp_path / "none.jsonl")[0] == 66
    assert tracked(capsys, tmp_path / "shot.npz")[0] == 65


def test_messages_of_ros_have_the_fields_of_their_definitions_and_the_pose_of_the_record(capsys, poses):
    _, (*_, record), _ = tracked(capsys, poses)
    _, (_, *messages), _ = tracked(capsys, poses, "--format", "ros", "--frame-id", "camera_optical_frame")

    for message in messages:
        assert message["pose"]["header"]["frame_id"] == message["twist"]["header"]["frame_id"] == "camera_optical_frame"
        assert fits(message["pose"], "geometry_msgs/PoseWithCovarianceStamped")
        assert fits(message["twist"], "geometry_msgs/TwistWithCovarianceStamped")
    assert (message["flags"], message["reason"]) == (record["flags"], None)
    x, y, z, w = message["pose"]["pose"]["pose"]["orientation"].values()
    axis_z = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
    axis_x = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
    outward = np.array(record["grasp"]["point_m"]) - record["pose"]["center_m"]
    covariance = np.array(message["pose"]["pose"]["covariance"]).reshape(6, 6)
    np.testing.assert_allclose(axis_z, record["pose"]["normal"], atol=1e-12)
    np.testing.assert_allclose(axis_x, outward / np.linalg.norm(outward), atol=1e-9)
    np.testing.assert_allclose(covariance[:3, :3], record["pose"]["covariance"]["center"], rtol=1e-6, atol=1e-12)
    normal = np.array(record["pose"]["normal"])
    assert normal @ covariance[3:, 3:] @ normal == pytest.approx(math.pi**2 / 3)  # nothing is known of the turn
    np.testing.assert_allclose(covariance, covariance.T, atol=1e-15)
    assert np.linalg.eigvalsh(covariance).min() > 0


@pytest.mark.parametrize(("late_s", "is_live"), [(0.05, True), (2.9, True), (3.1, False), (1e7, False), (-0.05, False)])
def test_a_line_states_its_latency_if_its_stamp_is_of_this_computers_clock(capsys, monkeypatch, poses, late_s, is_live):
    lines = poses.read_text().splitlines()[-3:]
    poses.write_text("\n".join(lines))
    last_s = json.loads(lines[-1])["pose_stamp_s"]
    monkeypatch.setattr("ringpose.cli.track.time", lambda: last_s + late_s)

    _, (*_, record), _ = tracked(capsys, poses)
    _, (*_, message), _ = tracked(capsys, poses, "--format", "ros")

    assert record["latency_s"] == (pytest.approx(late_s, abs=1e-6) if is_live else None)
    assert message.get("latency_s") == record["latency_s"]


def test_brief_records_leave_out_attempts_and_evidence(capsys, poses):
    _, records, _ = tracked(capsys, poses, "--brief")

    assert "attempts" not in records[0]
    assert "log_evidence" not in records[0]


def fed(lines: list[str], *arguments: str) -> subprocess.Popen:
    """The command as a process that gets these lines."""
    program, pipe = [str(Path(sys.executable).parent / "ringpose"), "track", "-", *arguments], subprocess.PIPE
    process = subprocess.Popen(program, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
    process.stdin.write("".join(lines))
    process.stdin.flush()
    return process


def restamped(lines: list[str], start_s: float) -> list[str]:
    """The same records as of a stream that begins at another time."""
    changed = []
    for line in lines:
        record = json.loads(line)
        for key in ("stamp_s", "pose_stamp_s"):
            record[key] += start_s - START_S
        changed.append(line_of(record))
    return changed


class SilentInput:
    """Standard input with these lines and nothing after them; a clock that advances by `step_s` a reading meanwhile."""

    def __init__(self, lines: list[str], now_s: float, step_s: float, ends_s: float) -> None:
        self._lines, self._now_s, self._step_s, self._ends_s = lines, now_s, step_s, ends_s
        self._is_read, self._has_ended = threading.Event(), threading.Event()

    def __iter__(self) -> Iterator[str]:
        yield from self._lines
        self._is_read.set()
        self._has_ended.wait()

    def fileno(self) -> int:
        raise io.UnsupportedOperation

    def time(self) -> float:
        if self._is_read.is_set():
            self._now_s += self._step_s
        if self._now_s >= self._ends_s:
            self._has_ended.set()
        return self._now_s


def test_at_a_fixed_rate_lines_go_on_while_no_records_arrive(capsys, monkeypatch, lines):
    silent = SilentInput(lines, START_S + 1.1, 0.05, START_S + 4.5)
    monkeypatch.setattr(sys, "stdin", silent)
    monkeypatch.setattr("ringpose.cli.track.time", silent.time)

    status, records, messages = tracked(capsys, "-", "--rate", 200, "--predict-for", 1.5, "--lost-after", 2.5)

    assert (status, messages) == (3, [])  # the last lines have no pose
    stamps_s = np.array([record["stamp_s"] for record in records])
    validity = [record["validity"] for record in records]
    assert stamps_s[-1] - stamps_s[0] >= 3.3
    assert [key for key, _ in groupby(validity)][-3:] == ["predicted", "stale", "lost"]
    attempts = [each["fusion_status"] for record in records for each in record["attempts"]]
    assert attempts == ["fused"] * len(lines)
    ahead_s = [record["next"]["stamp_s"] - record["stamp_s"] for record in records if record["next"] is not None]
    np.testing.assert_allclose(ahead_s, 1 / 200, atol=1e-6)


def test_a_clock_of_this_computer_that_is_set_back_starts_a_track_at_a_rate_anew(capsys, monkeypatch, poses):
    readings_s = iter([START_S + 3.0])
    monkeypatch.setattr("ringpose.cli.track.time", lambda: next(readings_s, START_S + 1.0))

    status, records, messages = tracked(capsys, poses, "--rate", 20)

    assert (status, len(messages)) == (0, 1)
    assert "set back by 2 s" in messages[0]
    assert (records[-1]["resets"], records[-1]["validity"], records[-1]["stamp_s"]) == (1, "valid", START_S + 1.0)


@pytest.mark.slow
def test_a_slow_reader_gets_the_newest_line(lines):
    with fed(lines, "--rate", "50", "--newest") as process:
        skipped = []
        while len(skipped) < 100 and max(skipped, default=0) < 10:  # a busy machine makes fewer lines in a pause
            time.sleep(0.3)
            skipped.append(validated(json.loads(process.stdout.readline()))["lines_skipped"])
        process.stdin.close()
        process.stdout.read()
        process.wait(timeout=300)

    assert max(skipped) >= 10


@pytest.mark.slow
@pytest.mark.parametrize("options", [[], ["--newest"]], ids=["every line", "newest"])
def test_a_reader_that_has_gone_ends_the_command(lines, options):
    with fed(lines, "--rate", "50", *options) as process:
        process.stdout.readline()
        process.stdout.close()

        assert process.wait(timeout=300) == 141


@pytest.mark.slow
def test_a_signal_ends_the_command_while_a_line_waits_for_its_reader(lines):
    with fed(lines, "--rate", "50", "--newest") as process:
        process.stdout.readline()
        time.sleep(0.3)
        process.send_signal(signal.SIGTERM)

        assert process.wait(timeout=300) == 143


def robot_pose(stamp_s: float, position_m=(1.0, 0.2, 0.3), orientation_xyzw=(0.0, 0.0, 0.0, 1.0)) -> str:
    pose = {"position_m": position_m, "orientation_xyzw": orientation_xyzw}
    return json.dumps({"stamp_s": stamp_s, "base_from_tool": pose}) + "\n"


TOOL_FROM_CAMERA = [[0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, -0.3], [0, 0, 0, 1]]


@pytest.fixture
def mounted(tmp_path: Path, lines) -> tuple[Path, Path]:
    """A rig file with a mount whose errors are known, and records of this rig."""
    errors = {"covariance": (1e-6 * np.eye(6)).tolist(), "delay_sd_s": 0.002}
    values = {**yaml.safe_load(SMALL_RIG), "mount": {"tool_from_camera": TOOL_FROM_CAMERA, **errors}}
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(values))
    digest = hashlib.sha256(rig.read_bytes()).hexdigest()
    poses = tmp_path / "poses.jsonl"
    poses.write_text("".join(lines).replace("a" * 64, digest))
    return rig, poses


def test_with_robot_poses_the_track_is_in_the_base_frame(capsys, tmp_path, mounted):
    rig, poses = mounted
    robot = tmp_path / "robot.jsonl"
    robot.write_text("".join(robot_pose(START_S + 0.2 * number) for number in range(-1, 8)))

    _, in_camera, _ = tracked(capsys, poses, "--rig", rig)
    status, in_base, messages = tracked(capsys, poses, "--rig", rig, "--robot-poses", robot)

    assert (status, messages) == (0, [])
    assert {validated(record)["camera"] for record in in_base} == {"robot_poses"}
    assert {record["frame"] for record in in_base} == {"base"}
    tool_from_camera = np.array(TOOL_FROM_CAMERA)
    expected = tool_from_camera[:3, :3] @ in_camera[-1]["pose"]["center_m"] + tool_from_camera[:3, 3] + [1.0, 0.2, 0.3]
    np.testing.assert_allclose(in_base[-1]["pose"]["center_m"], expected, atol=2e-3)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (robot_pose(1.0) + robot_pose(2.0, orientation_xyzw=(90.0, 0.0, 45.0, 0.0)), "degrees"),
        (robot_pose(1.0) + robot_pose(2.0, position_m=(900.0, 200.0, 300.0)), "millimetres"),
        (robot_pose(1.0) + robot_pose(1.0, position_m=(0.0, 0.0, 0.1)), "stamp"),
        (robot_pose(1.0), "fewer"),
        ("{}\n", "base_from_tool"),
    ],
    ids=["degrees", "millimetres", "equal stamps", "one pose", "no pose"],
)
def test_bad_robot_poses_are_reported_in_one_line(capsys, tmp_path, mounted, text, word):
    rig, poses = mounted
    robot = tmp_path / "robot.jsonl"
    robot.write_text(text)

    status, records, messages = tracked(capsys, poses, "--rig", rig, "--robot-poses", robot)

    assert (status, records, len(messages)) == (65, [], 1)
    assert str(robot) in messages[0]
    assert word in messages[0]


def test_a_measurement_between_robot_poses_that_are_far_apart_is_rejected_with_a_reason(capsys, tmp_path, mounted):
    rig, poses = mounted
    robot = tmp_path / "robot.jsonl"
    robot.write_text(robot_pose(START_S - 1.0) + robot_pose(START_S + 2.0))

    _, records, _ = tracked(capsys, poses, "--rig", rig, "--robot-poses", robot)

    assert {record["fusion_status"] for record in records} == {"rejected_covariance"}
    assert "3 s apart" in records[0]["reason"]


def test_robot_poses_are_read_from_standard_input(capsys, monkeypatch, mounted):
    rig, poses = mounted
    text = "".join(robot_pose(START_S + 0.2 * number) for number in range(-1, 8))
    monkeypatch.setattr(sys, "stdin", io.StringIO(text))

    status, records, _ = tracked(capsys, poses, "--rig", rig, "--robot-poses", "-")

    assert (status, {record["frame"] for record in records}) == (0, {"base"})
    assert tracked(capsys, "-", "--rig", rig, "--robot-poses", "-")[0] == 2


def test_robot_poses_need_the_rig_file(capsys, tmp_path, poses):
    assert tracked(capsys, poses, "--robot-poses", tmp_path / "robot.jsonl")[0] == 2
