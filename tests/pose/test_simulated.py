"""The covariance is true on simulated images, from the light in the scene to the pose."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ringpose.detect.pipeline import detect
from ringpose.files.scenes import read_scene
from ringpose.pose.pipeline import estimate_pose
from ringpose.simulate.pipeline import simulate
from ringpose.types.ring import KnownRadii
from ringpose.types.ring_pose import PoseFlag
from ringpose.types.scene import Approach

SCENE = Path(__file__).parents[2] / "examples" / "scene-full.yaml"
SHOTS = 24


@pytest.fixture(scope="module")
def detections():
    """What is found in shots of a ring at half a metre, and the truth."""
    scene = read_scene(SCENE)
    approach = Approach(count=SHOTS, distances_m=(0.5,), lights=("dim",), seed=11)
    scene = replace(scene, views=(), approaches=(approach,), sequence=(0, 1, 2, 4))
    return scene.rig, [(detect(shot, scene.rig), truth) for shot, truth in simulate(scene)]


def squares(pose, truth):
    """Squared errors of centre and normal in the told covariance, by degree of freedom."""
    center_m = pose.center_m - truth.center_m
    first = np.cross([0.0, 0.0, 1.0], pose.normal)
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(pose.normal, first)])
    tilt_rad = axes @ truth.normal / (pose.normal @ truth.normal)
    return (
        center_m @ np.linalg.solve(pose.covariance_center_m2, center_m) / 3.0,
        tilt_rad @ np.linalg.solve(pose.covariance[:2, :2], tilt_rad) / 2.0,
    )


@pytest.mark.slow
@pytest.mark.parametrize("known", [False, True], ids=["radius unknown", "radius known"])
def test_errors_on_simulated_images_are_those_that_are_told(detections, known):
    rig, found = detections
    told = []
    for detection, truth in found:
        radii = np.array([truth.radius_inner_m, truth.radius_outer_m])
        said = KnownRadii(radius_m=radii, sd_m=np.full(2, 1e-4)) if known else None
        pose = estimate_pose(detection.break_points, rig, known=said)
        if PoseFlag.CENTER_WEAK not in pose.flags:
            told.append(squares(pose, truth))

    assert len(told) > SHOTS / 2
    # 95 % of chi-squared over both quantities: 2.24 sigmas of each
    spread = np.sqrt(2.0 / (len(told) * np.array([3.0, 2.0])))
    assert np.abs((np.mean(told, axis=0) - 1.0) / spread).max() < 2.24
