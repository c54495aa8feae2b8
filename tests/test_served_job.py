"""Calibration and poses with a virtual camera, compared with those of simulated shots in one process."""

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from ringpose.cli.main import main
from ringpose.estimate.pose_errors import circle_error
from ringpose.files.records.truths import read_truths
from ringpose.geometry.rotations import angle_between

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("_aravis")]

COMMAND = "import sys; from ringpose.cli.main import run; run()"

EXPOSURE_S = "0.0008"

SEQUENCE = "off,1,2,3,off"

BOARD_VIEWS = 8


@pytest.fixture
def serve(tmp_path, monkeypatch, example_folder, loopback_address):
    """Starts `ringpose simulate serve`; the scene has fewer board views than the example, and only lasers as light."""
    monkeypatch.chdir(tmp_path)
    scene = (example_folder / "scene.yaml").read_text()
    scene = re.sub(r"count: 1[02], distances_m", f"count: {BOARD_VIEWS}, distances_m", scene)
    scene = re.sub(r"count: 2, lights: .*?\]", "count: 3, lights: [dim]", scene)
    Path("scene.yaml").write_text(re.sub(r".*lights: \[strong\].*\n", "", scene))
    running = []

    def started(*options: str) -> list[str]:
        while running:
            end(running.pop())
        command = [sys.executable, "-c", COMMAND, "simulate", "serve", "--scene", "scene.yaml", "--force"]
        words = [*command, "--camera", loopback_address, "--log", "log.jsonl", *options]
        running.append(subprocess.Popen(words, stdout=subprocess.PIPE, text=True))
        uris = json.loads(running[-1].stdout.readline())
        return ["--camera", uris["camera"], "--lasers", uris["lasers"]]

    yield started
    for process in running:
        end(process)


def end(process: subprocess.Popen) -> None:
    process.send_signal(signal.SIGTERM)
    assert process.wait(300) == 143
    process.stdout.close()


def calibrated(views: Path, name: str) -> str:
    """A rig from views of both boards."""
    boards = Path("simulated/calibration")
    camera, rig = f"{name}_camera.yaml", f"{name}_rig.yaml"
    words = ["calibrate-camera", str(views / "camera"), "--board", str(boards / "camera_board.yaml")]
    assert main([*words, "--output", camera, "--quiet"]) == 0
    words = ["calibrate-planes", str(views / "planes"), "--board", str(boards / "plane_board.yaml")]
    assert main([*words, "--camera", camera, "--output", rig, "--quiet"]) == 0
    return rig


def errors_by_view(lines: list[dict], views: list[str | None]) -> dict[str, np.ndarray]:
    """Grasp error (m) and error of the normal (standard deviations) of each view, the mean over its lines with both."""
    truths = {truth.shot: truth for truth in read_truths(Path("simulated/truth.jsonl"))}
    errors: dict[str, list[tuple[float, float]]] = {}
    for line, view in zip(lines, views, strict=True):
        truth = truths.get(view or "")
        if truth is None or line["pose"] is None or "normal_weak" in line["flags"] or truth.expect != "pose":
            continue
        middle_m = (truth.radius_inner_m + truth.radius_outer_m) / 2
        grasp_m, normal = np.array(line["pose"]["grasp_m"]), np.array(line["pose"]["normal"])
        off_m = np.hypot(*circle_error(grasp_m, truth.center_m, truth.normal, middle_m)[1])
        tilt_sd_rad = np.sqrt(np.trace(np.array(line["pose"]["covariance"]["full"])[:2, :2]))
        errors.setdefault(truth.shot, []).append((off_m, angle_between(normal, truth.normal) / tilt_sd_rad))
    return {view: np.mean(found, axis=0) for view, found in errors.items()}


def lines_of(*words: str) -> list[dict]:
    """Pose lines of a command in its own process, where array shapes are not checked, which takes time."""
    done = subprocess.run([sys.executable, "-c", COMMAND, "pose", *words], stdout=subprocess.PIPE, text=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


def views_of(lines: list[dict]) -> list[str | None]:
    """The view of each live line, by the log of the virtual camera; None if the view changed within its shot."""
    records = [json.loads(line) for line in Path("log.jsonl").read_text().splitlines()]
    clock_s = time.time() - time.monotonic()
    mid_s = np.array([clock_s + record["began_s"] + record["exposure_s"] / 2 for record in records])
    views = []
    for line in lines:
        second = int(np.argmin(np.abs(mid_s - line["stamp_s"])))
        of_shot = {record["view"] for record in records[second - 1 : second + 4]}
        views.append(of_shot.pop() if len(of_shot) == 1 else None)
    return views


def test_a_rig_and_poses_over_the_network_are_as_good_as_in_one_process(serve):
    assert main(["simulate", "scene.yaml", "--output", "simulated", "--quiet"]) == 0
    near = calibrated(Path("simulated/calibration"), "near")

    for board, steps in (("camera", "off"), ("planes", "off,1,2,3,all")):
        devices = serve("--show", f"{board.removesuffix('s')}-board", "--after", "0.3")
        words = ["--sequence", steps, "--count", str(BOARD_VIEWS), "--rate", "0.25", "--output", f"views/{board}"]
        words += ["--allow-unseen"]  # a stripe may fall beside the board
        assert main(["capture", *devices, *words, "--quiet"]) == 0
    far = calibrated(Path("views"), "far")

    shots = ["--sequence", SEQUENCE, "--exposure", EXPOSURE_S]
    devices = serve("--move", "time", "--after", "1.5")
    live = lines_of("--rig", far, *devices, *shots, "--duration", "30", "--allow-unseen")
    assert main(["capture", "--camera", "sim:scene.yaml", *shots, "--output", "in_process", "--quiet"]) == 0
    local = lines_of("in_process", "--rig", near)

    there = errors_by_view(live, views_of(live))
    here = errors_by_view(local, [line["shot"] for line in local])
    common = sorted(there.keys() & here.keys())
    far_errors, near_errors = (np.array([errors[view] for view in common]) for errors in (there, here))
    assert len(common) >= 6
    assert np.median(far_errors[:, 0]) < 1.5 * np.median(near_errors[:, 0]) + 1e-4
    assert np.median(near_errors[:, 1]) < 1.3  # 0.8 are expected
    assert np.median(far_errors[:, 1]) < 1.3
    assert np.median([line["latency_s"] for line in live]) < 1.0
