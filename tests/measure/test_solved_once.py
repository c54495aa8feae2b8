"""A shot without contradictions is solved once: the pose goes on from the ring that the detection has judged."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ringpose.detect.pipeline import detect
from ringpose.estimate import explanation, linearization, ring_estimate, solver, stripe_evidence
from ringpose.files.images.shots import read_shot
from ringpose.files.rigs import read_rig
from ringpose.measure.stream import pose_line
from ringpose.types.assumptions import USUAL

RIG_B = Path(__file__).parents[1] / "data" / "rig_b"


@pytest.fixture
def solved(monkeypatch) -> dict[str, int]:
    """How many iterations started, how many of these from a known ring, and how often a ring was linearised."""
    counts = {"gauss_newton": 0, "linearized_at": 0, "ring_residuals": 0}

    def count(name: str) -> None:
        function = getattr(linearization if name == "ring_residuals" else solver, name)

        def counted(*arguments, **options):
            counts[name] += 1
            return function(*arguments, **options)

        for module in (linearization, solver, ring_estimate, stripe_evidence, explanation):
            if hasattr(module, name):
                monkeypatch.setattr(module, name, counted)

    for name in counts:
        count(name)
    return counts


@pytest.mark.parametrize(("light", "of_pose"), [("dim", 2), ("normal", 3)])
def test_a_clear_shot_is_solved_once_and_its_pose_takes_two_iterations_from_there(solved, light, of_pose):
    rig = read_rig(RIG_B / "rig.yaml")
    detection = detect(read_shot(RIG_B / "shots" / f"B_z0500_p01_{light}.npz"), rig)
    of_detection = dict(solved)

    line = pose_line(detection, rig, options=USUAL)

    assert line.pose is not None
    assert of_detection["gauss_newton"] - of_detection["linearized_at"] == 1
    assert solved["gauss_newton"] - solved["linearized_at"] == 1  # none of the pose
    # the judged ring itself is linearised with the assumptions and edges of the pose; two iterations follow at most
    assert solved["ring_residuals"] - of_detection["ring_residuals"] == of_pose


def test_without_the_judged_ring_the_pose_is_the_same_but_solved_again(solved):
    rig = read_rig(RIG_B / "rig.yaml")
    detection = detect(read_shot(RIG_B / "shots" / "B_z0500_p01_normal.npz"), rig)
    judged = pose_line(detection, rig, options=USUAL)
    before = solved["gauss_newton"] - solved["linearized_at"]

    again = pose_line(replace(detection, ring=None), rig, options=USUAL)

    assert solved["gauss_newton"] - solved["linearized_at"] == before + 1
    sd_m = np.sqrt(np.diag(judged.pose.covariance_center_m2))
    assert (np.abs(again.pose.center_m - judged.pose.center_m) < 1e-3 * sd_m).all()
