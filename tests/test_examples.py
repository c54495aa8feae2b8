"""The example scripts, and the example controller that reads pose records."""

import argparse
import json
import math
import os
import runpy
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
SCRIPTS = sorted(path for path in EXAMPLES.glob("*.sh") if path.name not in ("demo.sh", "real-shots.sh"))
ENVIRONMENT = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


def run_script(script: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["sh", script, folder / "out"], cwd=folder, env=ENVIRONMENT, capture_output=True, text=True, timeout=3000
    )


@pytest.mark.slow  # the fast tests of test_main_job calibrate from the same views
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.name)
def test_a_shell_example_succeeds(script, tmp_path):
    done = run_script(script, tmp_path)

    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_the_example_of_real_shots_commands_moves_and_draws_overlays(tmp_path, carried_data):
    done = run_script(EXAMPLES / "real-shots.sh", tmp_path)

    assert done.returncode == 0, done.stderr
    assert '"do": "move"' in done.stdout
    assert "controller:" not in done.stderr
    shots = {path.stem for path in (carried_data / "rig_b" / "shots").iterdir()}
    assert {path.stem for path in (tmp_path / "out" / "overlay").glob("*.png")} == shots


@pytest.mark.slow
def test_the_demo_measures_and_draws_every_shot(tmp_path):
    done = run_script(EXAMPLES / "demo.sh", tmp_path)

    assert done.returncode == 0, done.stderr
    out = tmp_path / "out"
    shots = {path.stem for path in (out / "simulated" / "shots").iterdir()}
    lines = [json.loads(line) for line in (out / "poses.jsonl").read_text().splitlines()]
    assert len(shots) > 5
    assert {line["shot"] for line in lines} == shots
    assert {path.stem for path in (out / "overlay").iterdir()} == shots
    assert sum(line["pose"] is not None for line in lines) > len(shots) / 2


class Controller(NamedTuple):
    """Output of the example controller: commands, without the last hold ("the stream has ended"), and messages."""

    commands: list[dict]
    messages: list[str]


def started(*words: str, **options) -> "subprocess.Popen[str]":
    pipe = subprocess.PIPE
    program = [sys.executable, "-W", "error", EXAMPLES / "controller.py", "--max-age", "600", "--patience", "600"]
    program += words
    return subprocess.Popen(program, **({"stdin": pipe, "stdout": pipe, "stderr": pipe, "text": True} | options))


def controlled(lines: str, *words: str) -> Controller:
    """The output of the controller for a stream that ends."""
    process = started(*words)
    out, stderr = process.communicate(lines, timeout=300)
    *commands, last = [json.loads(line) for line in out.splitlines()]
    assert (process.returncode, last) == (0, {"do": "hold", "why": "the stream has ended"})
    return Controller(commands, stderr.splitlines())


def pose_record(shot: str = "a", level_m: float = 1e-3, level_rad: float = 0.02, **changes) -> dict:
    pose = {"normal": [0.0, 0.6, -0.8], "grasp_m": [0.1, 0.2, 0.5]}
    levels = {
        "risk": 1e-5,
        "grasp_normal_m": level_m,
        "grasp_radial_m": 5e-4,
        "normal_rad": level_rad,
        "center_m": None,
    }
    record = {
        "schema": "ringpose/pose/2",
        "shot": shot,
        "stamp_s": time.time(),
        "frame": "camera",
        "status": "ok",
        "reason": None,
        "flags": [],
        "pose": pose,
        "protection": levels,
    }
    return record | changes


def line_of(record: object) -> str:
    return json.dumps(record) + "\n"


@pytest.mark.parametrize(
    "more",
    [
        {},
        {"status": "degraded", "flags": ["center_weak", "new_flag"], "new_key": {}},
        {"schema": "ringpose/pose/1"},
        {"flags": ["radius_unverified", "rig_unchecked"]},
        {"schema": "ringpose/track/1", "shot": None, "validity": "valid"},
    ],
)
def test_the_controller_moves_to_an_accurate_grasp_point(more):
    (command,), messages = controlled(line_of(pose_record(**more)))

    assert (command["do"], command["to_m"], command["along"]) == ("move", [0.1, 0.2, 0.5], [-0.0, -0.6, 0.8])
    assert messages == []


def without_normal() -> dict:
    record = pose_record(status="degraded", flags=["normal_weak"])
    return record | {"pose": record["pose"] | {"normal": None}}


def with_levels(**levels: object) -> dict:
    record = pose_record(flags=["inconsistent"])
    return record | {"protection": record["protection"] | levels}


VERSION_1 = {"schema": "ringpose/pose/1"}

HELD = {
    "grasp point uncertain": (lambda: pose_record(level_m=0.006), "6.00 mm"),
    "normal uncertain": (lambda: pose_record(level_rad=0.06), "3.44 degrees"),
    "no levels": (lambda: pose_record(protection=None, flags=["grasp_weak"]), "grasp_weak"),
    "no levels, version 1": (lambda: pose_record(**VERSION_1, protection=None), "how far"),
    "no level of the grasp point": (lambda: with_levels(grasp_radial_m=None), "inconsistent"),
    "no level of the normal": (lambda: with_levels(normal_rad=None), "inconsistent"),
    "no pose": (lambda: pose_record(status="none", reason="the image is dark", pose=None), "the image is dark"),
    "status none": (lambda: pose_record(status="none"), "status"),
    "no normal": (without_normal, "normal_weak"),
    "rig has changed": (lambda: pose_record(rig_health={"left": 0.4, "right": None, "middle": 7.5}), "moved"),
    "rig has changed, version 1": (lambda: pose_record(**VERSION_1, laser_health={"left": 7.5}), "moved"),
    "other frame": (lambda: pose_record(frame="tool"), "frame"),
    "old": (lambda: pose_record(stamp_s=time.time() - 2000), "old"),
    "from the future": (lambda: pose_record(stamp_s=time.time() + 2000), "old"),
    "predicted": (lambda: pose_record(schema="ringpose/track/1", shot=None, validity="predicted"), "predicted"),
}


@pytest.mark.parametrize("case", HELD)
def test_the_controller_holds_if_a_record_is_not_usable(case):
    make, why = HELD[case]
    example = runpy.run_path(str(EXAMPLES / "controller.py"))
    limits = argparse.Namespace(frame="camera", max_age=600.0, replay=False, health=3.0)
    limits.alert_limit_m, limits.alert_limit_deg = 0.005, 3.0

    command = example["command"](example["record_in"](json.dumps(make())), limits, time.time())

    assert command["do"] == "hold"
    assert why in command["why"]


WITHOUT_KEYS = json.dumps({key: value for key, value in pose_record().items() if key not in ("frame", "flags")})

BROKEN = [
    "junk",
    WITHOUT_KEYS,
    "[]",
    json.dumps(pose_record())[:200],
    "[" * 100_000,
    "\udcff",
    *(
        json.dumps({key: value for key, value in pose_record().items() if key != left})
        for left in pose_record()
        if left != "protection"
    ),
    *(
        json.dumps(pose_record(**change))
        for change in (
            {"schema": "ringpose/pose/9"},
            {"schema": ["ringpose/pose/1"]},
            {"stamp_s": None},
            {"stamp_s": 10**400},
            {"stamp_s": math.inf},
            {"stamp_s": True},
            {"flags": "ok"},
            {"flags": [{}]},
            {"shot": 7},
            {"rig_health": [9.0]},
            {"rig_health": {"left": math.nan}},
            {"pose": []},
            {"pose": {}},
            {"pose": {"grasp_m": [1, 2], "normal": None}},
            {"pose": {"grasp_m": [1, 2, "3"], "normal": None}},
            {"pose": {"grasp_m": [1, 2, 3], "normal": [0, 0, math.nan]}},
            {"protection": {}},
            {"protection": pose_record()["protection"] | {"normal_rad": -1.0}},
            {"protection": pose_record()["protection"] | {"grasp_normal_m": "1"}},
            {"pose": pose_record()["pose"] | {"normal": [0, 0, 0]}},
            {"pose": pose_record()["pose"] | {"normal": [0, 0, -7]}},
            {"pose": pose_record()["pose"] | {"grasp_m": [100, 200, 500]}},
        )
    ),
]


def test_the_controller_reports_invalid_lines_and_continues():
    lines = [line.encode("utf-8", "surrogateescape") + b"\n" for line in BROKEN]

    with started("--period", "0.2", text=False) as process:
        out, stderr = process.communicate(b"".join(lines) + line_of(pose_record("last")).encode(), timeout=300)

    command, _ = map(json.loads, out.splitlines())
    messages = stderr.decode().splitlines()
    assert (process.returncode, command["shot"], command["do"]) == (0, "last", "move")
    assert len(messages) == len(BROKEN)
    for number, message in enumerate(messages, start=1):
        assert message.startswith(f"controller: line {number}: ")
    assert "frame, flags" in messages[BROKEN.index(WITHOUT_KEYS)]


def test_the_controller_ignores_a_shot_older_than_the_last_one():
    now_s = time.time()
    with started() as process:
        for number, age_s in enumerate((0.1, 0.3, 0.0)):
            process.stdin.write(line_of(pose_record(f"s{number}", stamp_s=now_s - age_s)))
            process.stdin.flush()
            stderr = process.stderr.readline() if number == 1 else process.stdout.readline()
            assert f"s{number}" in stderr
        process.stdin.close()
        rest = process.stdout.read()

    assert [json.loads(line)["why"] for line in rest.splitlines()] == ["the stream has ended"]


def test_a_stamp_from_the_future_does_not_outdate_later_shots():
    with started() as process:
        for number, ahead_s in enumerate((2000.0, 0.0)):
            process.stdin.write(line_of(pose_record(f"s{number}", stamp_s=time.time() + ahead_s)))
            process.stdin.flush()
            command = json.loads(process.stdout.readline())
        process.stdin.close()

    assert (command["shot"], command["do"]) == ("s1", "move")


def test_the_controller_replays_old_shots_in_input_order():
    lines = [line_of(pose_record(str(number), stamp_s=2000.0 - number)) for number in range(3)]

    with started("--replay") as process:
        commands = []
        for line in lines:
            process.stdin.write(line)
            process.stdin.flush()
            commands.append(json.loads(process.stdout.readline()))
        process.stdin.close()

    assert [(command["shot"], command["do"]) for command in commands] == [("0", "move"), ("1", "move"), ("2", "move")]


def test_the_controller_accepts_records_of_the_given_frame():
    commands, _ = controlled(line_of(pose_record(frame="tool")), "--frame", "tool")

    assert [(command["do"], command["frame"]) for command in commands] == [("move", "tool")]


def test_the_controller_uses_the_newest_line_and_counts_skipped_ones():
    commands, _ = controlled("".join(line_of(pose_record(str(number))) for number in range(100)), "--period", "0.5")

    assert commands[-1]["shot"] == "99"
    assert len(commands) + sum(command["skipped"] for command in commands) == 100


def test_the_controller_holds_without_a_pose():
    with started("--patience", "0.1") as process:
        first = json.loads(process.stdout.readline())
        process.stdin.close()

    assert first == {"do": "hold", "why": "no pose for 0.1 s"}


@pytest.mark.parametrize(("closed", "status"), [("<&-", 66), (">&-", 74)])
def test_the_controller_names_a_stream_that_is_closed(closed, status):
    words = ["sh", "-c", f'exec "$0" "$1" {closed}', sys.executable, EXAMPLES / "controller.py"]

    done = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=300)

    assert done.returncode == status
    assert done.stderr.count("\n") == 1
    assert "closed" in done.stderr


def test_the_controller_ends_silently_on_a_closed_pipe():
    with started() as process:
        process.stdout.close()
        process.stdin.write(line_of(pose_record()))
        process.stdin.flush()
        process.wait(300)
        stderr = process.stderr.read()

    assert (process.returncode, stderr) == (141, "")


def test_the_controller_ends_silently_on_sigint():
    with started("--patience", "0.05") as process:
        process.stdout.readline()
        process.send_signal(signal.SIGINT)
        process.wait(300)
        stderr = process.stderr.read()

    assert (process.returncode, stderr) == (130, "")


@pytest.mark.slow
def test_a_scanned_ring_is_one_cloud_in_the_base_and_lies_on_the_true_ring(tmp_path, monkeypatch):
    from ringpose.files.point_clouds import read_point_cloud

    monkeypatch.syspath_prepend(str(EXAMPLES))
    done = subprocess.run(
        [sys.executable, EXAMPLES / "scan_ring.py", tmp_path, "--views", "3"],
        env=ENVIRONMENT, capture_output=True, text=True, timeout=3000,
    )  # fmt: skip
    base_from_ring = runpy.run_path(str(EXAMPLES / "simulated_robot.py"))["BASE_FROM_TARGET"]["ring"]

    assert done.returncode == 0, done.stderr
    cloud = read_point_cloud(tmp_path / "cloud.ply", 100_000)
    on_ring_m = (cloud.position_m - base_from_ring[:3, 3]) @ base_from_ring[:3, :3]
    radius_m = np.hypot(on_ring_m[:, 0], on_ring_m[:, 1])
    on_face = (radius_m > 0.568) & (radius_m < 0.596) & (np.abs(on_ring_m[:, 2]) < 0.01)
    assert (cloud.frame, len(cloud.shots)) == ("base", 3)
    assert np.bincount(cloud.shot[on_face]).min() > 100
    assert np.std(on_ring_m[on_face, 2]) < 1e-3
    angle = np.arctan2(on_ring_m[on_face, 1], on_ring_m[on_face, 0])
    assert np.ptp(angle) > 4.0  # around the ring, not beside one place of it
    assert '"points_mm"' in (tmp_path / "scan.html").read_text()
