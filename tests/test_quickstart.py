"""The commands of ringpose-quickstart(7), run against the virtual camera and relay board of its rehearsal."""

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[1] / "man" / "ringpose-quickstart.7"
PROGRAMS = Path(sys.executable).parent
SHOWN = {"4. Calibrate the camera": "camera-board", "5. Calibrate the light planes": "plane-board"}
"""What the virtual camera sees in a step; else the ring."""


def displays(text: str) -> list[str]:
    return re.findall(r"^\.Bd -literal[^\n]*\n(.*?)^\.Ed", text, re.DOTALL | re.MULTILINE)


def steps() -> dict[str, list[str]]:
    """The commands of each step, without those that name the devices."""
    section = PAGE.read_text().split(".Sh STEP BY STEP\n")[1].split("\n.Sh ")[0]
    parts = [part.split("\n", 1) for part in section.split("\n.Ss ")[1:]]
    commands = {title: re.findall(r"^\$ (.*)", "".join(displays(text)), re.MULTILINE) for title, text in parts}
    return {
        title: [each for each in found if not each.startswith(("CAMERA=", "LASERS="))]
        for title, found in commands.items()
    }


@pytest.fixture
def serving(tmp_path, loopback_address):
    """Starts the devices of the rehearsal, which show a target, and returns the environment with their URIs."""
    rig, scene, serve = displays(PAGE.read_text().split(".Sh REHEARSAL WITHOUT HARDWARE\n")[1])
    (tmp_path / "scene-rig.yaml").write_text(rig)
    (tmp_path / "scene.yaml").write_text(scene)
    running = []

    def stop() -> None:
        for process in running:
            process.send_signal(signal.SIGTERM)
            assert process.wait(300) == 143
            process.stdout.close()
        running.clear()

    def started(shown: str) -> dict[str, str]:
        stop()
        program, *words = serve.replace("--show ring", f"--show {shown}").split()
        command = [PROGRAMS / program, *words, "--camera", loopback_address]
        running.append(subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True))
        uris = json.loads(running[-1].stdout.readline())
        path = f"{PROGRAMS}{os.pathsep}{os.environ['PATH']}"
        return {**os.environ, "PATH": path, "CAMERA": uris["camera"], "LASERS": uris["lasers"]}

    yield started
    stop()


@pytest.mark.slow
@pytest.mark.usefixtures("_aravis")
def test_the_commands_lead_to_poses_and_a_track(tmp_path, serving):
    for title, commands in steps().items():
        environment = serving(SHOWN.get(title, "ring"))
        for command in commands:
            done = subprocess.run(
                ["bash", "-c", f"set -euo pipefail; {command}"],
                cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=3000,
            )  # fmt: skip
            assert done.returncode == 0, (command, done.stdout[-1000:], done.stderr)

    poses = [json.loads(line) for line in (tmp_path / "poses.jsonl").read_text().splitlines()]
    tracks = [json.loads(line) for line in (tmp_path / "tracks.jsonl").read_text().splitlines()]
    assert {pose["status"] for pose in poses} == {"ok"}
    assert "valid" in {track["validity"] for track in tracks}


def test_every_step_has_a_command():
    found = steps()

    assert len(found) == 8
    assert all(found.values())
