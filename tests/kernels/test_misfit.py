"""Distances between seen and predicted break points where there are none, and covariances of points."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from ringpose.kernels import _forms, misfit
from ringpose.kernels.forms import constrained_form
from ringpose.pose.triangulation import point_jacobians
from ringpose.types.camera import Camera

COEFFICIENTS = {
    "plumb_bob": np.array([-0.1, 0.05, 1e-3, -2e-3, 0.01]),
    "rational_polynomial": np.array([0.3, -0.2, 1e-3, -2e-3, 0.01, 0.4, -0.1, 0.02]),
}
MODELS = pytest.mark.parametrize("model", COEFFICIENTS)
EDGES = np.array([0, 1, 0, 1, 0, 1])


def camera_of(model):
    matrix = np.array([[1400.0, 0.0, 650.0], [0.0, 1390.0, 480.0], [0.0, 0.0, 1.0]])
    return Camera(
        camera_name="test",
        image_width=1280,
        image_height=960,
        camera_matrix=matrix,
        distortion_model=model,
        distortion_coefficients=COEFFICIENTS[model],
    )


def noisy_sights(rng):
    """Break points of three upright light planes, seen some pixels from where a ring has them."""
    x = np.repeat([-0.1, 0.0, 0.1], 2)
    radius = 0.6 - 0.03 * (1 - EDGES)
    depth = 1.0 + 0.2 * x
    point = np.stack([x, 0.5 - np.sqrt(radius**2 - x**2), depth], axis=-1) + 1e-4 * rng.normal(size=(6, 3))
    light = np.stack([np.ones(6), 0.01 * rng.normal(size=6), -x / depth], axis=-1)
    light /= np.linalg.norm(light, axis=1, keepdims=True)
    return misfit.Sights(point, EDGES, light, np.array([650.0, 480.0]) + rng.uniform(-200, 200, size=(6, 2)))


@MODELS
def test_a_light_plane_along_the_ring_has_no_misfit(rng, model):
    sights, camera = noisy_sights(rng), camera_of(model)
    solution = constrained_form(sights.point_m[None], EDGES)
    along = sights._replace(light_normal=np.repeat(solution.normal, 6, axis=0))

    assert np.isnan(misfit.misfit_px(along, solution, camera))


@MODELS
def test_a_ring_behind_the_camera_has_no_misfit(rng, model):
    sights = noisy_sights(rng)
    behind = sights._replace(point_m=-sights.point_m)

    assert np.isnan(misfit.misfit_px(behind, constrained_form(behind.point_m[None], EDGES), camera_of(model)))


@pytest.mark.parametrize(
    ("number", "other"),
    [(0, np.zeros((5, 3))), (2, np.zeros((5, 3))), (3, np.zeros((6, 3))), (4, np.zeros(2)), (6, np.zeros(3))],
    ids=["points", "normals", "positions", "normal", "radii"],
)
def test_arrays_that_do_not_fit_are_refused(number, other):
    arrays = [np.zeros((6, 3)), EDGES, np.zeros((6, 3)), np.zeros((6, 2)), np.zeros(3), np.zeros(3), np.zeros(2)]
    arrays[number] = other

    with pytest.raises(ValueError, match=r"points|misfit"):
        _forms.misfit(*arrays, np.eye(3), np.zeros(5), 1.0)


@pytest.mark.parametrize(("matrix", "count"), [(np.eye(4), 5), (np.eye(3), 9)])
def test_a_lens_of_other_shape_is_refused(matrix, count):
    arrays = [np.zeros((6, 3)), EDGES, np.zeros((6, 3)), np.zeros((6, 2)), np.zeros(3), np.zeros(3), np.zeros(2)]

    with pytest.raises(ValueError, match="lens"):
        _forms.misfit(*arrays, matrix, np.zeros(count), 1.0)


@MODELS
def test_spread_is_that_of_the_jacobians(rng, model):
    sights, camera = noisy_sights(rng), camera_of(model)
    half = rng.normal(size=(6, 2, 2))
    covariance_px2 = half @ half.swapaxes(1, 2)

    found = misfit.spread_m2(sights.point_m, sights.light_normal, covariance_px2, camera)

    by_pixel = point_jacobians(sights.point_m, sights.light_normal, camera).by_pixel
    expected = block_diag(*(by_pixel @ covariance_px2 @ by_pixel.swapaxes(1, 2)))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("shapes", [((5, 3), (6, 2, 2)), ((6, 2), (6, 2, 2)), ((6, 3), (6, 2, 3)), ((6, 3), (7, 2, 2))])
def test_spreads_that_do_not_fit_are_refused(shapes):
    normals, covariances = (np.zeros(shape) for shape in shapes)

    with pytest.raises(ValueError, match="spread"):
        _forms.spread(np.zeros((6, 3)), normals, covariances, np.eye(3), np.zeros(5))
