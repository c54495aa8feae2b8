"""A rig that is calibrated from simulated board views is the true one within its covariance."""

from pathlib import Path

import numpy as np
import pytest

from ringpose.bench.study.pipeline import calibrated_rig
from ringpose.files.scenes.scene import read_scene

EXAMPLE = Path(__file__).parents[3] / "examples" / "scene.yaml"


@pytest.mark.slow
def test_the_calibrated_planes_are_the_true_ones_within_their_errors():
    scene = read_scene(EXAMPLE)

    rig = calibrated_rig(scene)

    sigma = rig.covariance.standard_deviations
    for laser, name in enumerate(rig.lasers.names):
        off_m = rig.lasers.distance_m[laser] - scene.rig.lasers.distance_m[laser]
        turned_rad = np.arccos(min(1.0, rig.lasers.normal[laser] @ scene.rig.lasers.normal[laser]))
        assert abs(off_m) < 5 * sigma[f"{name}.distance"]
        assert turned_rad < 5 * np.hypot(sigma[f"{name}.tilt_1"], sigma[f"{name}.tilt_2"])
    assert np.isfinite(rig.lasers.projector_m).all()
