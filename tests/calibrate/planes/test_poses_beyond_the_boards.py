"""Accuracy of poses at 1 m after a calibration with boards at 0.41 to 0.55 m."""

import json
from dataclasses import replace

import numpy as np
import pytest

from ringpose.calibrate.camera.parameters import camera_with, parameters_of
from ringpose.detect.pipeline import detect
from ringpose.files.images.shots import read_shot
from ringpose.files.rigs import read_rig
from ringpose.geometry.rotations import tilted
from ringpose.pose.pipeline import estimate_pose

CAMERA_PARAMETERS = 9
DRAWS = 80


def moved(rig, step, covariance):
    camera = camera_with(parameters_of(rig.camera) + step[:CAMERA_PARAMETERS], rig.camera)
    of_plane = step[CAMERA_PARAMETERS:].reshape(-1, 3)
    normals = [tilted(normal, own[:2]) for normal, own in zip(rig.lasers.normal, of_plane, strict=True)]
    lasers = replace(rig.lasers, normal=np.stack(normals), distance_m=rig.lasers.distance_m + of_plane[:, 2])
    return replace(rig, camera=camera, lasers=lasers, covariance=covariance)


@pytest.mark.slow
def test_poses_beyond_the_boards_have_the_uncertainty_that_the_rig_reports(shared_data, rig_of_rendered_boards, rng):
    """The RMSE of z over the rendered shots at 1 m is within that of rigs drawn from the estimated rig's covariance."""
    shots = shared_data / "rendered" / "rig_b"
    true, estimated = read_rig(shots / "rig.yaml"), read_rig(rig_of_rendered_boards)
    truths = [json.loads(line) for line in (shots / "truth.jsonl").read_text().splitlines()]
    far = {truth["shot"]: truth["center_m"][2] for truth in truths if truth["groups"]["distance_m"] == 1.0}
    seen = {name: detect(read_shot(shots / "shots" / f"{name}.npz"), true) for name in far}

    def rmse_mm(rig) -> float:
        poses = {name: estimate_pose(one.break_points, rig, ring_edges=one.ring_edges) for name, one in seen.items()}
        return 1e3 * float(np.sqrt(np.mean([(poses[name].center_m[2] - z) ** 2 for name, z in far.items()])))

    covariance = estimated.covariance
    steps = rng.multivariate_normal(np.zeros(len(covariance.data)), covariance.data, DRAWS, method="eigh")
    drawn = [rmse_mm(moved(true, step, covariance)) for step in steps]

    low, high = np.percentile(drawn, [2.5, 97.5])
    assert low < rmse_mm(estimated) < high
