"""The manifold of the filters: increments, their inverse, and rigid motion."""

from dataclasses import replace

import numpy as np
import pytest
from moving_rings import Motion, Shots, drawn_motion, measured, record, rings_of
from ring_scenes import RIGS, Ring

from ringpose.files.scenes.scene import read_scene
from ringpose.files.studies.specification import PRESETS
from ringpose.geometry.ring import RingArcs, ring_arcs
from ringpose.measure.stream import pose_line
from ringpose.simulate.features import drawn_features
from ringpose.track.common_errors import CommonErrors, common_errors
from ringpose.track.observation import observation
from ringpose.track.states import (
    MOVING,
    RingStates,
    center_velocity,
    local_coordinates,
    predict_states,
    retract,
    step_rates,
)
from ringpose.types.pose import PoseLine
from ringpose.types.scene import Approach


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
    return retract(one, 0.05 * rng.normal(size=(5, 14)))


@pytest.fixture
def chart(states) -> RingStates:
    """A state near the others."""
    near = RingStates(*(part[:1] for part in states))
    return retract(near._replace(motion=np.zeros((1, 7))), np.linspace(-0.02, 0.03, 14)[None])._replace(
        motion=np.zeros((1, 7))
    )


def test_increments_move_a_state_as_they_move_the_arcs_of_the_ring(states, rng):
    step = 0.05 * rng.normal(size=(5, 14))
    arcs = RingArcs(
        origin=states.origin[2],
        axes=states.axes[2],
        curvature=float(states.curvature[2]),
        half_band_m=float(states.half_band_m[2]),
    ).retract(step[2, :7])

    found = retract(states, step)

    np.testing.assert_allclose(found.axes[2], arcs.axes, atol=1e-14)
    np.testing.assert_allclose(found.center_m[2], arcs.center, atol=1e-14)


def test_the_coordinates_of_a_state_are_the_increments_that_led_to_it(chart, rng):
    step = 0.05 * rng.normal(size=(5, 14))

    np.testing.assert_allclose(local_coordinates(chart, retract(chart, step)).coordinates, step, atol=1e-13)


def test_a_ring_described_about_another_place_is_the_same_ring_in_the_same_motion(states, chart):
    shifted = chart._replace(origin=chart.origin + 0.05 * chart.axes[:, 1])

    found = retract(shifted, local_coordinates(shifted, states).coordinates)

    np.testing.assert_allclose(found.center_m, states.center_m, atol=1e-13)
    np.testing.assert_allclose(found.axes[:, 2], states.axes[:, 2], atol=1e-13)
    np.testing.assert_allclose((found.origin - shifted.origin) @ shifted.axes[0, 1], 0.0, atol=1e-13)
    later, expected = predict_states(found, 0.7), predict_states(states, 0.7)
    np.testing.assert_allclose(later.center_m, expected.center_m, atol=1e-13)
    np.testing.assert_allclose(later.axes[:, 2], expected.axes[:, 2], atol=1e-13)


@pytest.mark.parametrize("lever_m", [0.0, 1.3])
def test_motion_is_that_of_a_rigid_body_about_its_centre_of_mass(ring, lever_m):
    rate = np.array([0.05, -0.03, 0.02])
    if lever_m == 0.0:
        rate = rate - (rate @ ring.normal) * ring.normal
    truth = Motion(ring=ring, velocity_m_s=np.array([0.01, 0.02, -0.03]), rate_rad_s=rate, lever_m=lever_m)
    state = state_of(ring, truth.velocity_at(0.0), rate, np.array([0.0, 0.0, 0.5]), lever_m)

    found = predict_states(state, 1.7)

    np.testing.assert_allclose(found.center_m[0], truth.at(1.7).center_m, atol=1e-13)
    np.testing.assert_allclose(found.axes[0, 2], truth.at(1.7).normal, atol=1e-13)
    np.testing.assert_allclose((center_velocity(found) @ found.axes[0])[0], truth.velocity_at(1.7), atol=1e-13)


def test_rates_of_the_coordinates_are_their_changes_by_motion(states, chart):
    def coordinates(time_s):
        return local_coordinates(chart, predict_states(states, time_s)).coordinates

    rates = step_rates(chart, local_coordinates(chart, states))

    np.testing.assert_allclose(rates, ((coordinates(1e-4) - coordinates(-1e-4)) / 2e-4)[:, list(MOVING)], atol=1e-8)


def test_a_ring_that_misses_the_place_has_no_coordinates(states, chart):
    far = states._replace(origin=states.origin + 2.0 * chart.axes[:, 1])

    assert np.isnan(local_coordinates(chart, far).coordinates).any(axis=1).all()


def test_a_measurement_described_for_the_other_side_predicts_the_same_rows(ring, rng):
    """A ring that is seen from the other side of its face: increments change sign, rows stay what they are."""
    found = measured(Motion(ring=ring, velocity_m_s=np.zeros(3), rate_rad_s=np.zeros(3)), 0.0, Shots(), rng)[0]
    line = PoseLine(shot="a", stamp_s=0.0, pose=None, pose_stamp_s=0.0, measurement=found)
    one = observation(line, found, CommonErrors(names=(), root=np.zeros((0, 0))), 1.0)
    other = one.towards(-one.arcs.axes[0])
    step = 1e-3 * rng.normal(size=7)

    there = other.chart, retract(one.chart, np.concatenate([step, np.zeros(7)])[None])
    opposite = there[1]._replace(
        axes=there[1].axes * np.array([-1.0, -1.0, 1.0])[:, None], curvature=-there[1].curvature
    )

    np.testing.assert_allclose(opposite.axes[0], retract(other.chart, _signed(step)).axes[0], atol=1e-14)
    np.testing.assert_allclose(one.wrt_step @ step, other.wrt_step @ _signed(step)[0, :7], atol=1e-9)
    assert one.towards(one.arcs.axes[0]) is one


def _signed(step) -> np.ndarray:
    """The same increments for arcs with reversed inward and along axes and the opposite curvature."""
    return np.concatenate([step * np.array([-1, -1, 1, -1, 1, -1, 1]), np.zeros(7)])[None]


def test_a_measurement_of_a_moving_ring_describes_the_same_rows_as_the_record(rng):
    """Rings a little beside the linearisation point, by the parameters of the record: radius, place, motion."""
    motion = drawn_motion(rng, speed_m_s=0.1, rate_deg_s=5.0)
    line = record(motion, 0.0, Shots(), rng)
    found, observed = (
        line.measurement,
        observation(line, line.measurement, common_errors(line, line.measurement, None), 1.0),
    )
    scale = 1e-5 * np.array([1, 1, 1, 1, 1, 10, 10, 10, 10, 10, 10, 10])

    for increments in scale * rng.normal(size=(20, 12)):
        center, normal, radius, velocity, rate = (part[0] for part in rings_of(found.linearized_at, increments[None]))
        state = state_of(Ring(center_m=center, normal=normal, radius_m=radius), velocity, rate, observed.arcs.origin)
        beside = local_coordinates(observed.chart, state)
        rates = step_rates(observed.chart, beside)[0] - observed.step_rates
        rows = observed.wrt_step @ beside.coordinates[0, :7] + observed.wrt_step_rates @ rates
        np.testing.assert_allclose(rows, found.square_root[:, :12] @ increments, atol=1e-4)


@pytest.mark.parametrize(("sigma_px", "line_px"), [(0.3, 0.02), (0.03, 0.1)])
def test_a_measurement_is_described_about_the_place_where_the_ring_was_seen(rng, sigma_px, line_px):
    for _ in range(8):
        motion = drawn_motion(rng, speed_m_s=0.0, rate_deg_s=0.0)
        shots = Shots(sigma_px=sigma_px, line_px=line_px, frame_s=0.0)
        line = record(motion, 0.0, shots, rng)
        seen_m = motion.ring.break_points_m(RIGS["B"].lasers).reshape(-1, 3).mean(axis=0) - motion.ring.center_m

        observed = observation(line, line.measurement, common_errors(line, line.measurement, None), 1.0)

        cosine = -observed.arcs.axes[0] @ seen_m / np.linalg.norm(seen_m)
        assert np.degrees(np.arccos(cosine)) < 15.0


def test_in_light_a_measurement_is_described_about_the_middle_of_the_stripes_too():
    """Visible edges determine the ring nearly as well beside the stripes."""
    scene = read_scene(PRESETS / "paper-physical-scene.yaml")
    view = Approach(count=1, distances_m=(0.5,), lights=("normal",), seed=3, name="r", tilt_rad=0.15)
    (shot,) = drawn_features(replace(scene, views=(), approaches=(view,)))
    line = pose_line(shot.detection, scene.rig)
    middle_m = line.pose.grasp_m - line.pose.center_m

    observed = observation(line, line.measurement, common_errors(line, line.measurement, scene.rig), 1.0)

    cosine = -observed.arcs.axes[0] @ middle_m / np.linalg.norm(middle_m)
    assert np.degrees(np.arccos(cosine)) < 12.0
