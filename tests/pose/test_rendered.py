"""The true break points of the rendered shots, which another program computed."""

import json
from pathlib import Path

import numpy as np
import pytest
from ring_scenes import break_points_of, make_scene

from ringpose.detect.pipeline import detect
from ringpose.files.images.shots import read_shot
from ringpose.files.rigs import read_rig
from ringpose.measure.stream import estimate_pose as most_likely_pose
from ringpose.pose.closed_form import FORMS
from ringpose.pose.closed_form import closed_form_pose as estimate_pose
from ringpose.types.options import Method
from ringpose.types.pose import NoPose

BOTH_METHODS = pytest.mark.parametrize("method", list(FORMS))
FOLDERS = pytest.mark.parametrize("folder", ["rig_a", "rig_b", "variants_a", "variants_b"])
ROUNDING_SIGMA_PX = 1e-4 / np.sqrt(12)


def pixels(record):
    points = record["break_points_px"]
    return np.array([[[np.nan, np.nan] if xy is None else xy for xy in laser] for laser in points])


@pytest.fixture
def truths(shared_data, folder):
    path = shared_data / "rendered" / folder / "truth.jsonl"
    return [json.loads(line) for line in path.read_text().splitlines()]


@pytest.fixture
def poses(shared_data, folder, truths, method):
    rig = read_rig(shared_data / "rendered" / folder / "rig.yaml")
    return [estimate_pose(break_points_of(pixels(truth), ROUNDING_SIGMA_PX), rig, method) for truth in truths]


@FOLDERS
@BOTH_METHODS
def test_six_or_five_true_break_points_always_give_a_pose(truths, poses):
    without = {t["shot"] for t, pose in zip(truths, poses, strict=True) if isinstance(pose, NoPose)}

    assert without == {t["shot"] for t in truths if t["groups"]["usable"] < 5}


@FOLDERS
@pytest.mark.parametrize("method", [Method.PAPER_CONSTRAINED])
def test_the_center_is_true_to_the_rounding_of_the_pixels(truths, poses):
    found = [(t, pose) for t, pose in zip(truths, poses, strict=True) if not isinstance(pose, NoPose)]

    errors = [np.array(t["center_m"]) - pose.center_m for t, pose in found]
    deviations = [
        np.sqrt(e @ np.linalg.solve(pose.covariance_center_m2, e)) for e, (_, pose) in zip(errors, found, strict=True)
    ]

    assert max(deviations) < 4.0


@FOLDERS
@BOTH_METHODS
def test_the_normal_is_true_to_the_rounding_of_the_pixels(truths, poses):
    deviations = [
        np.linalg.norm(np.cross(t["normal"], pose.normal)) / np.sqrt(np.linalg.eigvalsh(pose.covariance[:2, :2])[-1])
        for t, pose in zip(truths, poses, strict=True)
        if not isinstance(pose, NoPose)
    ]

    assert max(deviations) < 4.0


@FOLDERS
@BOTH_METHODS
def test_the_pose_predicts_the_break_points_to_their_rounding(poses):
    residuals_px = [pose.residual_rms_px for pose in poses if not isinstance(pose, NoPose)]

    assert max(residuals_px) < 1e-4


@pytest.mark.parametrize("folder", ["rig_b"])
def test_what_one_or_two_stripes_and_the_edges_say_of_the_normal_is_true(shared_data, folder, truths):
    place = shared_data / "rendered" / folder
    rig, sigmas = read_rig(place / "rig.yaml"), {}
    for truth in truths:
        if truth["expect"] == "partial":
            found = detect(read_shot(place / "shots" / f"{truth['shot']}.npz", rig=rig), rig)
            pose = most_likely_pose(found.break_points, rig, ring_edges=found.ring_edges)
            if not isinstance(pose, NoPose) and np.isfinite(pose.normal).all():
                apart = np.linalg.norm(np.cross(pose.normal, truth["normal"]))
                sigmas[truth["shot"]] = apart / np.sqrt(np.trace(pose.covariance[:2, :2]))

    assert len(sigmas) >= 4
    assert max(sigmas.values()) < 4.0


CARRIED = [json.loads(line) for line in (Path(__file__).parent / "true_break_points.jsonl").read_text().splitlines()]
"""Some of the same lines, for where the rendered shots are not at hand."""


@pytest.mark.parametrize("truth", CARRIED, ids=[truth["shot"] for truth in CARRIED])
def test_the_center_of_carried_truth_is_true_to_the_rounding_of_the_pixels(truth):
    rig = make_scene(truth["groups"]["rig"]).rig

    pose = estimate_pose(break_points_of(pixels(truth), ROUNDING_SIGMA_PX), rig)

    error = np.array(truth["center_m"]) - pose.center_m
    assert np.sqrt(error @ np.linalg.solve(pose.covariance_center_m2, error)) < 4.0
