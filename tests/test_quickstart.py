"""The commands of ringpose-quickstart(7), run against the virtual devices and the simulated robot of its rehearsal."""

import json
import os
import re
import runpy
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "man" / "ringpose-quickstart.7"
ROBOT = ROOT / "examples" / "simulated_robot.py"
PROGRAMS = Path(sys.executable).parent
SHOWN = {"4. Calibrate the camera": "camera-board", "5. Calibrate the light planes": "plane-board"}
"""What the virtual camera sees in a step; else the ring."""

MEAN_RADIUS_M = (0.567 + 0.597) / 2
"""Of the ring in the rehearsal, in the middle of whose face a gripper closes."""


def displays(text: str) -> list[str]:
    found = re.findall(r"^\.Bd -literal[^\n]*\n(.*?)^\.Ed", text, re.DOTALL | re.MULTILINE)
    return [display.replace("\\e\n", "\\\n") for display in found]


def steps() -> dict[str, list[str]]:
    """The commands of each step, without those that name the devices."""
    section = PAGE.read_text().split(".Sh STEP BY STEP\n")[1].split("\n.Sh ")[0]
    parts = [part.split("\n", 1) for part in section.split("\n.Ss ")[1:]]
    commands = {title: re.findall(r"^\$ (.*)", "".join(displays(text)), re.MULTILINE) for title, text in parts}
    return {
        title: [each for each in found if not re.match("(CAMERA|LASERS|ROBOT)=", each)]
        for title, found in commands.items()
    }


@pytest.fixture
def serving(tmp_path, loopback_address):
    """Starts the devices of the rehearsal, which show a target, and returns the environment with their URIs."""
    rig, scene, serve, robot, variable = displays(PAGE.read_text().split(".Sh REHEARSAL WITHOUT HARDWARE\n")[1])
    (tmp_path / "scene-rig.yaml").write_text(rig)
    (tmp_path / "scene.yaml").write_text(scene)
    shutil.copy(ROBOT, tmp_path)
    path = {"PATH": f"{PROGRAMS}{os.pathsep}{os.environ['PATH']}"}

    @contextmanager
    def started(shown: str):
        """The devices, and the robot of step 4 while they show the camera's board."""
        program, *words = serve.replace("--show ring", f"--show {shown}").split()
        command = [PROGRAMS / program, *words, "--camera", loopback_address]
        running = [subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True)]
        try:
            uris = json.loads(running[0].stdout.readline())
            if shown == "camera-board":
                running.append(subprocess.Popen(["bash", "-c", f"exec {robot}"], cwd=tmp_path, env=os.environ | path))
            name, value = variable.strip().split("=", 1)
            yield {**os.environ, **path, "CAMERA": uris["camera"], "LASERS": uris["lasers"], name: value.strip("'")}
        finally:
            for process in running[::-1]:
                process.send_signal(signal.SIGTERM)
                process.wait(300)
            running[0].stdout.close()
        assert running[0].returncode == 143

    return started


def run(command: str, folder: Path, environment: dict[str, str]) -> None:
    done = subprocess.run(
        ["bash", "-c", f"set -euo pipefail\n{command}"],
        cwd=folder, env=environment, capture_output=True, text=True, timeout=3000,
    )  # fmt: skip
    assert done.returncode == 0, (command, done.stdout[-1000:], done.stderr)


def lines(file: Path) -> list[dict]:
    return [json.loads(line) for line in file.read_text().splitlines()]


def squared_sigmas(error, covariance) -> float:
    return float(np.dot(error, np.linalg.solve(np.array(covariance, dtype=float), error)))


@pytest.mark.slow
@pytest.mark.usefixtures("_aravis")
def test_the_commands_lead_to_poses_in_the_base_of_the_robot(tmp_path, serving):
    for title, commands in steps().items():
        with serving(SHOWN.get(title, "ring")) as environment:
            for command in commands:
                run(command, tmp_path, environment)
    section = (ROOT / "man" / "ringpose-robot.7").read_text().split(".Sh FROM THE CAMERA TO THE BASE\n")[1]
    with serving("ring") as environment:
        for script in displays(section.split("\n.Sh ")[0]):
            run(script, tmp_path, environment)

    truth = runpy.run_path(str(ROBOT))
    assert {pose["status"] for pose in lines(tmp_path / "poses.jsonl")} == {"ok"}
    assert "valid" in {track["validity"] for track in lines(tmp_path / "tracks.jsonl")}
    assert_mount_is(truth["TOOL_FROM_CAMERA"], yaml.safe_load((tmp_path / "robot-rig.yaml").read_text())["mount"])
    for file in ("base.jsonl", "recorded.jsonl"):
        poses = lines(tmp_path / file)
        assert len(poses) == 3
        for pose in poses:
            assert_ring_is(truth["BASE_FROM_TARGET"]["ring"], pose)
    tracks = lines(tmp_path / "base-tracks.jsonl")
    assert {track["frame"] for track in tracks} == {"base"}
    assert any(track["validity"] == "valid" for track in tracks)
    for track in tracks:
        if track["pose"] is not None:
            assert_ring_is(truth["BASE_FROM_TARGET"]["ring"], track)


def assert_mount_is(tool_from_camera, mount) -> None:
    """To less than 5 standard deviations, which are those of a mount that is good enough to grasp."""
    estimated, covariance = np.array(mount["tool_from_camera"]), np.array(mount["covariance"])
    turn = Rotation.from_matrix(tool_from_camera[:3, :3] @ estimated[:3, :3].T).as_rotvec()
    error = [*turn, *(tool_from_camera[:3, 3] - estimated[:3, 3])]
    assert squared_sigmas(error, covariance) < 5**2
    assert np.sqrt(np.diag(covariance)[3:]).max() < 5e-4


def assert_ring_is(base_from_ring, line: dict) -> None:
    """Centre, normal and grasp point are no more than 5 standard deviations from the ring (the design's `wrong`)."""
    pose, center_m, axis = line["pose"], base_from_ring[:3, 3], base_from_ring[:3, 2]
    assert line["frame"] == "base"
    covariance = pose["covariance"]
    assert squared_sigmas(np.subtract(pose["center_m"], center_m), covariance["center"]) < 5**2
    tilt_sd_rad = np.sqrt(np.linalg.eigvalsh(np.array(covariance["full"], dtype=float)[:2, :2]).max())
    assert np.linalg.norm(np.cross(pose["normal"], axis)) < 5 * tilt_sd_rad < 0.05
    outwards = np.subtract(pose["grasp_m"], center_m)
    along = outwards @ axis
    radial = outwards - along * axis
    off = along * axis + radial * (1 - MEAN_RADIUS_M / np.linalg.norm(radial))
    sd_m = np.sqrt(np.trace(np.array(covariance["grasp"], dtype=float)))
    assert np.linalg.norm(off) < 5 * sd_m
    assert sd_m < 2e-3


def test_every_step_has_a_command():
    found = steps()

    assert len(found) == 9
    assert all(found.values())
