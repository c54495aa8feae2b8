"""The covariance is consistent on drawn images with speckle, where the detector gives the covariance."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_scene import RADII_M, DrawnScene, draw_shot, drawn_rig
from ring_scenes import Ring, nees

from ringpose.detect.pipeline import detect
from ringpose.estimate.factors.edges import integrated_autocorrelation_time
from ringpose.measure.stream import estimate_pose
from ringpose.types.pose import KnownRadii

KNOWN = KnownRadii(radius_m=np.array(RADII_M), sd_m=np.array([1e-4, 1e-4]))
SHOTS = 40
BANDS = {0.1: ((0.5, 1.47), (0.5, 1.6)), 0.25: ((0.5, 1.47), (0.5, 1.6)), 0.0: ((0.0, 1.47), (0.0, 1.6))}
"""Of chi-squared with 120 and 80 degrees of freedom, divided by these, 99.9 %; without speckle, as no laser is, the
detector's floors make the errors smaller than told. So does speckle a little: its grains are drawn three pixels wide,
behind the lens, while the detector takes them for finer than the blur, as a laser's are."""


@pytest.mark.slow
@pytest.mark.parametrize("known", [None, KNOWN], ids=["radius unknown", "radius known"])
@pytest.mark.parametrize("speckle", sorted(BANDS))
def test_errors_on_drawn_images_are_those_that_are_told(rng, known, speckle):
    rig, all_squares = drawn_rig(), []
    for _ in range(SHOTS):
        x, y, z = rng.uniform([0.53, -0.03, 0.4], [0.6, 0.05, 0.6]).tolist()
        tilt = rng.uniform(-0.15, 0.15, 2).tolist()
        scene = DrawnScene(center_m=(x, y, z), normal=(*tilt, -1.0), speckle=speckle)
        shot = draw_shot(scene, rig, [0, 1, 2, 4], rng)
        given = known and replace(known, radius_m=known.radius_m + known.sd_m * rng.normal(size=2))
        normal = np.array(scene.normal) / np.linalg.norm(scene.normal)
        ring = Ring(center_m=np.array(scene.center_m), normal=normal, radius_m=np.array(RADII_M))
        of = nees(estimate_pose(detect(shot, rig).break_points, rig, known=given), ring)
        all_squares.append((of["center"], of["normal"]))

    for mean, (least, most) in zip(np.mean(all_squares, axis=0), BANDS[speckle], strict=True):
        assert least < mean < most


def test_independent_residuals_are_as_many_as_they_are(rng):
    assert np.median([integrated_autocorrelation_time(rng.normal(size=200)) for _ in range(50)]) < 2.5


@pytest.mark.parametrize("alike", [4, 10])
def test_residuals_that_err_alike_count_once(rng, alike):
    series = [np.repeat(rng.normal(size=400 // alike), alike) for _ in range(50)]

    assert alike < np.median([integrated_autocorrelation_time(each) for each in series]) < 3 * alike
