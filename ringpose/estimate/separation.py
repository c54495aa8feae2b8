"""The solutions of a shot under all hypotheses of what may be wrong in it (ringpose-method(7), section 15).

The accepted solution and that under each fault (`ringpose.estimate.faults`), and under each pair of faults, follow from
one linearisation by one linear step, with the posterior probability of each: the multiple-hypothesis solution
separation of satellite navigation (Blanch et al., IEEE Trans. Aerospace and Electronic Systems 51, 2015), with Gaussian
priors of the faults instead of their exclusion.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate, combinations
from math import prod
from typing import NamedTuple

import numpy as np

from ringpose.estimate import covariance as joint
from ringpose.estimate.covariance import Quantities
from ringpose.estimate.faults import Fault, faults_of
from ringpose.estimate.hypotheses import Explanation
from ringpose.estimate.linearization import PARAMETERS, ring_residuals
from ringpose.estimate.nuisance import common_errors, nuisance_columns
from ringpose.estimate.solver import OUTLIER_SIGMAS, RIDGE
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.protection import CENTER, GRASP, INWARD, TILTS, Separation

MIN_PAIR_PROBABILITY = 1e-6
"""Prior probability of a pair of faults below which it is left to what no hypothesis covers."""


def solution_separation(best: Explanation, values: Quantities) -> Separation:
    """The solutions under all hypotheses, by one linear step from the ring of the best explanation.

    Under the hypothesis j the residuals are r + A x + E f, with the joint Jacobian A of ring and common errors, and the
    columns E of its faults. With the information M on f after the elimination of x, its score u and the sensitivity G
    of the quantities, f = -(1 + M)^-1 u, d = G^T (1 + M)^-1 u, the covariance grows by G^T (1 + M)^-1 G, and the
    evidence by the factor exp(u^T (1 + M)^-1 u / 2) / sqrt(det(1 + M)), the latter the Occam factor, Eqs. (15.1) and
    (15.2).
    """
    problem = _problem(best)
    faults, count = problem.faults, sum(fault.columns.shape[1] for fault in problem.faults)
    hypotheses = _hypotheses(
        tuple(fault.probability for fault in faults),
        tuple(fault.laser for fault in faults),
        tuple(fault.columns.shape[1] for fault in faults),
        problem.accepted,
    )
    errors = np.concatenate([*(fault.columns for fault in faults), np.zeros((len(problem.residual), 1))], axis=1)
    weighted = errors.T * problem.weights
    cross, directions = weighted @ problem.jacobian, directions_of(values, problem.jacobian.shape[1])
    solved = np.linalg.solve(problem.information, np.concatenate([cross, directions, problem.gradient[None]]).T)
    by_errors, by_quantities, step = solved[:, : count + 1], solved[:, count + 1 : -1], solved[:, -1]
    information = weighted @ errors - cross @ by_errors  # M
    seen = np.empty((count + 1, 1 + len(directions)))
    seen[:, 0] = weighted @ problem.residual - cross @ step  # u
    seen[:, 1:] = cross @ by_quantities  # G
    log_weight = hypotheses.log_prior.copy()
    shifted = np.zeros((len(log_weight), 1 + len(directions), 1 + len(directions)))  # [u G]^T (1 + M)^-1 [u G]
    for which, own in hypotheses.batches:
        matrix = information[own[:, :, None], own[:, None]] + np.eye(own.shape[1])
        shifted[which] = seen[own].swapaxes(1, 2) @ np.linalg.solve(matrix, seen[own])
        log_weight[which] -= 0.5 * np.linalg.slogdet(matrix)[1]
    log_weight += 0.5 * shifted[:, 0, 0]
    weight = np.exp(log_weight - log_weight.max())
    return Separation(
        faults=tuple(fault.name for fault in faults),
        sets=hypotheses.sets,
        weight=weight / weight.sum(),
        difference=shifted[:, 1:, 0] - shifted[0, 1:, 0],
        covariance=directions @ by_quantities + shifted[:, 1:, 1:],
        across=np.array([values.normal, values.outward]),
        radius_m=abs(values.radius_m.mean()),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Problem:
    """The problem of all measurements, linearised at the accepted ring, and what may be wrong in it."""

    faults: Sequence[Fault]
    accepted: tuple[int, ...]
    """The faults that the accepted explanation has."""
    residual: Float64[Array, "row"]
    weights: Float64[Array, "row"]
    jacobian: Float64[Array, "row parameter"]
    """By ring and common errors."""
    information: Float64[Array, "parameter parameter"]
    gradient: Float64[Array, "parameter"]


def _problem(best: Explanation) -> _Problem:
    """The problem in which what the explanation has left out is there again."""
    estimate, measured = best.estimate, best.measured
    left_out = [each for each in best.rejected if each.what in ("point", "stripe")]
    if not left_out or best.everything is None or any(each.what not in ("point", "stripe") for each in best.rejected):
        faults = faults_of(measured, estimate.residuals, estimate.prior, estimate.fixed)
        jacobian = np.concatenate([estimate.residuals.jacobian, estimate.nuisance], axis=1)
        return _Problem(
            faults=faults,
            accepted=(),
            residual=estimate.remaining,
            weights=estimate.weights,
            jacobian=jacobian,
            information=estimate.joint_information,
            gradient=np.zeros(jacobian.shape[1]),  # at its optimum
        )
    everything = best.everything[0]
    residuals = ring_residuals(estimate.arcs, everything.observations, estimate.prior, estimate.rates)
    fixed = common_errors(residuals, estimate.prior)
    jacobian = np.concatenate([residuals.jacobian, nuisance_columns(residuals, fixed)], axis=1)
    many = residuals.observations.many
    weights = np.ones(len(residuals.residual))
    weights[np.flatnonzero(many)] = np.abs(residuals.residual[np.flatnonzero(many)]) < OUTLIER_SIGMAS
    diagonal = np.ones(jacobian.shape[1])
    diagonal[:PARAMETERS] = RIDGE
    gradient = jacobian.T @ (weights * residuals.residual)
    gradient[PARAMETERS : PARAMETERS + len(residuals.rate_deviations)] += residuals.rate_deviations
    faults = faults_of(everything, residuals, estimate.prior, fixed)
    names = measured.rig.lasers.names
    accepted = set()
    for each in left_out:
        laser = names.index(str(each.laser))
        end = 4 * laser + 2 * each.opposite + (each.edge == "outer")
        accepted.add(f"stripe {laser}" if each.what == "stripe" else f"end {end}")
    return _Problem(
        faults=faults,
        accepted=tuple(number for number, fault in enumerate(faults) if fault.name in accepted),
        residual=residuals.residual,
        weights=weights,
        jacobian=jacobian,
        information=(jacobian.T * weights) @ jacobian + np.diag(diagonal),
        gradient=gradient,
    )


def directions_of(values: Quantities, parameters: int) -> Float64[Array, "quantity=8 parameter"]:
    """Derivatives of the separated quantities by ring and common errors."""
    jacobian = values.jacobian
    directions = np.zeros((8, parameters))
    directions[GRASP, :PARAMETERS] = np.array([values.normal, values.outward]) @ jacobian[joint.GRASP]
    directions[TILTS, :PARAMETERS] = jacobian[joint.TILTS]
    directions[CENTER, :PARAMETERS] = jacobian[joint.CENTER]
    directions[INWARD, :PARAMETERS] = -values.outward @ jacobian[joint.CENTER]
    return directions


class _Hypotheses(NamedTuple):
    """Sets of faults, the accepted one first, and the places of their columns among those of all faults."""

    sets: tuple[tuple[int, ...], ...]
    log_prior: Float64[Array, "hypothesis"]
    batches: tuple[tuple[Int64[Array, "member"], Int64[Array, "member column"]], ...]
    """Members of a batch and their columns; the place after the last column stands for none."""


@lru_cache(maxsize=64)
def _hypotheses(
    probabilities: tuple[float, ...], lasers: tuple[int, ...], widths: tuple[int, ...], accepted: tuple[int, ...]
) -> _Hypotheses:
    """What is accepted, nothing, each fault alone and with what is accepted, and pairs of faults.

    By the prior probabilities, the lasers and the numbers of columns of the faults, which hardly differ between shots.
    """
    of_accepted = prod(probabilities[number] for number in accepted)
    sets = {accepted: of_accepted, (): 1.0}
    for number, probability in enumerate(probabilities):
        sets[number,] = probability
        if number not in accepted:
            sets[tuple(sorted((*accepted, number)))] = probability * of_accepted
    for first, second in combinations(range(len(probabilities)), 2):
        probability = probabilities[first] * probabilities[second]
        same = lasers[first] == lasers[second] >= 0  # a stripe that is wrong has wrong ends
        if not same and probability >= MIN_PAIR_PROBABILITY:
            sets[first, second] = probability
    places = [range(end - width, end) for end, width in zip(accumulate(widths), widths, strict=True)]
    columns = [[place for fault in faults for place in places[fault]] for faults in sets]
    batches = []
    for width in sorted({len(own) for own in columns} - {0}):  # all with as many columns are solved at once
        which = [number for number, own in enumerate(columns) if len(own) == width]
        batches.append((np.array(which), np.array([columns[number] for number in which])))
    return _Hypotheses(tuple(sets), np.log(list(sets.values())), tuple(batches))
