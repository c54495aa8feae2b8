"""The motion of scenes and trajectory files, and the messages for invalid ones."""

import json

import numpy as np
import pytest

from ringpose.cli.main import main
from ringpose.errors import DataError
from ringpose.files.scenes.motions import read_poses
from ringpose.types.target import MOTION_PRESETS, FreeMotion, TimedPoses

POSES = [
    {"time_s": 0.0, "position_m": [-0.58, 0, 0.5], "orientation_xyzw": [1, 0, 0, 0]},
    {"time_s": 2.0, "position_m": [-0.58, 0, 0.4], "orientation_xyzw": [1, 0, 0, 0]},
]
CSV = "time_s,x_m,y_m,z_m,qx,qy,qz,qw\n0,-0.58,0,0.5,1,0,0,0\n2,-0.58,0,0.4,1,0,0,0\n"


@pytest.fixture
def scene_with(scene_of):
    """Reads a scene with this `motion`; other keys replace those of the scene."""
    view = {"name": "a", "center_m": [-0.58, 0, 0.5], "pitch_rad": 0.0, "yaw_rad": 0.0}
    plain = {"lights": None, "boards": None, "body": {"size_m": [2.0, 1.0, 3.0]}, "trajectory": [view]}
    return lambda motion, **keys: scene_of(*(plain | {"motion": motion} | keys).items())


def test_without_numbers_of_its_own_the_motion_is_that_of_a_uniform_body(scene_with):
    motion = scene_with({"angular_velocity_rad_s": [0.0, 0.1, 0.0], "shots": 3}).motion

    np.testing.assert_allclose(np.diag(motion.inertia_kg_m2), [10 / 12, 13 / 12, 5 / 12])
    np.testing.assert_allclose(motion.center_of_mass_m, [0.0, 0.0, -1.5])


@pytest.mark.parametrize(
    ("preset", "degrees_s"), [("geo-typical", 0.3), ("geo-bound", 1.0), ("envisat", 2.67), ("stress", 8.0)]
)
def test_presets_have_their_rates(scene_with, preset, degrees_s):
    motion = scene_with({"preset": preset}).motion

    assert np.degrees(np.linalg.norm(motion.angular_velocity_rad_s)) == pytest.approx(degrees_s, abs=0.002)


def test_the_preset_of_envisat_brings_its_own_inertia(scene_with):
    motion = scene_with({"preset": "envisat", "velocity_m_s": [0.0, 0.0, 0.01]}).motion

    np.testing.assert_array_equal(np.diag(motion.inertia_kg_m2), MOTION_PRESETS["envisat"].inertia_kg_m2)
    np.testing.assert_array_equal(motion.velocity_m_s, [0.0, 0.0, 0.01])


def test_waypoints_of_the_camera_are_poses_in_time(scene_with):
    motion = scene_with({"camera": [{"time_s": 0, "position_m": [0, 0, 0]}, {"time_s": 5, "position_m": [0, 0, 0.2]}]})

    assert isinstance(motion.motion, FreeMotion)
    assert motion.motion.camera.time_s.tolist() == [0.0, 5.0]


@pytest.mark.parametrize("name", ["poses.csv", "poses.jsonl"])
def test_trajectory_files_are_read_in_both_formats(scene_with, tmp_path, name):
    text = CSV if name.endswith("csv") else "".join(json.dumps(pose) + "\n" for pose in POSES)
    (tmp_path / name).write_text(text)

    scene = scene_with({"file": name, "shots": 2}, trajectory=None)

    assert isinstance(scene.motion, TimedPoses)
    np.testing.assert_allclose(scene.motion.position_m[1], [-0.58, 0.0, 0.4])
    assert [view.name for view in scene.views] == ["moving"]


SKEW = [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]


def waypoints(*times_s: float) -> list[dict]:
    """Poses of a camera that does not move."""
    return [{"time_s": time_s, "position_m": [0, 0, 0]} for time_s in times_s]


@pytest.mark.parametrize(
    ("motion", "place", "word"),
    [
        ({}, "motion", "has no motion"),
        ({"preset": "geo-bond"}, "motion.preset", "geo-bound"),
        ({"angular_velocity": [0, 0, 1]}, "motion", "unknown key"),
        ({"angular_velocity_rad_s": [0, 0, 5]}, "motion.angular_velocity_rad_s", "degrees"),
        ({"velocity_m_s": [0, 0, 50]}, "motion.velocity_m_s", "0 to 10"),
        ({"preset": "stress", "inertia_kg_m2": [1, 1, 3]}, "motion.inertia_kg_m2", "sum of the other two"),
        ({"preset": "stress", "inertia_kg_m2": [1, 1, 0]}, "motion.inertia_kg_m2", "positive"),
        ({"preset": "stress", "inertia_kg_m2": SKEW}, "motion.inertia_kg_m2", "symmetric"),
        ({"camera": waypoints(0)}, "motion.camera", "at least 2"),
        ({"camera": waypoints(1, 2)}, "motion.camera", "begin at 0"),
        ({"camera": waypoints(1, 1)}, "motion.camera[1].time_s", "not later"),
        ({"preset": "stress", "shots": 0}, "motion.shots", "at least 1"),
        ({"file": "poses.csv"}, "trajectory[0].center_m", "those of motion"),
    ],
)
def test_invalid_motions_are_rejected_with_their_place(scene_with, tmp_path, motion, place, word):
    (tmp_path / "poses.csv").write_text(CSV)

    with pytest.raises(DataError) as error:
        scene_with(motion)

    assert error.value.location.endswith(place)
    assert word in str(error.value)


@pytest.mark.parametrize(
    ("text", "place", "word"),
    [
        (CSV.replace("x_m", "x"), ":1", "columns"),
        (CSV.replace("0.4", "near"), ":3", "not a number"),
        (CSV.replace(",0.4", ""), ":3", "7 values"),
        (CSV.replace("\n2,", "\n0,"), ":3: time_s", "not later"),
        (CSV.replace("0.4,1", "0.4,2"), ":3: orientation_xyzw", "length 2"),
        (CSV.replace("0.4", "400"), ":3: position_m", "millimetres"),
        (CSV.replace("0.4", "nan"), ":3: position_m", "NaN among its numbers"),
    ],
)
def test_invalid_trajectory_files_are_rejected_with_their_line(tmp_path, text, place, word):
    path = tmp_path / "poses.csv"
    path.write_text(text)

    with pytest.raises(DataError) as error:
        read_poses(path)

    assert error.value.location == f"{path}{place}"
    assert word in str(error.value)


@pytest.mark.parametrize(
    ("shots", "keys"),
    [(30, {}), (2, {"period_s": 1.98, "exposure_s": 0.01, "sequence": "off,all,off"})],
    ids=["between shots", "within the last shot"],
)
def test_a_trajectory_that_ends_too_early_is_rejected_before_anything_is_written(
    scene_with, tmp_path, capsys, shots, keys
):
    (tmp_path / "poses.csv").write_text(CSV)
    scene_with({"file": "poses.csv", "shots": shots}, trajectory=None, **keys)

    assert main(["simulate", str(tmp_path / "scene.yaml"), "-o", str(tmp_path / "out")]) == 65
    assert "covers 0 to 2 s" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_trajectory_file_excludes_other_keys_of_the_motion(scene_with):
    with pytest.raises(DataError, match=r"motion\.preset.*file"):
        scene_with({"file": "poses.csv", "preset": "stress"}, trajectory=None)


def test_features_of_a_moving_scene_state_that_it_moves(scene_with, tmp_path, capsys):
    scene_with({"preset": "stress"})

    assert main(["simulate", str(tmp_path / "scene.yaml"), "--features"]) == 0
    assert json.loads(capsys.readouterr().out)["still"] is False
