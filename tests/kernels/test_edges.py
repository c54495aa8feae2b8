"""The kernels that follow a ring's edges equal their readable twins."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ringpose.detect.edge_steps import _templates
from ringpose.detect.ring_arc_fit import RULES as FIT_RULES
from ringpose.geometry.ring_arcs import RingArcs, arc_points, moved
from ringpose.kernels import _edges, edges, reference_edges
from ringpose.kernels.edges import PlaceRules, PlanePoints, ProfileRules, Sights, StepRules
from ringpose.kernels.ring import Lens

LENS = Lens(1778.0, 1781.0, 790.0, 611.0, -0.12, 0.05, 4e-4, -3e-4, 0.01)
RATIONAL = LENS._replace(k4=0.02, k5=-0.01, k6=0.004)
PLACES = PlaceRules(1600.0, 1200.0, 12.0, 1.3, 2.0, 8.0, 0.3, 3.0, 1.3, 1e-4)
PROFILES = ProfileRules(2.0, 5.0, 3.0, 4.0, 0.3, 9.0, 255.0)
STEPS = StepRules(1e-9, 3.0, 0.25, 9.0)
TEMPLATES = _templates(2, 0.9)

steps_of_state = arrays(np.float64, 7, elements=st.floats(-1, 1)).map(
    lambda part: part * [0.4, 0.4, 0.2, 0.1, 0.7, 3.0, 0.01]
)


def arcs(step=(0.0,) * 7) -> RingArcs:
    """A ring half a metre before the camera, moved by a step of its state."""
    facing = RingArcs(
        origin=np.array([0.02, 0.05, 0.5]),
        axes=np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
        curvature=1.7,
        half_band_m=0.015,
    )
    return moved(facing, np.array(step))


def covariance(sigma: float) -> np.ndarray:
    half = np.random.default_rng(1).normal(size=(7, 7))
    return sigma**2 * half @ half.T


@pytest.mark.parametrize("lens", [LENS, RATIONAL])
@given(step=steps_of_state, sigma=st.sampled_from([0.0, 1e-4, 1e-3]))
def test_places_equal_their_twin(lens, step, sigma):
    ours, twin = (
        module.edge_places(arcs(step), covariance(sigma), lens, PLACES) for module in (edges, reference_edges)
    )

    np.testing.assert_allclose(ours, twin, rtol=1e-7, atol=1e-7)


def test_a_straight_ring_has_places_on_both_edges():
    straight = replace(arcs(), curvature=0.0)

    found = edges.edge_places(straight, covariance(0.0), LENS, PLACES)

    np.testing.assert_allclose(found, reference_edges.edge_places(straight, covariance(0.0), LENS, PLACES), atol=1e-7)
    assert set(found[:, 6]) == {1.0, -1.0}


def test_so_many_places_at_most_are_to_both_sides():
    found = edges.edge_places(arcs(), covariance(0.0), LENS, PLACES._replace(farthest=3.0))

    assert np.abs(found[:, 12]).max() == 3


def test_a_ring_behind_the_camera_has_no_places():
    behind = replace(arcs(), origin=np.array([0.0, 0.0, -0.5]))

    assert len(edges.edge_places(behind, covariance(0.0), LENS, PLACES)) == 0


def profiles_of(module, image, rng):
    """Profiles at places inside, on and beyond the border of an image."""
    place = rng.uniform(-3, 44, (30, 2))
    angle = rng.uniform(0, 2 * np.pi, 30)
    return module.edge_profiles(image, place, np.stack([np.cos(angle), np.sin(angle)], axis=-1), PROFILES)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("part", [0, 1, 2])
def test_profiles_equal_their_twin(dtype, part):
    image = np.random.default_rng(3).integers(0, 257, (37, 41)).clip(0, np.iinfo(np.uint8).max).astype(dtype)

    ours, twin = (profiles_of(module, image, np.random.default_rng(4))[part] for module in (edges, reference_edges))

    np.testing.assert_allclose(ours, twin, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("normal", [np.nan, np.inf, 1e9])
@pytest.mark.parametrize("place", [np.nan, -np.inf, 20.0])
def test_places_and_normals_that_are_none_read_nothing_beyond_the_image(place, normal):
    image = np.full((40, 40), 7, np.uint8)

    value, saturated, _ = edges.edge_profiles(image, np.full((2, 2), place), np.full((2, 2), normal), PROFILES)

    assert not value.any()
    assert not saturated.any()


@given(st.integers(0, 1000))
def test_steps_equal_their_twin(seed):
    rng = np.random.default_rng(seed)
    value = rng.normal(size=(20, 13)) + rng.uniform(0, 9) * (TEMPLATES.across_px > rng.uniform(-2, 2))
    saturated, noise_dn = rng.uniform(size=value.shape) < 0.02, rng.uniform(0.5, 3, 20)

    ours, twin = (
        module.edge_steps(value, saturated, noise_dn, TEMPLATES, STEPS) for module in (edges, reference_edges)
    )

    np.testing.assert_allclose(ours, twin, rtol=1e-9, atol=1e-9)


def seen(rng) -> tuple[PlanePoints, Sights]:
    """A plane and sights of a ring that is not quite where it is taken to be."""
    true = arcs([0.05, -0.03, 0.004, 0.003, 0.02, 0.1, 0.001])
    side = np.repeat([1.0, -1.0], 40)
    ray, _ = arc_points(true, np.tile(np.linspace(-0.2, 0.2, 40), 2), side)
    ray[3] += 0.02
    point = true.origin + rng.uniform(-0.1, 0.1, (6, 2)) @ true.axes[:2]
    return PlanePoints(point, np.full(6, 1e-4)), Sights(ray + rng.normal(0, 1e-4, ray.shape), side, np.full(80, 2e-4))


@pytest.mark.parametrize("outlier_sigmas", [3.0, np.inf])
@pytest.mark.parametrize("rounds", [1, 5])
def test_fitted_arcs_equal_their_twin(rng, outlier_sigmas, rounds):
    plane, sights = seen(rng)
    rules = FIT_RULES._replace(rounds=rounds, outlier_sigmas=outlier_sigmas)

    (ours, covariance_ours), (twin, covariance_twin) = (
        module.fitted_arcs(arcs(), plane, sights, arcs().axes, rules) for module in (edges, reference_edges)
    )

    np.testing.assert_allclose(
        [*ours.origin, *ours.axes.ravel(), ours.curvature, ours.half_band_m],
        [*twin.origin, *twin.axes.ravel(), twin.curvature, twin.half_band_m],
        rtol=1e-8,
        atol=1e-9,
    )
    np.testing.assert_allclose(covariance_ours, covariance_twin, rtol=1e-6, atol=1e-14)


def test_contradictions_leave_no_number():
    plane, sights = PlanePoints(np.full((1, 3), np.nan), np.ones(1)), Sights(np.zeros((0, 3)), np.zeros(0), np.zeros(0))

    _, known = edges.fitted_arcs(arcs(), plane, sights, arcs().axes, FIT_RULES)

    assert np.isnan(known).all()


@pytest.mark.parametrize("name", ["places", "profiles", "steps", "fit"])
def test_wrong_arguments_are_refused(name):
    with pytest.raises(TypeError, match="takes"):
        getattr(_edges, name)()


def test_arrays_that_do_not_fit_together_are_refused():
    value, saturated, noise = np.empty((3, 13)), np.empty((3, 13), np.bool_), np.empty(3)

    with pytest.raises(ValueError, match="normal: must be as many as the others"):
        _edges.profiles(
            np.zeros((9, 9), np.uint8), np.zeros((3, 2)), np.zeros((2, 2)), np.array(PROFILES), value, saturated, noise
        )
