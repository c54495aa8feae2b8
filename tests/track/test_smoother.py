"""The filter against GTSAM, whose smoother adjusts the states at all shots together, with the same process noise."""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from moving_rings import Shots, drawn_motion, stream
from needed import needed_module

from ringpose.track.common_errors import common_errors
from ringpose.track.filters import initialize
from ringpose.track.motion_models import MODELS, process_noise
from ringpose.track.observation import observation
from ringpose.track.pipeline import Tracker
from ringpose.track.states import ERRORS, jacobians, local_coordinates, perturbed, predict_states, retract, step_rates
from ringpose.types.assumptions import motion_prior

FREE = slice(0, 12)
"""The components of a state of constant velocity: without the rate about the normal and the lever."""

MODEL = int(np.flatnonzero((MODELS.velocity_noise == 1e-6) & (MODELS.rate_noise == 1e-6) & ~MODELS.precession)[0])


def whole(coordinates: np.ndarray) -> np.ndarray:
    """One state's free components as coordinates of the filter."""
    return np.concatenate([coordinates, np.zeros(len(ERRORS) - len(coordinates))])[None]


STEPS = 1e-6 * np.eye(12)


def factor(keys: list[int], whitened):
    """A factor of whitened residuals of some states, with derivatives by differences."""

    def error(_, values, derivatives):
        at = [values.atVector(key) for key in keys]
        for number in range(len(at)) if derivatives is not None else ():
            ends = [[*at[:number], at[number] + side * step, *at[number + 1 :]] for step in STEPS for side in (1, -1)]
            columns = np.array([whitened(*each) for each in ends])
            derivatives[number] = ((columns[::2] - columns[1::2]) / 2e-6).T.copy(order="F")
        return whitened(*at)

    import gtsam

    rows = len(whitened(*np.zeros((len(keys), 12))))
    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(rows), keys, error)


@pytest.mark.slow
def test_a_track_is_that_of_a_smoother_with_the_same_model(rng):
    gtsam = needed_module("gtsam", "ringpose[dev]")
    apart, ratios = [], []
    for _ in range(3):
        motion, tracker, observed = drawn_motion(rng), Tracker(None), []
        for line in stream(motion, 2.0, Shots(), rng):
            tracker.add(line)
            observed.append(observation(line, line.measurement, common_errors(line, line.measurement, None), 1.0))
        bank = tracker.track.likeliest
        chart, found = bank.chart, bank.coordinates[[MODEL]]
        observed = [each.towards(chart.axes[0, 0]) for each in observed]

        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for number, each in enumerate(observed):
            state = predict_states(retract(chart, found), each.stamp_s - bank.stamp_s)
            values.insert(number, local_coordinates(chart, state).coordinates[0, FREE])
            graph.add(factor([number], partial(shown, chart, each)))
        graph.add(factor([0], prior_of(chart, observed[0])))
        for number, (first, second) in enumerate(pairwise(observed)):
            time_s = second.stamp_s - first.stamp_s
            graph.add(factor([number, number + 1], motion_of(chart, values.atVector(number), time_s)))
        options = gtsam.LevenbergMarquardtParams()
        options.setLinearSolverType("MULTIFRONTAL_QR")
        smoothed = gtsam.LevenbergMarquardtOptimizer(graph, values, options).optimize()
        # gtsam.Marginals takes roots of the normal equations, which are too badly conditioned
        inverse = np.linalg.inv(np.linalg.qr(graph.linearize(smoothed).jacobian()[0], mode="r"))[-12:]

        last = len(observed) - 1
        sd = np.sqrt(np.diag(bank.own[MODEL])[FREE])
        apart.append((found[0, FREE] - smoothed.atVector(last)) / sd)
        ratios.append(sd / np.sqrt((inverse**2).sum(axis=1)))

    assert np.sqrt(np.mean(np.square(apart))) < 0.03
    np.testing.assert_allclose(ratios, 1.0, atol=0.05)


def shown(chart, observed, coordinates: np.ndarray) -> np.ndarray:
    """Whitened residuals of one shot."""
    there = local_coordinates(observed.chart, retract(chart, whole(coordinates)))
    steps, rates = there.coordinates[0, :7], step_rates(observed.chart, there)[0]
    return observed.target - observed.wrt_step @ steps - observed.wrt_step_rates @ (rates - observed.step_rates)


def prior_of(chart, observed):
    """Whitened residuals of the state before the first shot, which is that of a shot that shows nothing."""
    blank = replace(
        observed,
        wrt_step=np.zeros_like(observed.wrt_step),
        wrt_step_rates=np.zeros_like(observed.wrt_step_rates),
        target=np.zeros_like(observed.target),
    )
    before = initialize(blank, 1, motion_prior(), None)
    root = np.linalg.inv(np.linalg.cholesky(before.own[MODEL][FREE, FREE]))
    return lambda x: (
        root
        @ (
            local_coordinates(before.chart, retract(chart, whole(x))).coordinates[0, FREE]
            - before.coordinates[MODEL, FREE]
        )
    )


def motion_of(chart, coordinates: np.ndarray, time_s: float):
    """Whitened residuals of two states, by the process noise near the first."""

    def following(x: np.ndarray) -> np.ndarray:
        return local_coordinates(chart, predict_states(retract(chart, whole(x)), time_s)).coordinates[0, FREE]

    around = local_coordinates(chart, predict_states(retract(chart, perturbed(whole(coordinates))), time_s)).coordinates
    count = len(MODELS.precession)
    each = np.tile(whole(coordinates), (count, 1))
    noise = process_noise(MODELS, chart, each, np.tile(jacobians(around), (count, 1, 1)), time_s)[MODEL]
    least = np.full(12, 1e-7) ** 2  # radii are constant
    root = np.linalg.inv(np.linalg.cholesky(noise[FREE, FREE] + np.diag(least)))
    return lambda x, y: root @ (y - following(x))
