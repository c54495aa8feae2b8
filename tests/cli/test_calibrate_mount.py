"""`ringpose calibrate-mount`: views and poses -> rig.yaml, on boards that a simulated robot sees."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from known_views import CHESSBOARD, TRUE_CAMERA, board_view
from moving_robots import seen_by_a_moving_robot
from scipy.spatial.transform import Rotation

from ringpose.calibrate.boards import shots as board_shots
from ringpose.cli.main import main
from ringpose.files.boards import write_board
from ringpose.files.cameras.ros import write_camera
from ringpose.files.images.codecs import write_image
from ringpose.files.rigs import read_mount, read_rig
from ringpose.geometry.board import corner_points

MOUNT = np.eye(4)
MOUNT[:3, :3] = Rotation.from_euler("ZYX", [0.4, -0.2, 0.1]).as_matrix()
MOUNT[:3, 3] = [0.03, -0.02, 0.08]


@pytest.fixture
def session(tmp_path, monkeypatch, rng):
    """A folder with a board, a camera, images (whose boards are known), and KUKA's poses of the robot."""
    monkeypatch.chdir(tmp_path)
    write_board(tmp_path / "board.yaml", CHESSBOARD)
    write_camera(tmp_path / "camera.yaml", TRUE_CAMERA)
    (tmp_path / "views").mkdir()
    base_from_board = np.eye(4)
    base_from_board[:3, 3] = [0.8, 0.1, 0.0]
    views, lines = {}, ["shot,X,Y,Z,A,B,C"]
    for number in range(8):
        seen = np.eye(4)
        seen[:3, :3] = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, 3)).as_matrix()
        seen[:3, 3] = [0.0, 0.0, 0.5] - seen[:3, :3] @ [0.15, 0.125, 0.0]
        name = f"view{number}"
        noise = rng.normal(0, 0.05, (99, 2))
        views[name] = board_view(corner_points(CHESSBOARD), (seen[:3, :3], seen[:3, 3]), name, noise)
        write_image(tmp_path / "views" / f"{name}.png", rng.integers(0, 255, (12, 16)).astype(np.uint8))
        pose = base_from_board @ np.linalg.inv(MOUNT @ seen)
        numbers = [*(1e3 * pose[:3, 3]), *Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX", degrees=True)]
        lines.append(",".join([name, *(f"{each:.5f}" for each in numbers)]))
    (tmp_path / "poses.csv").write_text("\n".join(lines) + "\n")
    monkeypatch.setattr(board_shots.BoardSearch, "__call__", lambda _self, _image, _board, name: views[name])
    return tmp_path


WORDS = ("calibrate-mount", "views", "--board", "board.yaml", "--camera", "camera.yaml", "--robot-poses", "poses.csv")


def test_the_mount_is_written_and_agrees_with_the_views(session, capsys):
    assert main([*WORDS, "--robot-convention", "kuka", "-o", "mount.yaml"]) == 0

    np.testing.assert_allclose(read_mount(session / "mount.yaml").carrier_from_camera, MOUNT, atol=1e-3)
    written = yaml.safe_load((session / "mount.yaml").read_text())
    assert written["quality"]["mount"]["held_out_rms_m"] < 5e-4
    assert set(written["provenance"]["inputs"]) >= {"board.yaml", "camera.yaml", "poses.csv"}
    assert "held-out error of the board's place" in capsys.readouterr().err
    assert main([*WORDS, "--robot-convention", "kuka", "--check", "mount.yaml"]) == 0


def test_a_camera_beside_the_robot_has_a_mount_in_its_base(session, capsys):
    header, *rows = (session / "poses.csv").read_text().splitlines()
    inverted = []
    for row in rows:  # the tool carries the board: the given poses turned round
        name, *numbers = row.split(",")
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_euler("ZYX", [float(each) for each in numbers[3:]], degrees=True).as_matrix()
        pose[:3, 3] = [1e-3 * float(each) for each in numbers[:3]]
        back = np.linalg.inv(pose)
        numbers = [*(1e3 * back[:3, 3]), *Rotation.from_matrix(back[:3, :3]).as_euler("ZYX", degrees=True)]
        inverted.append(",".join([name, *(f"{each:.5f}" for each in numbers)]))
    (session / "poses.csv").write_text("\n".join([header, *inverted]) + "\n")

    assert main([*WORDS, "--robot-convention", "kuka", "--eye-to-hand", "-o", "mount.yaml"]) == 0

    written = yaml.safe_load((session / "mount.yaml").read_text())["mount"]
    assert "tool_from_camera" not in written
    np.testing.assert_allclose(written["base_from_camera"], MOUNT, atol=1e-3)
    check = (*WORDS, "--robot-convention", "kuka", "--check", "mount.yaml")
    assert main([*check, "--eye-to-hand"]) == 0
    assert main([*check]) == 2
    assert "give --eye-to-hand" in capsys.readouterr().err


def test_what_is_missing_or_wrong_is_reported_with_its_status(session, capsys):
    assert main([*WORDS, "-o", "mount.yaml"]) == 2
    assert "--robot-convention" in capsys.readouterr().err
    assert main([*WORDS, "--robot-convention", "mitsubishi", "-o", "mount.yaml"]) == 65
    assert "likely the angles are of the order ZYX" in capsys.readouterr().err
    assert not (session / "mount.yaml").exists()


@pytest.fixture
def moving_session(tmp_path, monkeypatch, rng):
    """Shots of a board (found by their names), and poses of a robot that moves, whose clock is 80 ms ahead."""
    seen = seen_by_a_moving_robot(rng, views=10, delay_s=0.08, rate_hz=50.0)
    monkeypatch.chdir(tmp_path)
    write_board(tmp_path / "board.yaml", CHESSBOARD)
    write_camera(tmp_path / "camera.yaml", TRUE_CAMERA)
    (tmp_path / "views").mkdir()
    for view, stamp_s in zip(seen.views, seen.stamps_s, strict=True):
        np.savez(
            tmp_path / "views" / f"{view.name}.npz", images=rng.integers(0, 255, (1, 12, 16)).astype(np.uint8),
            lasers=np.zeros(1, np.uint8), stamp_s=np.array([stamp_s - 0.001]), exposure_s=np.array([0.002]),
        )  # fmt: skip
    lines = [
        json.dumps({
            "stamp_s": stamp_s,
            "base_from_tool": {
                "position_m": pose[:3, 3].tolist(),
                "orientation_xyzw": Rotation.from_matrix(pose[:3, :3]).as_quat().tolist(),
            },
        })
        for stamp_s, pose in zip(seen.robot_s.tolist(), seen.poses, strict=True)
    ]  # fmt: skip
    (tmp_path / "robot.jsonl").write_text("\n".join(lines) + "\n")
    views = {view.name: view for view in seen.views}
    monkeypatch.setattr(board_shots.BoardSearch, "__call__", lambda _self, _image, _board, name: views[name])
    return seen


MOVING_WORDS = (*WORDS[:-1], "robot.jsonl")


def test_a_moving_robot_gives_the_mount_and_the_offset_of_its_clock(moving_session, capsys):
    assert main([*MOVING_WORDS, "--moving", "-o", "mount.yaml"]) == 0

    mount = read_mount(Path("mount.yaml"))
    assert mount.delay_s == pytest.approx(0.08, abs=5.0 * mount.delay_sd_s)
    assert 0.0 < mount.delay_sd_s < 1e-3
    np.testing.assert_allclose(mount.carrier_from_camera, moving_session.mount, atol=3e-3)
    assert "the robot's stamps are those of the camera + " in capsys.readouterr().err
    assert yaml.safe_load(Path("mount.yaml").read_text())["quality"]["mount"]["delay"]["is_determined"]


def test_a_robot_that_moves_at_the_views_is_reported_without_moving(moving_session, capsys):
    main([*MOVING_WORDS, "-o", "mount.yaml"])

    assert "give --moving" in capsys.readouterr().err


@pytest.mark.slow
def test_one_session_of_rendered_shots_gives_the_whole_rig(tmp_path, monkeypatch, shared_data, rng, capsys):
    """The shots of another program; the robot's poses are those of its truth with errors of 0.1 mm and 0.01 degrees."""
    data = shared_data / "rendered" / "calib_b"
    monkeypatch.chdir(tmp_path)
    base_from_board = np.eye(4)
    base_from_board[:3, 3] = [0.8, 0.1, 0.0]
    lines = []
    for truth in map(json.loads, (data / "truth.jsonl").read_text().splitlines()):
        seen, error = np.eye(4), np.eye(4)
        seen[:3, :3] = Rotation.from_rotvec(truth["camera_from_board_rvec"]).as_matrix()
        seen[:3, 3] = truth["camera_from_board_tvec_m"]
        error[:3, :3] = Rotation.from_rotvec(rng.normal(0, 1.7e-4, 3)).as_matrix()
        error[:3, 3] = rng.normal(0, 1e-4, 3)
        pose = base_from_board @ np.linalg.inv(MOUNT @ seen) @ error
        tool = {
            "position_m": pose[:3, 3].tolist(),
            "orientation_xyzw": Rotation.from_matrix(pose[:3, :3]).as_quat().tolist(),
        }
        lines.append(json.dumps({"shot": truth["view"], "base_from_tool": tool}))
    Path("robot.jsonl").write_text("\n".join(lines) + "\n")
    words = ["calibrate-mount", "--whole-rig", str(data / "planes"), "--board", str(data / "plane_board.yaml")]
    words += [
        "--robot-poses",
        "robot.jsonl",
        "--laser-names",
        "left,middle,right",
        "--laser-order",
        "right,middle,left",
    ]

    status = main([*words, "--output", "rig.yaml"])

    assert status in (0, 3)  # eight views of 16 corners leave the camera uncertain
    rig, true = (read_rig(path, for_rings=False) for path in (Path("rig.yaml"), data / "true_rig.yaml"))
    np.testing.assert_allclose(rig.mount.carrier_from_camera, MOUNT, atol=3e-3)
    tilt = np.arccos(np.clip(np.abs(np.sum(rig.lasers.normal * true.lasers.normal, axis=1)), 0, 1))
    assert np.degrees(tilt).max() < 0.3
    held_out = yaml.safe_load(Path("rig.yaml").read_text())["quality"]["whole_rig"]["held_out"]
    assert held_out["joint"]["stripes_rms_m"] < 1e-3
    assert "kept: the " in capsys.readouterr().err


def test_options_that_the_whole_rig_determines_itself_are_refused(session, capsys):
    assert main([*WORDS, "--robot-convention", "kuka", "--whole-rig", "-o", "rig.yaml"]) == 2
    assert "--camera: is of no use for --whole-rig" in capsys.readouterr().err
    assert main([*WORDS, "--robot-convention", "kuka", "--laser-names", "left", "-o", "rig.yaml"]) == 2
    assert "without --whole-rig" in capsys.readouterr().err
    without_camera = [word for word in WORDS if word not in ("--camera", "camera.yaml")]
    assert main([*without_camera, "--robot-convention", "kuka", "-o", "rig.yaml"]) == 2
    assert "--camera: is missing; or give --whole-rig" in capsys.readouterr().err
