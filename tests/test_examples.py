"""Every example runs as it stands."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
SESSIONS = sorted(path for path in EXAMPLES.glob("*.sh") if path.name != "demo.sh")
ENVIRONMENT = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


def run_session(script: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["sh", script, folder / "out"], cwd=folder, env=ENVIRONMENT, capture_output=True, text=True, timeout=300
    )


@pytest.mark.parametrize("script", SESSIONS, ids=lambda script: script.name)
def test_a_shell_session_runs_to_its_end(script, tmp_path):
    done = run_session(script, tmp_path)

    assert done.returncode == 0, done.stderr


def test_real_shots_draw_an_overlay_for_each_shot(tmp_path, carried_data):
    run_session(EXAMPLES / "real-shots.sh", tmp_path)

    shots = {path.stem for path in (carried_data / "rig_b" / "shots").iterdir()}
    assert {path.stem for path in (tmp_path / "out" / "overlay").glob("*.png")} == shots


@pytest.mark.slow
def test_the_demo_measures_and_draws_every_shot(tmp_path):
    done = run_session(EXAMPLES / "demo.sh", tmp_path)

    assert done.returncode == 0, done.stderr
    out = tmp_path / "out"
    shots = {path.stem for path in (out / "simulated" / "shots").iterdir()}
    lines = [json.loads(line) for line in (out / "poses.jsonl").read_text().splitlines()]
    assert len(shots) > 5
    assert {line["shot"] for line in lines} == shots
    assert {path.stem for path in (out / "overlay").iterdir()} == shots
    assert sum(line["pose"] is not None for line in lines) > len(shots) / 2


@pytest.fixture
def controller():
    """Starts the example controller, which ends when its input does."""

    def start(*words: str) -> subprocess.Popen[str]:
        program = [sys.executable, "-W", "error", EXAMPLES / "controller.py", *words]
        return subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    return start


def pose_line(shot: str, grasp_sd_m: float = 1e-4, tilt_sd_rad: float = 1e-3) -> str:
    full = [[(tilt_sd_rad**2 / 2 if row == column else 0.0) for column in range(7)] for row in range(7)]
    grasp = [[(grasp_sd_m**2 / 3 if row == column else 0.0) for column in range(3)] for row in range(3)]
    pose = {
        "normal": [0.0, 0.6, -0.8],
        "grasp_m": [0.1, 0.2, 0.5],
        "covariance": {"full": full, "center": None, "grasp": grasp},
    }
    return json.dumps({"schema": "ringpose/pose/1", "shot": shot, "flags": [], "reason": None, "pose": pose}) + "\n"


def told(process: subprocess.Popen[str], lines: str) -> list[dict]:
    out, _ = process.communicate(lines, timeout=30)
    return [json.loads(line) for line in out.splitlines()]


def test_the_controller_moves_to_a_grasp_point_that_is_well_known(controller):
    (command,) = told(controller(), pose_line("a"))

    assert (command["do"], command["to_m"], command["along"]) == ("move", [0.1, 0.2, 0.5], [-0.0, -0.6, 0.8])


@pytest.mark.parametrize("bad", [{"grasp_sd_m": 0.003}, {"tilt_sd_rad": 0.06}])
def test_the_controller_holds_when_the_pose_is_not_sure_enough(controller, bad):
    (command,) = told(controller(), pose_line("a", **bad))

    assert command["do"] == "hold"


def test_the_controller_holds_without_a_pose_and_says_why(controller):
    record = json.loads(pose_line("a")) | {"reason": "the image is dark", "pose": None}

    (command,) = told(controller(), json.dumps(record) + "\n")

    assert (command["do"], command["why"]) == ("hold", "the image is dark")


def test_the_controller_holds_where_the_normal_is_not_known(controller):
    record = json.loads(pose_line("a"))
    record["pose"]["normal"] = None
    record["flags"] = ["normal_weak"]

    (command,) = told(controller(), json.dumps(record) + "\n")

    assert (command["do"], command["why"]) == ("hold", "normal_weak")


@pytest.mark.parametrize("line", ["junk\n", pose_line("a")[:200], "[]\n", pose_line("a").replace("pose/1", "pose/2")])
def test_the_controller_holds_where_a_line_is_no_pose_line(controller, line):
    (command,) = told(controller(), line)

    assert (command["do"], command["why"]) == ("hold", "a line that is no pose line")


def test_the_controller_holds_where_nobody_knows_what_is_wrong(controller):
    record = json.loads(pose_line("a")) | {"flags": ["inconsistent"], "reason": "no single part is to blame"}

    (command,) = told(controller(), json.dumps(record) + "\n")

    assert (command["do"], command["why"]) == ("hold", "no single part is to blame")


def test_the_controller_holds_when_the_rig_has_changed(controller):
    record = json.loads(pose_line("a")) | {"laser_health": {"left": 0.4, "middle": 7.5, "right": None}}

    (command,) = told(controller(), json.dumps(record) + "\n")

    assert command["do"] == "hold"


def test_the_controller_takes_the_newest_line_and_counts_those_it_skipped(controller):
    commands = told(controller("--period", "0.5"), "".join(pose_line(str(number)) for number in range(100)))

    assert commands[-1]["shot"] == "99"
    assert len(commands) + sum(command["skipped"] for command in commands) == 100


def test_the_controller_does_not_wait_for_a_pose(controller):
    with controller("--patience", "0.1") as process:
        assert process.stdout is not None
        assert process.stdin is not None
        began_s = time.monotonic()
        first = json.loads(process.stdout.readline())
        process.stdin.close()

    assert first == {"do": "hold", "why": "no pose for 0.1 s"}
    assert time.monotonic() - began_s < 10
