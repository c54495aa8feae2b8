"""Whether a ring agrees with the measurements it was estimated from, and what the shot determines without its prior.

Stripes and break points are tested by chi-squared. Visible edges are too many, and their errors too correlated, to be
added to these few numbers.
"""

from math import inf, sqrt

import numpy as np

from ringpose.estimate.measurements import Measurements
from ringpose.estimate.residuals import PARAMETERS
from ringpose.estimate.solver import RIDGE, Estimate
from ringpose.geometry.ring import CURVATURE
from ringpose.types.arrays import Array, Float64

ALARM_SIGMAS = 3.7
"""Limit of the chi-squared test as a normal quantile: one shot in ten thousand exceeds it by chance."""


def fails_chi2_test(estimate: Estimate, measured: Measurements) -> bool:
    """Whether the residuals exceed the quantile of chi-squared."""
    dof = degrees_of_freedom(estimate, measured)
    return dof > 0 and chi2(estimate, measured) > chi2_quantile(dof, ALARM_SIGMAS)


def chi2_quantile(degrees_of_freedom: int, sigmas: float) -> float:
    """Quantile of chi-squared at the probability of a normal quantile (Wilson and Hilferty 1931)."""
    spread = 2.0 / (9.0 * degrees_of_freedom)
    return degrees_of_freedom * (1.0 - spread + sigmas * sqrt(spread)) ** 3


def chi2(estimate: Estimate, measured: Measurements) -> float:
    """Chi-squared of stripes, break points and priors; visible edges are too many to be compared with these."""
    squares = np.minimum(estimate.remaining**2, 1e6)
    edges = slice(stripe_rows(measured), stripe_rows(measured) + len(measured.edges.edge))
    return float(squares.sum()) - float(squares[edges].sum()) + estimate.common_chi2


def degrees_of_freedom(estimate: Estimate, measured: Measurements) -> int:
    """Numbers of stripes, break points and radii less the parameters.

    Rows of weak priors count like measurements.
    """
    prior_rows = len(estimate.residuals.residual) - estimate.residuals.data_rows
    return max(stripe_rows(measured) + prior_rows - PARAMETERS, 0)


def edge_residuals(estimate: Estimate, measured: Measurements) -> Float64[Array, "visible"]:
    """Residuals of the visible edge points, less common errors, in standard deviations."""
    first = stripe_rows(measured)
    return estimate.remaining[first : first + len(measured.edges.edge)]


def stripe_rows(measured: Measurements) -> int:
    """Number of residuals of stripes and break points."""
    return 2 * len(measured.lines.laser) + len(measured.points.laser) + int(measured.points.isolated.sum())


def largest_reduction(estimate: Estimate, measured: Measurements) -> float:
    """By how much chi-squared would fall without the one number of stripes and break points that contradicts most.

    r^2 / (1 - h), with the leverage h = a M^-1 a^T of its row a in the joint problem of ring and common errors.
    """
    count = stripe_rows(measured)
    rows = np.concatenate([estimate.residuals.jacobian, estimate.nuisance], axis=1)
    information = (rows.T * estimate.weights) @ rows
    information[range(PARAMETERS, len(information)), range(PARAMETERS, len(information))] += 1.0
    information[range(PARAMETERS), range(PARAMETERS)] += 1e-9
    leverage = (np.linalg.solve(information, rows[:count].T) * rows[:count].T).sum(axis=0)
    free = leverage < 1.0 - 1e-3  # a number that determines a parameter alone contradicts nothing
    residual = estimate.remaining[:count]
    return float((residual[free] ** 2 / (1.0 - leverage[free])).max(initial=0.0))


def curvature_alone(estimate: Estimate) -> tuple[float, float]:
    """The curvature by the shot alone, without the prior, and its standard deviation.

    From the normal equations without the rows of the prior: at the solution the gradient of the data balances theirs.
    """
    residuals = estimate.residuals
    prior = residuals.jacobian[residuals.data_rows :]
    information = estimate.normal_matrix - prior.T @ prior + RIDGE * np.eye(PARAMETERS)
    try:
        covariance = np.linalg.inv(information)
    except np.linalg.LinAlgError:
        return 0.0, inf
    step = covariance @ (prior.T @ residuals.residual[residuals.data_rows :])
    variance = float(covariance[CURVATURE, CURVATURE])
    return estimate.arcs.curvature + float(step[CURVATURE]), sqrt(variance) if variance > 0 else inf
