"""The manifold of the filters: increments, their inverse, and rigid motion."""

import numpy as np
import pytest
from moving_rings import Motion
from ring_scenes import Ring

from ringpose.geometry.ring import RingArcs, ring_arcs
from ringpose.track.states import (
    MOVING,
    RingStates,
    after,
    center_velocity,
    difference,
    moved,
    relative,
    step_rates,
)


def state_of(ring: Ring, velocity_m_s, rate_rad_s, near_m, lever_m=0.0) -> RingStates:
    """A state from a ring, the velocity of its centre and its whole angular velocity, in the camera frame."""
    arcs = ring_arcs(ring.center_m, ring.normal, ring.radius_m, near_m)
    rate = arcs.axes @ rate_rad_s
    velocity = arcs.axes @ velocity_m_s + arcs.mean_radius_m * np.array([0.0, 0.0, rate[1]])
    return RingStates(
        origin=arcs.origin[None],
        axes=arcs.axes[None],
        curvature=np.array([arcs.curvature]),
        half_band_m=np.array([arcs.half_band_m]),
        motion=np.concatenate([velocity, rate, [lever_m]])[None],
    )


@pytest.fixture
def ring(rng) -> Ring:
    normal = np.array([0.1, -0.2, -1.0])
    return Ring(
        center_m=np.array([0.58, 0.02, 0.5]), normal=normal / np.linalg.norm(normal), radius_m=np.array([0.567, 0.597])
    )


@pytest.fixture
def states(ring, rng) -> RingStates:
    """Some states near a ring, in motion."""
    one = state_of(ring, np.array([0.03, -0.02, 0.01]), np.array([0.05, 0.03, 0.02]), np.array([0.0, 0.0, 0.5]), 1.2)
    return moved(one.repeated(5), 0.05 * rng.normal(size=(5, 14)))


def test_increments_move_a_state_as_they_move_the_arcs_of_the_ring(states, rng):
    step = 0.05 * rng.normal(size=(5, 14))
    arcs = RingArcs(
        origin=states.origin[2],
        axes=states.axes[2],
        curvature=float(states.curvature[2]),
        half_band_m=float(states.half_band_m[2]),
    ).moved(step[2, :7])

    found = moved(states, step)

    np.testing.assert_allclose(found.axes[2], arcs.axes, atol=1e-14)
    np.testing.assert_allclose(found.center_m[2], arcs.center, atol=1e-14)


def test_the_difference_of_two_states_leads_from_one_to_the_other(states, rng):
    step = 0.05 * rng.normal(size=(5, 14))

    np.testing.assert_allclose(difference(states, moved(states, step)), step, atol=1e-13)


def test_a_ring_described_about_another_place_is_the_same_ring_in_the_same_motion(states):
    place = states.origin[0] + 0.05 * states.axes[0, 1]
    arcs = ring_arcs(states.center_m[0], states.axes[0, 2], np.array([0.56, 0.6]), place)

    found = relative(arcs.origin[None], arcs.axes[None], np.array([1.5]), np.array([0.0]), states).states

    np.testing.assert_allclose(found.center_m, states.center_m, atol=1e-13)
    np.testing.assert_allclose(found.axes[:, 2], states.axes[:, 2], atol=1e-14)
    for one, other in ((found, states),):
        np.testing.assert_allclose(
            (center_velocity(one)[:, None] @ one.axes)[:, 0], (center_velocity(other)[:, None] @ other.axes)[:, 0]
        )
    later = after(found, 0.7), after(states, 0.7)
    np.testing.assert_allclose(later[0].center_m, later[1].center_m, atol=1e-13)
    np.testing.assert_allclose((found.origin - place) @ arcs.axes[1], 0.0, atol=1e-13)


@pytest.mark.parametrize("lever_m", [0.0, 1.3])
def test_motion_is_that_of_a_rigid_body_about_its_centre_of_mass(ring, lever_m):
    rate = np.array([0.05, -0.03, 0.02])
    if lever_m == 0.0:
        rate = rate - (rate @ ring.normal) * ring.normal
    truth = Motion(ring=ring, velocity_m_s=np.array([0.01, 0.02, -0.03]), rate_rad_s=rate, lever_m=lever_m)
    state = state_of(ring, truth.velocity_at(0.0), rate, np.array([0.0, 0.0, 0.5]), lever_m)

    found = after(state, 1.7)

    np.testing.assert_allclose(found.center_m[0], truth.at(1.7).center_m, atol=1e-13)
    np.testing.assert_allclose(found.axes[0, 2], truth.at(1.7).normal, atol=1e-13)
    np.testing.assert_allclose((center_velocity(found) @ found.axes[0])[0], truth.velocity_at(1.7), atol=1e-13)


def test_rates_of_the_increments_are_their_changes_by_motion(states, rng):
    reference = moved(states, 0.05 * rng.normal(size=(5, 14)))

    def errors(time_s):
        at = after(states, time_s)
        return relative(reference.origin, reference.axes, reference.curvature, reference.half_band_m, at).errors

    rates = step_rates(
        relative(reference.origin, reference.axes, reference.curvature, reference.half_band_m, states)
    )

    np.testing.assert_allclose(rates, ((errors(1e-4) - errors(-1e-4)) / 2e-4)[:, list(MOVING)], atol=1e-8)


def test_a_ring_on_the_other_side_is_described_with_a_negative_curvature(states):
    reference = states.at(slice(0, 1))
    opposite = reference._replace(axes=reference.axes * np.array([-1.0, -1.0, 1.0])[:, None])

    found = relative(reference.origin, reference.axes, reference.curvature, reference.half_band_m, opposite)

    np.testing.assert_allclose(found.errors[0, [0, 1, 2, 3, 4, 6]], 0.0, atol=1e-13)
    assert found.errors[0, 5] == pytest.approx(-2.0 * reference.curvature[0])
    assert found.side[0] == -1.0


def test_a_ring_that_misses_the_place_has_no_increments(states):
    reference = states.at(slice(0, 1))
    far = reference._replace(origin=reference.origin + 2.0 * reference.axes[:, 1])

    found = relative(reference.origin, reference.axes, reference.curvature, reference.half_band_m, far)

    assert np.isnan(found.errors[0]).any()
