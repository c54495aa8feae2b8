"""The derivatives of the closed forms in C come with the solution of the form."""

import numpy as np
import pytest

from ringpose.geometry.planes import nearest_plane
from ringpose.kernels import _forms, forms

BOTH = pytest.mark.parametrize("constrained", [False, True], ids=["paper", "constrained"])
ALL_EDGES = pytest.mark.parametrize(
    "edges", [np.array([0, 1, 0, 1, 0, 1]), np.array([0, 0, 0, 1]), np.array([1, 1, 1]), np.repeat([0, 1], 12)], ids=len
)


def arc_points(rng, edges, radius_m=0.6, noise_m=1e-5):
    """Points of a band 30 mm wide, in a tilted plane before the camera."""
    angle = rng.uniform(-0.2, 0.2, len(edges)) / radius_m
    radius = radius_m - 0.03 * (1 - edges)
    flat = np.stack([radius * np.sin(angle), radius * np.cos(angle) - radius_m, np.zeros(len(edges))], axis=-1)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return flat @ turn + [0.1, -0.5, 1.0] + noise_m * rng.normal(size=(len(edges), 3))


@BOTH
@ALL_EDGES
def test_the_solution_beside_the_derivatives_is_that_of_the_form(rng, edges, constrained):
    points = arc_points(rng, edges)
    alone = (forms.constrained_form if constrained else forms.paper_form)(points[None], edges)

    found = forms.differentiated(points, edges, constrained).form

    for_each = [np.hstack([np.atleast_2d(f.normal), f.center_m, f.radius_m, f.grasp_m]) for f in (found, alone)]
    np.testing.assert_array_equal(*for_each)
    assert (found.condition, found.damped) == (alone.condition, alone.damped)


@pytest.mark.parametrize(
    ("points", "edges"),
    [
        (np.zeros((2, 2)), np.array([0, 1])),
        (np.zeros((3, 3)), np.array([0, 1])),
        (np.zeros((2, 3)), np.array([0, 2])),
        (np.zeros((65, 3)), np.zeros(65, dtype=np.int64)),
        (np.zeros((0, 3)), np.zeros(0, dtype=np.int64)),
    ],
    ids=["axes", "numbers", "edge", "too many", "none"],
)
def test_points_that_do_not_fit_are_refused(points, edges):
    with pytest.raises(ValueError, match=r"points|edges"):
        _forms.derivatives(points, edges, False, 1e-3, 1e-6)


@ALL_EDGES
def test_the_nearest_plane_is_that_of_numpy(rng, edges):
    points = arc_points(rng, edges)

    normal, distance_m, values = forms.nearest_plane(points)

    numpys_normal, numpys_m, numpys_values = nearest_plane(points)
    sign = np.sign(normal @ numpys_normal)
    np.testing.assert_allclose(sign * normal, numpys_normal, rtol=0, atol=1e-10)
    assert sign * distance_m == pytest.approx(numpys_m, abs=1e-10)
    np.testing.assert_allclose(values, numpys_values, rtol=0, atol=1e-14)


@pytest.mark.parametrize("shape", [(0, 3), (65, 3), (5, 2)])
def test_points_without_a_plane_are_refused(shape):
    with pytest.raises(ValueError, match="points"):
        _forms.plane(np.zeros(shape))
