"""Gauss-Newton iterations on a problem with a known solution."""

import numpy as np
import pytest

from ringpose.geometry.least_squares import gauss_newton

TRUE = np.array([2.0, -0.7])
X = np.linspace(0.0, 3.0, 20)


def linearize(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of an exponential a exp(b x) from the true one, and their Jacobian."""
    exponential = np.exp(state[1] * X)
    return state[0] * exponential - TRUE[0] * np.exp(TRUE[1] * X), np.stack(
        [exponential, state[0] * X * exponential], 1
    )


def test_an_exponential_is_fitted_to_exact_values():
    found = gauss_newton(linearize, lambda state, step: state + step, np.array([1.5, -0.5]), 8)

    assert found == pytest.approx(TRUE, abs=1e-12)


def test_one_iteration_is_the_linear_least_squares_step():
    start = np.array([1.5, -0.5])
    residual, jacobian = linearize(start)

    found = gauss_newton(linearize, lambda state, step: state + step, start, 1)

    assert jacobian.T @ (residual + jacobian @ (found - start)) == pytest.approx(0.0, abs=1e-12)


def test_the_iteration_ends_at_a_state_without_finite_residuals():
    def leaving(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        residual, jacobian = linearize(state)
        return np.full_like(residual, np.nan if state[0] != 1.5 else 1.0), jacobian

    steps: list[np.ndarray] = []

    def retract(state: np.ndarray, step: np.ndarray) -> np.ndarray:
        steps.append(step)
        return state + step

    gauss_newton(leaving, retract, np.array([1.5, -0.5]), 8)

    assert len(steps) == 1
