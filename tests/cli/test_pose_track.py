"""`ringpose pose --track`: shots in, track records out; the track chooses the lasers of a live camera."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from ros_messages import fits

EXAMPLES = Path(__file__).parents[2] / "examples"

RATE_HZ = 30.0

START_S = 1_700_000_000.0

SCENE = f"""\
ringpose: scene/1
rig: rig.yaml
sequence: all                    # one view a frame: the target moves between frames
start_s: {START_S}
stripe_dn: 170
sensor: {{pixel_m: 9.0e-6}}
ring: {{radius_inner_m: 0.567, radius_outer_m: 0.597, height_m: 0.06}}
body: {{size_m: [1.6, 1.6, 1.0]}}
lights: {{dim: {{ambient_w_m2: 0.3}}}}
trajectory:
- {{name: moving, center_m: [-0.582, -0.02, 0.5], pitch_rad: 0.0, yaw_rad: 0.0, light: dim}}
period_s: {1 / RATE_HZ}
motion:
  angular_velocity_rad_s: [0.01, 0.008, 0.0]
  velocity_m_s: [0.01, 0.0, 0.02]
  center_of_mass_m: [0, 0, -0.5]
  inertia_kg_m2: [1, 1, 1]
  shots: 60
"""


@pytest.fixture
def served(serving):
    """The URI of a moving target in simulated time, which waits for the client."""
    Path("rig.yaml").write_text((EXAMPLES / "scene-rig.yaml").read_text())
    Path("scene.yaml").write_text(SCENE)
    words = ["--images", "tcp://127.0.0.1:0", "scene.yaml", "--clock", "lockstep", "--rate", str(RATE_HZ)]
    return serving(*words, "--truth", "truth.jsonl")[1]["camera"]


@pytest.mark.slow
def test_a_live_track_switches_to_all_lasers_in_every_frame_and_follows_the_target(served, run):
    found = run("pose", "--track", "--rig", "rig.yaml", "--camera", served, "--count", 16)

    assert found.status == 0
    records = found.records
    truths = [json.loads(line) for line in Path("truth.jsonl").read_text().splitlines()]
    assert {record["fusion_status"] for record in records} == {"fused"}
    frames = np.diff([record["stamp_s"] for record in records]) * RATE_HZ
    np.testing.assert_allclose(frames, np.round(frames), atol=0.3)
    assert frames[-14:].round().tolist().count(1.0) >= 11  # a pose a frame, with a frame without lasers in ten
    squares = []
    for record in records[3:]:
        number = (record["stamp_s"] - START_S) * RATE_HZ
        truth = [np.interp(number, range(len(truths)), [each["center_m"][k] for each in truths]) for k in range(3)]
        error_m = np.array(record["pose"]["center_m"]) - truth
        squares.append(error_m @ np.linalg.solve(record["pose"]["covariance"]["center"], error_m))
        assert record["validity"] == "valid"
    assert max(squares) < 25.0
    assert np.linalg.norm(error_m) < 0.004


@pytest.mark.slow
def test_recorded_shots_give_one_track_record_each_which_is_that_of_the_command_track(served, run):
    run("capture", "--camera", served, "--sequence", "all", "--count", 6, "--output", "session", "--quiet")
    Path("poses.jsonl").write_text("\n".join(run("pose", "session", "--rig", "rig.yaml").out))
    separate = run("track", "poses.jsonl", "--rig", "rig.yaml").records

    together = run("pose", "session", "--rig", "rig.yaml", "--track").records

    assert len(together) == 6
    assert [record["shot"] for record in together] == [record["shot"] for record in separate]
    apart_m = np.subtract(together[-1]["grasp"]["point_m"], separate[-1]["grasp"]["point_m"])
    assert np.abs(apart_m).max() < 2e-4  # bands hold the same stripes; weak light behind them is not searched


@pytest.fixture
def mounted(tmp_path, rig, detections) -> tuple[Path, Path]:
    """The rig file with a mount of known errors, and a detection whose frames have stamps."""
    mount = {"tool_from_camera": np.eye(4).tolist(), "covariance": (1e-8 * np.eye(6)).tolist(), "delay_sd_s": 0.001}
    rig.write_text(yaml.safe_dump({**yaml.safe_load(rig.read_text()), "mount": mount}))
    record = json.loads(detections.read_text().splitlines()[0])
    record["break_points"]["stamp_s"] = [1.7e9, 1.7e9 + 0.1, 1.7e9 + 0.2]
    shots = tmp_path / "detections.jsonl"
    shots.write_text(json.dumps(record) + "\n")
    return rig, shots


def robot_poses(file: Path, begin_s: float, end_s: float) -> Path:
    """Poses of a robot at rest."""
    pose = {"position_m": [1.0, 0.2, 0.3], "orientation_xyzw": [0.0, 0.0, 0.0, 1.0]}
    stamps_s = 1.7e9 + np.arange(begin_s, end_s, 0.1)
    file.write_text("".join(json.dumps({"stamp_s": each, "base_from_tool": pose}) + "\n" for each in stamps_s.tolist()))
    return file


def test_a_camera_whose_robot_rests_measures_the_same_and_its_track_is_in_the_base(mounted, tmp_path, run):
    rig, shots = mounted
    robot = robot_poses(tmp_path / "robot.jsonl", -1.0, 1.0)
    (alone,) = run("pose", shots, "--rig", rig).records

    (record,) = run("pose", shots, "--rig", rig, "--robot-poses", robot).records
    (in_base,) = run("pose", shots, "--rig", rig, "--robot-poses", robot, "--frame", "base").records
    (track,) = run("pose", shots, "--rig", rig, "--robot-poses", robot, "--track").records

    assert record["measurement"]["camera_motion"] == "robot_poses"
    assert "mount.delay" in record["measurement"]["nuisance_parameters"]
    np.testing.assert_allclose(record["pose"]["grasp_m"], alone["pose"]["grasp_m"], atol=1e-4)
    assert in_base["frame"] == "base"
    moved_m = np.add(record["pose"]["grasp_m"], [1.0, 0.2, 0.3])
    np.testing.assert_allclose(in_base["pose"]["grasp_m"], moved_m, atol=1e-9)
    assert (track["frame"], track["camera"]) == ("base", "robot_poses")
    away_m = np.array(track["grasp"]["point_m"]) - [1.0, 0.2, 0.3] - alone["pose"]["grasp_m"]
    assert np.abs(away_m[[0, 2]]).max() < 5e-4  # y runs along the face, on which the point is chosen anew


def test_a_camera_beside_the_robot_gives_poses_and_tracks_in_the_base_without_its_poses(mounted, tmp_path, run):
    rig, shots = mounted
    fixed = np.eye(4)
    fixed[:3, 3] = [1.0, 0.2, 0.3]
    values = yaml.safe_load(rig.read_text())
    rig.write_text(yaml.safe_dump({**values, "mount": {"base_from_camera": fixed.tolist()}}))
    (alone,) = run("pose", shots, "--rig", rig).records

    (in_base,) = run("pose", shots, "--rig", rig, "--frame", "base").records
    (track,) = run("pose", shots, "--rig", rig, "--frame", "base", "--track").records
    robot = robot_poses(tmp_path / "robot.jsonl", -1.0, 1.0)
    (in_tool,) = run("pose", shots, "--rig", rig, "--frame", "tool", "--robot-poses", robot).records
    without = run("pose", shots, "--rig", rig, "--frame", "tool")

    moved_m = np.add(alone["pose"]["grasp_m"], [1.0, 0.2, 0.3])
    np.testing.assert_allclose(in_base["pose"]["grasp_m"], moved_m, atol=1e-9)
    np.testing.assert_allclose(in_tool["pose"]["grasp_m"], alone["pose"]["grasp_m"], atol=1e-9)
    assert (in_base["frame"], in_tool["frame"]) == ("base", "tool")
    assert (track["frame"], track["camera"]) == ("base", "at_rest")
    assert without.status == 2
    assert "tool needs the poses of the robot" in without.messages[0]


def test_poses_of_a_robots_own_table_are_those_of_records(mounted, tmp_path, run):
    rig, shots = mounted
    pose = {"position_m": [1.0, 0.2, 0.3], "orientation_xyzw": [0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)]}
    records, table = tmp_path / "robot.jsonl", tmp_path / "robot.csv"
    stamps_s = (1.7e9 + np.arange(-1.0, 1.0, 0.1)).tolist()
    records.write_text("".join(json.dumps({"stamp_s": each, "base_from_tool": pose}) + "\n" for each in stamps_s))
    table.write_text("stamp_s,x,y,z,a,b,c\n" + "".join(f"{each!r},1000,200,300,90,0,0\n" for each in stamps_s))
    words = ("pose", shots, "--rig", rig, "--frame", "base", "--robot-poses")

    (expected,) = run(*words, records).records
    (record,) = run(*words, table, "--robot-convention", "kuka").records

    np.testing.assert_allclose(record["pose"]["grasp_m"], expected["pose"]["grasp_m"], atol=1e-9)
    np.testing.assert_allclose(record["pose"]["normal"], expected["pose"]["normal"], atol=1e-9)


def test_a_table_of_robot_poses_without_stamps_is_named_with_its_line(mounted, tmp_path, run):
    rig, shots = mounted
    table = tmp_path / "robot.csv"
    table.write_text("x,y,z,a,b,c\n1000,200,300,0,0,0\n1000,200,310,0,0,0\n")

    found = run("pose", shots, "--rig", rig, "--robot-poses", table, "--robot-convention", "kuka")

    assert found.status == 65
    assert "robot.csv:2: has no stamp" in found.messages[0]


def test_a_shot_that_the_robot_poses_do_not_cover_has_no_pose_and_a_reason(mounted, tmp_path, run):
    rig, shots = mounted
    robot = robot_poses(tmp_path / "robot.jsonl", 5.0, 6.0)

    found = run("pose", shots, "--rig", rig, "--robot-poses", robot)

    (record,) = found.records
    assert found.status == 3
    assert record["pose"] is None
    assert "robot" in record["reason"]


def test_poses_are_written_as_messages_of_ros(mounted, run):
    rig, shots = mounted
    (record,) = run("pose", shots, "--rig", rig).records

    (message,) = run("pose", shots, "--rig", rig, "--format", "ros").records

    assert fits(message["pose"], "geometry_msgs/PoseWithCovarianceStamped")
    assert fits(message["twist"], "geometry_msgs/TwistWithCovarianceStamped")
    assert list(message["pose"]["pose"]["pose"]["position"].values()) == record["pose"]["center_m"]
    stamp = message["pose"]["header"]["stamp"]
    assert stamp["sec"] + 1e-9 * stamp["nanosec"] == pytest.approx(record["pose_stamp_s"], abs=1e-6)
    assert message["status"] == record["status"]


def test_the_newest_lines_state_how_many_were_skipped(rig, detections, run):
    records = run("pose", detections, "--rig", rig, "--newest").records

    assert len(records) + sum(record["lines_skipped"] for record in records) == 3
