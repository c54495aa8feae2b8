"""Variances of errors by restricted likelihood, against the formulas of all corrections at once."""

import numpy as np
import pytest

from ringpose.calibrate.mount.variances import ErrorModel, likelihood, most_likely

VIEWS, COMMON = 7, 9
TRUE = np.log(np.array([2e-3, 5e-4]) ** 2)


@pytest.fixture
def model(rng) -> ErrorModel:
    """Errors of rotation and translation, beside noise, with a prior."""
    errors = (rng.normal(size=(VIEWS, 6, 3)), rng.normal(size=(VIEWS, 6, 3)))
    noise = 2e-4 * rng.uniform(0.5, 2.0, (VIEWS, 6))
    z = noise * rng.normal(size=(VIEWS, 6))
    for logarithm, each in zip(TRUE, errors, strict=True):
        z += np.exp(0.5 * logarithm) * (each @ rng.normal(size=(VIEWS, 3, 1)))[..., 0]
    known = np.diag(rng.uniform(0.0, 1e5, COMMON))
    return ErrorModel(
        z=z, covariance=np.einsum("vi,ij->vij", noise**2, np.eye(6)), design=rng.normal(size=(VIEWS, 6, COMMON)),
        known=known, gradient=np.zeros(COMMON), errors=errors,
        prior_mean=TRUE + 0.5, prior_precision=np.diag([0.2, 0.0]),
    )  # fmt: skip


def dense(model: ErrorModel, logarithms: np.ndarray) -> tuple[float, np.ndarray]:
    """Log-density and Fisher's information by matrices of all corrections (Searle et al., Eq. 6.66 and 6.69)."""
    parts = []
    for logarithm, errors in zip(logarithms, model.errors, strict=True):
        part = np.zeros((VIEWS, 6, VIEWS, 6))
        part[range(VIEWS), :, range(VIEWS)] = np.exp(logarithm) * errors @ errors.swapaxes(1, 2)
        parts.append(part.reshape(6 * VIEWS, -1))
    noise = np.zeros((VIEWS, 6, VIEWS, 6))
    noise[range(VIEWS), :, range(VIEWS)] = model.covariance
    covariance = noise.reshape(6 * VIEWS, -1) + sum(parts)
    design, z = model.design.reshape(6 * VIEWS, -1), model.z.ravel()
    inverse = np.linalg.inv(covariance)
    information = design.T @ inverse @ design + model.known
    projector = inverse - inverse @ design @ np.linalg.solve(information, design.T @ inverse)
    off = logarithms - model.prior_mean
    value = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(information)[1] + z @ projector @ z
    expected = [[0.5 * np.trace(projector @ one @ projector @ two) for two in parts] for one in parts]
    return -0.5 * (value + off @ model.prior_precision @ off), np.array(expected) + model.prior_precision


@pytest.mark.parametrize("shift", [-3.0, 0.0, 2.0])
def test_the_likelihood_is_that_of_all_corrections_at_once(model, shift):
    found = likelihood(model, TRUE + shift)

    log_density, information = dense(model, TRUE + shift)
    assert found.log_density == pytest.approx(log_density, rel=1e-9)
    np.testing.assert_allclose(found.information, information, rtol=1e-7)


@pytest.mark.parametrize("shift", [-3.0, 0.0, 2.0])
def test_the_score_is_the_difference_of_the_density(model, shift):
    step = 1e-4 * np.eye(2)
    differences = [
        (dense(model, TRUE + shift + each)[0] - dense(model, TRUE + shift - each)[0]) / 2e-4 for each in step
    ]

    np.testing.assert_allclose(likelihood(model, TRUE + shift).score, differences, rtol=1e-5, atol=1e-5)


def test_the_most_likely_variances_have_no_score(model):
    bounds = np.full(2, 2 * np.log(1e-6)), np.full(2, 2 * np.log(0.05))

    logarithms, found = most_likely(model, TRUE + np.array([3.0, -3.0]), bounds)

    assert np.abs(found.score).max() < 1e-2 * np.sqrt(np.diag(found.information)).max()
    assert np.abs(logarithms - TRUE).max() < 3.0


def test_a_variance_that_is_not_seen_ends_at_its_bound(model, rng):
    unseen = ErrorModel(
        z=np.sqrt(model.covariance[0, 0, 0]) * 0.1 * rng.normal(size=(VIEWS, 6)), covariance=model.covariance,
        design=model.design, known=model.known, gradient=model.gradient, errors=model.errors,
        prior_mean=np.zeros(2), prior_precision=np.zeros((2, 2)),
    )  # fmt: skip
    lower = np.full(2, 2 * np.log(1e-6))

    logarithms, _ = most_likely(unseen, TRUE, (lower, np.full(2, 2 * np.log(0.05))))

    np.testing.assert_array_equal(logarithms, lower)
