"""Simulated shots against shots of the same scenes by another renderer (the shared data)."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_scene import line_of

from ringpose.files.images.shots import read_shot
from ringpose.files.records.truths import read_truths
from ringpose.files.rigs import read_rig
from ringpose.geometry.rays import project
from ringpose.simulate.pipeline import simulate
from ringpose.types.scene import LaserLight, Optics, RingView, Sensor, Speckle
from ringpose.types.target import Body, Foil, RingShape

SHOTS = ["B_z0300_p00_dim", "B_z0500_p00_dim", "B_z1000_p00_dim"]


@pytest.fixture
def pair_of(scene, shared_data):
    """Returns a rendered shot, the simulated shot of the same scene, the truth and the rig."""

    def pair(name):
        folder = shared_data / "rendered" / "rig_b"
        truth = next(truth for truth in read_truths(folder / "truth.jsonl") if truth.shot == name)
        inner, outer = truth.radius_inner_m, truth.radius_outer_m
        same = replace(
            scene,
            rig=read_rig(folder / "rig.yaml"),
            ring=RingShape(profile_m=np.array([[inner, 0], [inner, 0.06], [outer, 0.06], [outer, 0]])),
            body=Body(size_m=np.array([2.2, 2.2, 1.0]), foil=Foil()),
            sensor=Sensor(),
            lens=Optics(),
            lasers=LaserLight(),
            speckle=Speckle(),
            stripe_dn=150.0,
            views=(RingView(name=name, center_m=truth.center_m, normal=truth.normal),),
        )
        ((simulated, _),) = simulate(same)
        return read_shot(folder / "shots" / f"{name}.npz"), simulated, truth, same.rig

    return pair


def errors_px(shot, truth, rig):
    """Distance of the column centroids on the face, in the frames of single lasers, from the analytic stripe."""
    return np.concatenate([errors_of_laser(shot, truth, rig, laser) for laser in range(3)])


def errors_of_laser(shot, truth, rig, laser):
    start, along = line_of(rig, laser, truth.normal, float(truth.normal @ truth.center_m))
    line = project(start + np.linspace(-1.0, 1.0, 20001)[:, None] * along, rig.camera)
    first, last = np.sort(truth.break_points_px[laser, :, 0])
    near = line[(line[:, 0] > first - 5) & (line[:, 0] < last + 5)]
    near = near[np.argsort(near[:, 0])]
    columns = np.arange(int(first) + 6, int(last) - 5)
    rows = np.interp(columns, near[:, 0], near[:, 1])
    window = np.rint(rows).astype(int) + np.arange(-8, 9)[:, None]
    light = shot.images[1 + laser][window, columns].astype(float) - shot.images[0].mean()
    return (light * window).sum(axis=0) / light.sum(axis=0) - rows


@pytest.mark.parametrize("name", [SHOTS[0], *(pytest.param(name, marks=pytest.mark.slow) for name in SHOTS[1:])])
def test_stripes_have_the_same_position_and_scatter_as_in_an_external_render(pair_of, name):
    rendered, simulated, truth, rig = pair_of(name)

    theirs_px, ours_px = (errors_px(shot, truth, rig) for shot in (rendered, simulated))

    assert max(abs(theirs_px.mean()), abs(ours_px.mean())) < 0.03
    assert ours_px.std() == pytest.approx(theirs_px.std(), rel=0.3)  # due to speckle and noise
