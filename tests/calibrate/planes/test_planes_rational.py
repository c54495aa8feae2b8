"""Boards and light planes with a camera of eight distortion coefficients."""

from dataclasses import replace

import numpy as np
import pytest
from calibrated import chi_squared
from known_views import plane_errors, stripe_views, true_poses
from ring_scenes import make_camera

from ringpose.calibrate.camera.parameters import camera_with, parameters_of
from ringpose.calibrate.planes.pipeline import PlanesModel, calibrate_planes
from ringpose.calibrate.planes.quality import calibrated_rig
from ringpose.files.rigs import read_rig, write_rig
from ringpose.types.rig import Camera, ParameterCovariance

MODEL = PlanesModel(names=("left", "middle", "right"))
DISTORTION = (0.21, -0.06, 0.0005, -0.0004, 0.004, 0.47, -0.09, 0.01)
CAMERA = make_camera((1600, 1200), (1181.3, 1180.6), (803.7, 596.2), DISTORTION)
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
PRIOR = ParameterCovariance(
    parameters=NAMES,
    data=np.diag(np.array([0.3, 0.3, 0.4, 0.4, 1e-3, 2e-3, 5e-5, 5e-5, 1e-3, 1e-3, 2e-3, 1e-3]) ** 2),
)
CORNER_PX, CENTER_PX = 0.02, 0.1


@pytest.fixture
def drawn_views(rng):
    """Makes views of boards that the three light planes cross, with noise."""
    return lambda number: stripe_views(true_poses(rng, number), rng, CORNER_PX, CENTER_PX, CAMERA)


def given(rng) -> Camera:
    """A camera with errors drawn from its covariance."""
    wrong = rng.multivariate_normal(np.zeros(len(NAMES)), PRIOR.data)
    return replace(camera_with(parameters_of(CAMERA) + wrong, CAMERA), covariance=PRIOR)


def errors(found) -> np.ndarray:
    """Camera's parameters and planes' tilts and distances less the true ones."""
    return np.append(parameters_of(found.camera) - parameters_of(CAMERA), -plane_errors(found))


@pytest.mark.parametrize("free_camera", [False, True])
def test_rig_of_a_rational_camera_comes_back_from_its_file_with_all_its_parameters(
    free_camera, rng, drawn_views, tmp_path
):
    found = calibrate_planes(drawn_views(5), given(rng), replace(MODEL, free_camera=free_camera))

    write_rig(tmp_path / "rig.yaml", calibrated_rig(found))
    rig = read_rig(tmp_path / "rig.yaml")

    assert rig.covariance.parameters[:12] == NAMES
    assert rig.covariance.parameters[12:] == tuple(
        f"{laser}.{what}" for laser in MODEL.names for what in ("tilt_1", "tilt_2", "distance")
    )
    np.testing.assert_allclose(rig.covariance.data, found.covariance.data, rtol=1e-12)
    np.testing.assert_array_equal(rig.camera.distortion_coefficients, found.camera.distortion_coefficients)


@pytest.mark.slow
@pytest.mark.parametrize("free_camera", [False, True])
def test_errors_with_a_rational_camera_are_as_large_as_reported(free_camera, rng, drawn_views):
    """The variances of a free camera may be up to a quarter too large: errors common to all views are never zero."""
    runs = 15
    normalised = []
    for _ in range(runs):
        found = calibrate_planes(drawn_views(6), given(rng), replace(MODEL, free_camera=free_camera))
        error = errors(found)
        normalised.append(error @ np.linalg.solve(found.covariance.data, error))

    low, high = chi_squared([0.025, 0.975], 21 * runs)
    assert 0.75 * low < np.sum(normalised) < high
