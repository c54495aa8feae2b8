"""What the kernel predicts is what its twin does."""

import numpy as np
import pytest

from ringpose.kernels import _forms
from ringpose.kernels.ring_rows import predicted
from ringpose.pose.measurements import Sighted
from ringpose.pose.ring_model import PLANE, RingState, arc_parts, origin_of, sights_of


def some_ring(rng):
    plane = np.array([*rng.uniform(-0.3, 0.3, 2), rng.uniform(1.0, 3.0)])
    outward = np.cross(plane, rng.normal(size=3))
    return RingState(
        plane, outward / np.linalg.norm(outward), *rng.uniform([-0.01, 0.0, 0.01], [0.01, 3.0, 0.05]).tolist()
    )


def some_sights(rng, lines=3, points=6):
    count = 2 * lines + points
    rays = np.column_stack([rng.uniform(-0.3, 0.3, (count, 2)), np.ones(count)])
    normal = np.array([0.0, 1.0, 0.0]) + rng.uniform(-0.2, 0.2, (count, 3))
    light = np.column_stack([normal / np.linalg.norm(normal, axis=1)[:, None], rng.uniform(-0.1, -0.03, count)])
    whitening = np.kron(np.eye(lines), np.ones((2, 2))) * rng.uniform(100.0, 200.0, (2 * lines, 2 * lines))
    signed = np.column_stack([rng.choice([-1.0, 1.0], points), rng.uniform(1e-4, 2e-4, points)])
    return Sighted(rays, light, whitening, signed)


@pytest.fixture
def ring(rng):
    return some_ring(rng)


@pytest.fixture
def sighted(rng):
    return some_sights(rng)


def kernel(ring, sighted):
    return predicted(ring.numbers, sighted.rays, sighted.light, sighted.whitening, sighted.edge_sign_and_sigma)


def test_lines_are_those_of_the_twin(ring, sighted):
    found, twin = kernel(ring, sighted), sights_of(ring, sighted)

    for name in ("rays", "slope", "steepness", "y_by_plane"):
        np.testing.assert_allclose(getattr(found, name), getattr(twin, name), rtol=1e-12, atol=1e-14)
    above = sighted.rays[:6, 1] - twin.rays[:6, 1]
    np.testing.assert_allclose(found.residual[:6], sighted.whitening @ above, rtol=1e-12)
    np.testing.assert_allclose(found.by_state[:6, PLANE], -sighted.whitening @ twin.y_by_plane[:6], rtol=1e-11)


def test_the_origin_is_that_of_the_twin(ring, sighted):
    found, sights = kernel(ring, sighted), sights_of(ring, sighted)

    twin = origin_of(ring, sights.rays[6:], sights.y_by_plane[6:])

    for name, value in zip(("origin_m", "origin_by_plane", "origin_by_ray"), twin, strict=True):
        np.testing.assert_allclose(getattr(found, name), value, rtol=1e-11, atol=1e-14)


def test_break_points_are_those_of_the_twin(ring, sighted):
    found, sights = kernel(ring, sighted), sights_of(ring, sighted)
    origin = origin_of(ring, sights.rays[6:], sights.y_by_plane[6:])

    twin = arc_parts(ring, sights.rays[6:], sighted.edge_sign, origin)

    twin.by_state[:, PLANE] += twin.by_ray[:, 1:] * sights.y_by_plane[6:]
    by_x = twin.by_ray[:, 0] + sights.slope[6:] * twin.by_ray[:, 1]
    scale = 1.0 / (np.abs(by_x) * sighted.edge_sign_and_sigma[:, 1])
    for name, value in zip(("distance_m", "distance_by_state", "by_ray"), twin, strict=True):
        np.testing.assert_allclose(getattr(found, name), value, rtol=1e-10, atol=1e-13)
    np.testing.assert_allclose(found.residual[6:], scale * twin.distance_m, rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(found.by_state[6:], scale[:, None] * twin.by_state, rtol=1e-9, atol=1e-8)


def test_points_alone_have_no_lines(rng, ring):
    sighted = some_sights(rng, lines=0)

    assert kernel(ring, sighted).residual.shape == (6,)


@pytest.mark.parametrize("wrong", ["state", "rays", "light", "whitening", "points"])
def test_arrays_that_do_not_fit_are_refused(ring, sighted, wrong):
    arrays = {
        "state": ring.numbers,
        "rays": sighted.rays,
        "light": sighted.light,
        "whitening": sighted.whitening,
        "points": sighted.edge_sign_and_sigma,
    }
    arrays[wrong] = np.ascontiguousarray(arrays[wrong][:-1])

    with pytest.raises(ValueError, match="do not fit"):
        _forms.rows(*arrays.values())
