"""The same shot from cameras of 8 and 12 bits, the latter at either end of 16, gives the same answer."""

import numpy as np
import pytest
from drawn_scene import DrawnScene, light, noise
from recorded_shots import make_shot

from ringpose.detect.pipeline import detect
from ringpose.types.detection import BreakPoints

BRIGHT = (150.0, 170.0, 140.0)
DIM = (14.0, 16.0, 15.0)
CAMERAS = {"right": (16, 4095, np.uint16, 1), "left": (16, 4095, np.uint16, 16)}
"""Steps of a twelve-bit camera in a grey value of an eight-bit one, its largest value, and where its bits lie."""


def shot_of(levels, steps, most, dtype, factor, meta):
    """The shot that a camera with so many steps a grey value takes."""
    images = (np.clip(np.rint(levels * steps), 0, most) * factor).astype(dtype)
    return make_shot(images, [0, 7], exposure_s=1e-3, meta=meta)


@pytest.fixture(scope="module", params=[BRIGHT, DIM], ids=["bright", "dim"])
def levels(request, rig):
    """Noisy frames with all lasers off and on, in fractions of grey values."""
    scene = DrawnScene(peaks_dn=request.param)
    lit = sum(light(scene, rig, laser) for laser in range(3)).astype(np.float32)
    return (
        np.stack([np.zeros_like(lit), lit])
        + 4
        + 0.8 * noise((2 * len(lit), lit.shape[1]), np.random.default_rng(5)).reshape(2, *lit.shape)
    )


@pytest.mark.parametrize("told", [True, False], ids=["told", "not told"])
@pytest.mark.parametrize("camera", CAMERAS)
def test_break_points_of_twelve_bits_are_those_of_eight(camera, told, levels, rig):
    steps, most, dtype, factor = CAMERAS[camera]
    meta = {"saturation_dn": most * factor} if told else {}

    eight = detect(shot_of(levels, 1, 255, np.uint8, 1, {}), rig, edges=False).break_points
    twelve = detect(shot_of(levels, steps, most, dtype, factor, meta), rig, edges=False).break_points

    assert isinstance(eight, BreakPoints)
    assert isinstance(twelve, BreakPoints)
    assert eight.seen.all()
    assert twelve.seen.all()
    sigma_px = np.sqrt(eight.covariance_px2[..., [0, 1], [0, 1]])
    assert np.all(np.abs(twelve.position_px - eight.position_px) < 1.5 * sigma_px)
    np.testing.assert_array_equal(twelve.flags, eight.flags)
