"""The closed forms in C are those of the twin."""

import numpy as np
import pytest

from ringpose.kernels import _forms, forms, reference_forms

FORMS = pytest.mark.parametrize("name", ["paper_form", "constrained_form"])
EDGES = np.array([0, 1, 0, 1, 0, 1])
VALUES = ("normal", "offset_m", "center_m", "radius_m", "grasp_m")


def arc_points(rng, edges, radius_m=0.6, noise_m=1e-5, batch=5):
    """Points of a band 30 mm wide, in a plane that is tilted, and what a turn about nothing in particular leaves."""
    angle = rng.uniform(-0.3, 0.3, len(edges))
    radius = radius_m - 0.03 * (1 - edges)
    flat = np.stack([radius * np.sin(angle), radius * np.cos(angle), np.zeros(len(edges))], axis=-1)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return flat @ turn + [0.1, -0.5, 1.0] + noise_m * rng.normal(size=(batch, len(edges), 3))


def assert_equal(found, twin, rtol):
    for name in VALUES:
        np.testing.assert_allclose(getattr(found, name), getattr(twin, name), rtol=rtol, atol=rtol)
    np.testing.assert_array_equal(found.damped, twin.damped)


@FORMS
@pytest.mark.parametrize("edges", [EDGES, np.array([0, 0, 0, 1]), np.array([1, 1, 1]), np.repeat([0, 1], 12)], ids=len)
def test_kernel_is_its_twin(rng, name, edges):
    points = arc_points(rng, edges)

    assert_equal(getattr(forms, name)(points, edges), getattr(reference_forms, name)(points, edges), rtol=1e-8)


@FORMS
def test_damped_equations_are_those_of_the_twin(rng, name):
    points = arc_points(rng, EDGES, noise_m=0.0)
    points[..., :2] *= 1e-4

    assert_equal(getattr(forms, name)(points, EDGES), getattr(reference_forms, name)(points, EDGES), rtol=1e-6)


@pytest.mark.parametrize(
    ("points", "edges"),
    [
        (np.zeros((1, 2, 2)), np.array([0, 1])),
        (np.zeros((1, 3, 3)), np.array([0, 1])),
        (np.zeros((1, 2, 3)), np.array([0, 2])),
        (np.zeros((1, 65, 3)), np.zeros(65, dtype=np.int64)),
        (np.zeros((1, 0, 3)), np.zeros(0, dtype=np.int64)),
    ],
    ids=["axes", "numbers", "edge", "too many", "none"],
)
def test_arrays_that_do_not_fit_are_refused(points, edges):
    with pytest.raises(ValueError, match=r"points|edges"):
        _forms.forms(points, edges, False, 1e-3)
