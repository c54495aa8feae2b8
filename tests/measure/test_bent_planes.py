"""A shot taken with light planes that are bent, by rigs that state it and by one that does not."""

from dataclasses import replace

import numpy as np
import pytest
from ring_scenes import Ring, nees

from ringpose.files.scenes.scene import read_scene
from ringpose.files.studies.specification import PRESETS
from ringpose.measure.stream import Setup
from ringpose.simulate.pipeline import simulated_shot
from ringpose.types.rig import LaserBow
from ringpose.types.scene import RingView

BOW_PER_RAD = 0.0114
"""A millimetre at 0.5 m, 24 degrees beside the middle."""


@pytest.fixture(scope="module")
def bent_shot():
    """The rig with its bows, a shot of a ring 0.4 m away in the dark, and the ring."""
    scene = read_scene(PRESETS / "paper-physical-scene.yaml")
    ring = Ring(
        center_m=np.array([0.66, 0.02, 0.42]), normal=np.array([0.0, 0.05, -1.0]), radius_m=np.array([0.567, 0.597])
    )
    ring = replace(ring, normal=ring.normal / np.linalg.norm(ring.normal))
    view = RingView(name="view", center_m=ring.center_m, normal=ring.normal, light="dim")
    scene = replace(
        scene,
        lasers=replace(scene.lasers, bow_per_rad=BOW_PER_RAD),
        sequence=(0, 1, 2, 4),
        views=(view,),
        approaches=(),
        plane_boards=None,
        camera_boards=None,
    )
    bows = {name: LaserBow(per_rad=BOW_PER_RAD, sd_per_rad=1e-4) for name in scene.rig.lasers.names}
    return replace(scene.rig, bows=bows), simulated_shot(scene, scene.views, 0)[0], ring


def test_a_shot_with_bent_planes_is_measured_by_a_rig_that_states_them(bent_shot):
    rig, shot, ring = bent_shot

    line = Setup(rig=rig).measure(shot)

    assert line.status == "ok"
    assert max(nees(line.pose, ring).values()) < 5.0
    assert line.priors.rig.bent == rig.bows


@pytest.mark.parametrize("flat", ["left", "middle", "right"])
def test_a_bent_plane_that_counts_as_flat_contradicts_the_others(bent_shot, flat):
    rig, shot, _ = bent_shot

    line = Setup(rig=replace(rig, bows={name: bow for name, bow in rig.bows.items() if name != flat})).measure(shot)

    assert line.status != "ok"
    assert line.pose is None or [each.laser for each in line.rejected] == [flat]
