"""`ringpose pose --track`: shots in, track records out; the track chooses the lasers of a live camera."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from forked import Forked
from schemas import validated

from ringpose.cli.main import main

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
def served(tmp_path, monkeypatch, forker):
    """The URI of a moving target in simulated time, which waits for the client."""
    monkeypatch.chdir(tmp_path)
    Path("rig.yaml").write_text((EXAMPLES / "scene-rig.yaml").read_text())
    Path("scene.yaml").write_text(SCENE)
    words = ["simulate", "serve", "--images", "tcp://127.0.0.1:0", "scene.yaml", "--clock", "lockstep"]
    words += ["--rate", str(RATE_HZ), "--truth", "truth.jsonl"]
    job = {"before": "", "words": words, "folder": str(tmp_path), "environment": {**os.environ}}
    with Forked(forker, job) as process:
        yield json.loads(process.stdout.readline())["camera"]
        process.kill()


def lines(capsys) -> list[dict]:
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


@pytest.mark.slow
def test_a_live_track_switches_to_all_lasers_in_every_frame_and_follows_the_target(served, capsys):
    assert main(["pose", "--track", "--rig", "rig.yaml", "--camera", served, "--count", "16"]) == 0

    records = [validated(record) for record in lines(capsys)]
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
def test_recorded_shots_give_one_track_record_each_which_is_that_of_the_command_track(served, capsys):
    words = ["--camera", served, "--sequence", "all", "--count", "6"]
    assert main(["capture", *words, "--output", "session", "--quiet"]) == 0
    capsys.readouterr()
    assert main(["pose", "session", "--rig", "rig.yaml"]) == 0
    Path("poses.jsonl").write_text(capsys.readouterr().out)
    assert main(["track", "poses.jsonl", "--rig", "rig.yaml"]) == 0
    separate = lines(capsys)

    assert main(["pose", "session", "--rig", "rig.yaml", "--track"]) == 0

    together = lines(capsys)
    assert [record["shot"] for record in together] == [record["shot"] for record in separate]
    apart_m = np.subtract(together[-1]["grasp"]["point_m"], separate[-1]["grasp"]["point_m"])
    assert np.abs(apart_m).max() < 2e-4  # bands hold the same stripes; weak light behind them is not searched


@pytest.mark.parametrize(
    ("words", "key_word"),
    [
        (["--predict-for", "1"], "--track"),
        (["--track", "--method", "paper"], "--method"),
        (["--track", "--frame", "tool"], "--frame"),
        (["--track", "--max-speed", "0"], "--max-speed"),
        (["--track", "--lost-after", "1"], "--lost-after"),
        (["--track", "--gripper-tilt-deg", "1"], "--gripper-radial-m"),
        (["--method", "paper", "--max-rate", "3"], "--max-rate"),
        (["--method", "paper-constrained", "--ring-tolerance", "0.001"], "--ring-tolerance"),
    ],
    ids=lambda words: " ".join(words) if isinstance(words, list) else "",
)
def test_options_that_contradict_each_other_are_wrong_usage(rig, detections, capsys, words, key_word):
    assert main(["pose", str(detections), "--rig", str(rig), *words]) == 2

    streams = capsys.readouterr()
    assert streams.out == ""
    assert streams.err.count("\n") == 1
    assert key_word in streams.err
