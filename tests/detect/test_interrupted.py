"""Rendered rings with bolts, a gap, or a cable over one stripe: two stripes that nothing interrupts are a pose."""

from dataclasses import replace

import numpy as np
import pytest

from ringpose.files.images.shots import read_shot
from ringpose.files.records.truths import read_truths
from ringpose.files.rigs import read_rig
from ringpose.measure.stream import Setup
from ringpose.types.pose import LaserState


@pytest.mark.parametrize(("kind", "laser"), [("gap", "right"), ("cable", "middle")])
def test_two_whole_stripes_are_a_pose_that_names_the_third(shared_data, kind, laser):
    folder, name = shared_data / "rendered" / "surfaces_b", f"W_{kind}_B500_dim_sw"
    (truth,) = (each for each in read_truths(folder / "truth.jsonl") if each.shot == name)
    setup = Setup(rig=read_rig(folder / "rig.yaml"))

    line = setup.line(setup.detection(read_shot(folder / "shots" / f"{name}.npz")))

    assert line.status == "degraded"
    assert f"the stripe of laser {laser}" in line.reason
    off_m = (line.pose.grasp_m - truth.center_m) @ truth.normal
    assert abs(off_m) < 1e-3


def test_bolts_on_all_stripes_interrupt_them(shared_data):
    folder, name = shared_data / "rendered" / "surfaces_b", "W_bolts_B500_dim_sw"
    (truth,) = (each for each in read_truths(folder / "truth.jsonl") if each.shot == name)
    setup = Setup(rig=read_rig(folder / "rig.yaml"))

    line = setup.line(setup.detection(read_shot(folder / "shots" / f"{name}.npz")))

    assert line.status == "ok"
    assert set(line.lasers.values()) == {LaserState.INTERRUPTED}
    off_m = line.pose.center_m - truth.center_m
    assert off_m @ np.linalg.solve(line.pose.covariance_center_m2, off_m) < 16.3  # one in a thousand


def test_a_groove_interrupts_the_stripe_that_crosses_it_and_no_other(shared_data):
    folder, name = shared_data / "rendered" / "surfaces_b", "W_groove_B500_dim_sw"
    setup = Setup(rig=read_rig(folder / "rig.yaml"))

    line = setup.line(setup.detection(read_shot(folder / "shots" / f"{name}.npz")))

    assert line.lasers == {"left": LaserState.USED, "middle": LaserState.INTERRUPTED, "right": LaserState.USED}


@pytest.mark.parametrize(("columns", "state"), [(5, LaserState.USED), (16, LaserState.INTERRUPTED)])
def test_a_dark_strip_across_the_face_is_named_if_it_is_as_long_as_a_stripe_must_be(shared_data, columns, state):
    folder, name = shared_data / "rendered" / "rig_b", "B_z0500_p00_dim"
    (truth,) = (each for each in read_truths(folder / "truth.jsonl") if each.shot == name)
    setup, shot = Setup(rig=read_rig(folder / "rig.yaml")), read_shot(folder / "shots" / f"{name}.npz")
    start, end = np.sort(truth.break_points_px[1, :, 0])
    first = round(start + 0.4 * (end - start))
    images = shot.images.copy()
    images[:, 200:500, first : first + columns] = images[0, 200:500, first : first + columns]

    line = setup.line(setup.detection(replace(shot, images=images)))

    assert line.lasers == {"left": LaserState.USED, "middle": state, "right": LaserState.USED}
    off_m = line.pose.center_m - truth.center_m
    assert off_m @ np.linalg.solve(line.pose.covariance_center_m2, off_m) < 16.3
