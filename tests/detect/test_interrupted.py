"""Rendered rings with bolts, a gap, or a cable over one stripe: two stripes that nothing interrupts are a pose.

Of a face of which a part is raised under two stripes, the third stripe shows the whole band.
"""

from dataclasses import replace

import numpy as np
import pytest

from ringpose.files.images.shots import read_shot
from ringpose.files.records.truths import read_truths
from ringpose.files.rigs import read_rig
from ringpose.geometry.rays import intersect, undistorted_rays
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


def raised(shot, rig, truth, lasers, edge, height_m):
    """The shot with the third of the band at an edge raised under stripes, in the frames that show them."""
    images = shot.images.copy()
    for laser in lasers:
        near, far = truth.break_points_px[laser, [edge, 1 - edge]]
        rows = np.linspace(-40.0, 40.0, 801)
        pixels = np.stack([np.full_like(rows, near[0]), near[1] + rows], axis=-1)
        light = rig.lasers.normal[[laser] * len(rows)], rig.lasers.distance_m[[laser] * len(rows)]
        heights_m = (intersect(undistorted_rays(pixels, rig.camera), *light) - truth.center_m) @ truth.normal
        step = round(rows[np.argmin(np.abs(heights_m - height_m))])
        (left, first), (right, last) = sorted([near.tolist(), far.tolist()])
        for column in range(*sorted((round(near[0]), round(near[0] + (far[0] - near[0]) / 3)))):
            row = round(np.interp(column, [left, right], [first, last]))
            stripe, moved = slice(row - 8, row + 9), slice(row - 8 + step, row + 9 + step)
            dark = shot.images[0, :, column].astype(np.int64)
            for frame in (number for number, mask in enumerate(shot.lasers.tolist()) if mask >> laser & 1):
                light_dn = images[frame, stripe, column] - dark[stripe]
                images[frame, stripe, column] = dark[stripe]
                images[frame, moved, column] = np.clip(dark[moved] + light_dn, 0, 255)
    return replace(shot, images=images)


@pytest.mark.parametrize("edge", [0, 1])
@pytest.mark.parametrize("frames", [[0, 1, 2, 3], [0, 4]])
@pytest.mark.parametrize(("lasers", "height_m"), [((0, 1), 0.02), ((1, 2), 0.02), ((0, 2), 0.01)])
def test_what_stands_on_a_third_of_the_band_under_two_stripes_is_not_the_face(
    shared_data, lasers, height_m, frames, edge
):
    folder, name = shared_data / "rendered" / "rig_b", "B_z0500_p00_dim"
    (truth,) = (each for each in read_truths(folder / "truth.jsonl") if each.shot == name)
    rig, shot = read_rig(folder / "rig.yaml"), read_shot(folder / "shots" / f"{name}.npz")
    some = replace(shot, **{key: getattr(shot, key)[frames] for key in ("images", "lasers", "stamp_s", "exposure_s")})

    line = Setup(rig=rig).measure(raised(some, rig, truth, lasers, edge, height_m))

    assert line.status == "degraded"
    assert {line.lasers[rig.lasers.names[laser]] for laser in lasers} == {LaserState.INTERRUPTED}
    assert all(f"the stripe of laser {rig.lasers.names[laser]} is interrupted" in line.reason for laser in lasers)
    off_m = line.pose.center_m - truth.center_m
    assert off_m @ np.linalg.solve(line.pose.covariance_center_m2, off_m) < 16.3  # one in a thousand
