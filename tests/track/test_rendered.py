"""Rendered sequences of a precessing target, computed by another program, through `pose` and `track`."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from ringpose.cli.main import main


def shown(capsys, *arguments) -> tuple[int, list[dict]]:
    status = main([str(argument) for argument in arguments])
    return status, [json.loads(line) for line in capsys.readouterr().out.splitlines()]


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 1])
def test_a_precessing_ring_is_tracked_through_a_rendered_sequence(capsys, shared_data, tmp_path: Path, number):
    folder = shared_data / "rendered" / "moving_b"
    truths = {truth["shot"]: truth for truth in map(json.loads, (folder / "truth.jsonl").read_text().splitlines())}
    shots = sorted((folder / "shots").glob(f"seq_{number}_*.npz"))
    main(["pose", *map(str, shots), "--rig", str(folder / "rig.yaml")])
    poses = tmp_path / "poses.jsonl"
    poses.write_text(capsys.readouterr().out)

    status, records = shown(capsys, "track", poses, "--rig", folder / "rig.yaml")

    assert status == 0
    assert [record["fusion_status"] for record in records] == ["fused"] * len(shots)
    nees = []
    for record in records[4:]:
        truth = truths[record["shot"]]
        time_s = record["stamp_s"] - truth["stamp_s"]
        center_m = np.array(truth["center_m"]) + np.array(truth["velocity_m_s"]) * time_s
        normal = cv2.Rodrigues(np.array(truth["angular_velocity_rad_s"]) * time_s)[0] @ truth["normal"]
        error_m = np.array(record["pose"]["center_m"]) - center_m
        nees.append(error_m @ np.linalg.solve(record["pose"]["covariance"]["center"], error_m) / 3)
        assert np.linalg.norm(error_m) < 0.006
        assert np.degrees(np.linalg.norm(np.array(record["pose"]["normal"]) - normal)) < 0.5
        away = np.array(record["grasp"]["point_m"]) - center_m
        radius_m = np.linalg.norm(away - (away @ normal) * normal)
        assert abs(radius_m - 0.582) < 0.0003
    assert np.mean(nees) < 3.0
    assert np.max(nees) < 25.0 / 3.0
