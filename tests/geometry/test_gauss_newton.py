"""Gauss-Newton iterations and eliminated parameters on problems with a known solution."""

import numpy as np
import pytest

from ringpose.geometry.least_squares import Eliminated, Rows, gauss_newton

TRUE = np.array([2.0, -0.7])
START = np.array([1.5, -0.5])
X = np.linspace(0.0, 3.0, 20)


def rows(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of an exponential a exp(b x) from the true one, and their Jacobian."""
    exponential = np.exp(state[1] * X)
    return state[0] * exponential - TRUE[0] * np.exp(TRUE[1] * X), np.stack(
        [exponential, state[0] * X * exponential], 1
    )


def linearize(state: np.ndarray) -> Rows:
    return Rows.of(*rows(state))


def retract(state: np.ndarray, problem: Rows) -> np.ndarray:
    return state + problem.step


def test_an_exponential_is_fitted_to_exact_values():
    state, converged = gauss_newton(linearize, retract, START, 12, 1e-24)

    assert converged
    assert state == pytest.approx(TRUE, abs=1e-12)


def test_one_iteration_is_the_linear_least_squares_step_and_has_not_converged():
    residual, jacobian = rows(START)

    state, converged = gauss_newton(linearize, retract, START, 1)

    assert not converged
    assert jacobian.T @ (residual + jacobian @ (state - START)) == pytest.approx(0.0, abs=1e-12)


def test_the_predicted_decrease_is_that_of_the_linear_problem():
    residual, jacobian = rows(START)
    problem = linearize(START)

    remaining = residual + jacobian @ problem.step

    assert problem.decrease == pytest.approx(residual @ residual - remaining @ remaining)


def test_a_state_whose_next_step_is_short_enough_is_kept():
    near = TRUE + 1e-6

    state, converged = gauss_newton(linearize, retract, near, 8, 1e-6)

    assert converged
    assert state is near


def test_the_iteration_ends_without_convergence_at_a_state_without_finite_residuals():
    def leaving(state: np.ndarray) -> Rows:
        residual, jacobian = rows(state)
        return Rows.of(np.full_like(residual, np.nan if state[0] != 1.5 else 1.0), jacobian)

    steps: list[np.ndarray] = []

    def counted(state: np.ndarray, problem: Rows) -> np.ndarray:
        steps.append(problem.step)
        return retract(state, problem)

    _, converged = gauss_newton(leaving, counted, START, 8)

    assert len(steps) == 1
    assert not converged


def test_the_iteration_ends_without_convergence_where_no_step_makes_it_better():
    state, converged = gauss_newton(linearize, lambda state, _: state, START, 8)

    assert state is START
    assert not converged


def test_eliminated_parameters_and_those_kept_have_the_steps_of_the_whole_problem(rng):
    own, shared, residual = rng.normal(size=(30, 3)), rng.normal(size=(30, 4)), rng.normal(size=30)
    whole = np.column_stack([own, shared])
    step = np.linalg.lstsq(whole, residual)[0]

    reduced = Eliminated.of(own, shared, residual)
    shared_step = np.linalg.solve(reduced.information, reduced.gradient)

    assert shared_step == pytest.approx(step[3:])
    assert reduced.own(shared_step) == pytest.approx(step[:3])
    assert np.linalg.inv(reduced.information) == pytest.approx(np.linalg.inv(whole.T @ whole)[3:, 3:])
    alone = residual - own @ reduced.own_step
    assert reduced.own_decrease == pytest.approx(residual @ residual - alone @ alone)
