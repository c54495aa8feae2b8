"""What a calibration with boards 0.41 to 0.55 m away is worth for poses at 1 m."""

import json
from dataclasses import replace

import numpy as np
import pytest

from ringpose.calibrate.intrinsics import camera_with, parameters_of
from ringpose.detect.pipeline import detect
from ringpose.files.rigs import read_rig
from ringpose.files.shots import read_shot
from ringpose.geometry.rotations import tilted
from ringpose.pose.pipeline import estimate_pose

CAMERA_PARAMETERS = 9
DRAWS = 80


@pytest.fixture(scope="module")
def excess_mm(shared_data, rig_of_rendered_boards) -> tuple[float, np.ndarray]:
    """RMSE of z at 1 m less that with the true rig: by the estimated rig, and by rigs as wrong as it says it is."""
    shots = shared_data / "rendered" / "rig_b"
    estimated, true = read_rig(rig_of_rendered_boards), read_rig(shots / "rig.yaml")
    truths = [json.loads(line) for line in (shots / "truth.jsonl").read_text().splitlines()]
    far = {truth["shot"]: truth["center_m"][2] for truth in truths if truth["groups"]["distance_m"] == 1.0}
    seen = {name: detect(read_shot(shots / "shots" / f"{name}.npz"), true) for name in far}

    def rmse_mm(rig) -> float:
        poses = {name: estimate_pose(one.break_points, rig, ring_edges=one.ring_edges) for name, one in seen.items()}
        return 1e3 * float(np.sqrt(np.mean([(poses[name].center_m[2] - z) ** 2 for name, z in far.items()])))

    with_true = rmse_mm(true)
    rng = np.random.default_rng(1)
    covariance = estimated.covariance
    wrong = rng.multivariate_normal(np.zeros(len(covariance.data)), covariance.data, DRAWS, method="eigh")
    drawn = np.array([rmse_mm(moved(true, step, covariance)) for step in wrong])
    return rmse_mm(estimated) - with_true, drawn - with_true


def moved(rig, step, covariance):
    camera = camera_with(parameters_of(rig.camera) + step[:CAMERA_PARAMETERS], rig.camera)
    of_plane = step[CAMERA_PARAMETERS:].reshape(-1, 3)
    normals = [tilted(normal, own[:2]) for normal, own in zip(rig.lasers.normal, of_plane, strict=True)]
    lasers = replace(rig.lasers, normal=np.stack(normals), distance_m=rig.lasers.distance_m + of_plane[:, 2])
    return replace(rig, camera=camera, lasers=lasers, covariance=covariance)


@pytest.mark.slow
def test_poses_beyond_the_boards_err_more_by_no_more_than_the_rig_says(excess_mm):
    estimated, drawn = excess_mm

    low, high = np.percentile(drawn, [2.5, 97.5])
    assert low < estimated < high


@pytest.mark.slow
def test_such_boards_hold_poses_at_one_metre_to_two_millimetres(excess_mm):
    """Speckle leaves 0.13 px in a stripe's centre: seen 0.41 to 0.55 m away and carried on to 1 m, millimetres."""
    _, drawn = excess_mm

    assert 1.0 < np.std(drawn) < 3.0
    assert np.mean(drawn > 0.5) > 0.2
