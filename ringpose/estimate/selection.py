"""Which hypothesis explains a shot best: all measurements on one ring, or some of them wrong.

Six break points and three stripes give twelve numbers for seven parameters. If the ring that fits all of them fails the
chi-squared test, or misses one of them clearly, the shot is solved again for each of `ringpose.estimate.hypotheses`.
They are compared by chi-squared plus a penalty for what they reject, or for how much wider their priors are; one whose
penalty alone exceeds the score of another is not solved. (The normal equations of all measurements do not predict which
one it will be: a gross outlier moves the ring so far that they do not hold.)
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import inf, nan, sqrt
from typing import NamedTuple

import numpy as np

from ringpose.estimate.factors.edges import error_inflation
from ringpose.estimate.factors.prior import Prior
from ringpose.estimate.hypotheses import (
    MIN_DEVIATION_M,
    WIDER_BY,
    Explanation,
    Hypothesis,
    Solved,
    outlier_hypotheses,
    with_deviation,
)
from ringpose.estimate.measurements import Measurements
from ringpose.estimate.nuisance import form_amplitude_m, form_jacobian
from ringpose.estimate.ring_estimate import (
    DECISION_SIGMAS,
    MIN_FREEDOM,
    STRIPES_OF_A_PLANE,
    Estimate,
    chi2_quantile,
    contradicts_itself,
    estimate_ring,
    is_suspicious,
    reweighted_ring,
)
from ringpose.estimate.solver import ALARM_SIGMAS, PRECISE_SIGMAS
from ringpose.estimate.stripe_evidence import ring_evidence, single_stripe_estimates
from ringpose.geometry.ring import CURVATURE, RingArcs
from ringpose.optics.feature_errors import AGREEMENT
from ringpose.types.detection import JudgedRing, Rejection
from ringpose.types.finding import NOTHING, Finding

CONFIRMED_BELOW = 2.0
"""Largest ratio of the curvature's sigmas without and with the other end of a stripe (`_without_unconfirmed_end`)."""

WIDER = Finding.FASTER | Finding.MOVED | Finding.FRAME_DIFFERS | Finding.NOT_ROUND
"""Findings of explanations that reject nothing but need a wider prior."""

MAX_DEVIATION_M = 0.01
"""Largest deviation of a ring's form that is tried; one of more is not a launch-adapter ring."""


class Search(NamedTuple):
    """Settings that the estimates of all explanations of a shot share."""

    labelled: bool
    edges_named: bool
    for_pose: bool
    """Whether a pose follows, which needs all comparable explanations."""
    tolerance_sigmas: float = DECISION_SIGMAS
    """Estimated distance from the optimum at which each iteration ends."""
    start: JudgedRing | None = None
    """A ring near the one that explains all measurements with the edges as they are named, if it is known."""


def explained_as_named(
    measured: Measurements, prior: Prior, search: Search, *, guess: RingArcs | None = None, max_score: float = inf
) -> Explanation | None:
    """The best explanation with inner and outer edges as they are named.

    An explanation with a score above `max_score` is not necessarily the best one.
    """
    measured, estimate = _of_everything(measured, prior, search, guess)
    everything = None if estimate is None else Solved(Hypothesis(measured, prior, NOTHING, 0.0), estimate)
    if everything is not None and not is_suspicious(everything.estimate):
        best = _with_form(everything, search)
        return _explanation(best, everything, _single_stripes(best) if search.for_pose else [])
    hypotheses = sorted(outlier_hypotheses(measured, prior, search.labelled), key=lambda each: each.penalty)
    solved = partial(_solved, everything=everything, tolerance_sigmas=search.tolerance_sigmas)
    tried: list[Solved] = []
    lowest = inf if everything is None else min(everything.score, max_score)
    for hypothesis in hypotheses:
        if hypothesis.penalty > lowest + ALARM_SIGMAS**2:  # of this one and all that follow
            break
        other = solved(hypothesis)
        if other is not None:
            tried.append(other)
            lowest = min(lowest, other.score)
    if everything is None and not tried:
        return None

    def both_ends(laser: int) -> Solved | None:
        """The explanation that rejects both ends of a laser's stripe, whatever its score; None if there is none."""
        known = next((each for each in tried if each.hypothesis.rejects_both_ends(laser)), None)
        return known or next((solved(each) for each in hypotheses if each.rejects_both_ends(laser)), None)

    best, competing = _select(everything, tried, both_ends)
    best = _with_form(best, search)
    return _explanation(best, everything, [*competing, *_single_stripes(best)])


def _of_everything(
    measured: Measurements, prior: Prior, search: Search, guess: RingArcs | None
) -> tuple[Measurements, Estimate | None]:
    """The ring by all measurements, and these with the autocorrelation of the visible edges in their errors.

    The edges' residuals show it. From there the iteration goes on, unless a weak prior becomes necessary.
    """
    tolerance_sigmas = PRECISE_SIGMAS if search.for_pose else search.tolerance_sigmas
    edges = measured.edges
    first_sigmas = DECISION_SIGMAS if len(edges.edge) else tolerance_sigmas
    estimate = estimate_ring(measured, prior, search.start, guess=guess, tolerance_sigmas=first_sigmas)
    if estimate is None or not len(edges.edge):
        return measured, estimate
    residuals = estimate.residuals
    factor, many = np.ones(len(residuals.residual)), np.flatnonzero(residuals.observations.many)
    factor[many] = error_inflation(edges, estimate.edge_residuals)
    raised = replace(measured, edges=edges.with_sigmas_raised(factor[many]))
    again = reweighted_ring(estimate, raised, factor, tolerance_sigmas)
    if again is None or not (again.determined or again.prior.regularize_about is not None):
        again = estimate_ring(raised, prior, estimate, tolerance_sigmas=tolerance_sigmas)
    return raised, again


def _with_form(best: Solved, search: Search) -> Solved:
    """The explanation, with the smallest deviation of the ring's form that its edges and stripes do not contradict."""
    hypothesis, estimate = best.hypothesis, best.estimate
    if not search.for_pose or hypothesis.findings & (WIDER | Finding.UNEXPLAINED):
        return best
    deviation_m = max(WIDER_BY * hypothesis.prior.assumptions.ring_tolerance_m, MIN_DEVIATION_M)
    widened = best
    while deviation_m <= MAX_DEVIATION_M and _contradicts_form(widened, deviation_m):
        wider = with_deviation(hypothesis, deviation_m)
        again = estimate_ring(wider.measured, wider.prior, estimate, tolerance_sigmas=search.tolerance_sigmas)
        if again is None:
            break
        widened, deviation_m = Solved(wider, again), 2.0 * deviation_m
    return widened


def _contradicts_form(solved: Solved, deviation_m: float) -> bool:
    """Whether the residuals look like a deviation of the ring from circle and plane, by a score test, Eq. (12.2).

    Chi-squared of single rows, and the mean square of the edges, hardly show a wave along the whole edge. The score of
    the amplitudes is u = F^T W r ~ N(0, M) if the form is as assumed, with M the information on them after elimination
    of ring and common errors. For amplitudes with variance s^2 the test is u^T (1 / s^2 + M)^-1 u, a sum of squares
    whose weights are the eigenvalues of W = (1 / s^2 + M)^-1 M, and so nearly a multiple of chi-squared: with the
    expectation tr W and twice tr W^2 as variance.
    """
    estimate = solved.estimate
    residuals, weights = estimate.residuals, estimate.weights
    form = estimate.fixed.form
    if form is None:
        form = form_jacobian(residuals)
    form = form_amplitude_m(deviation_m) * form  # by amplitudes in units of s
    weighted = form.T * weights
    cross_information = weighted @ np.concatenate([residuals.jacobian, estimate.nuisance], axis=1)
    information = weighted @ form
    information -= cross_information @ np.linalg.solve(estimate.joint_information, cross_information.T)
    score = weighted @ estimate.remaining
    of_both = np.concatenate([information, score[:, None]], axis=1)
    columns = np.linalg.solve(np.eye(len(score)) + information, of_both)
    weight, standardized = columns[:, :-1], columns[:, -1]  # W, (1 / s^2 + M)^-1 u
    total = float(weight.trace())
    if total < MIN_FREEDOM:
        return False
    scale = float((weight * weight.T).sum()) / total
    return float(score @ standardized) > scale * chi2_quantile(total / scale, ALARM_SIGMAS)


def _solved(hypothesis: Hypothesis, everything: Solved | None, tolerance_sigmas: float) -> Solved | None:
    """A hypothesis with its ring; None if the arcs are not a ring, unless both ends of a stripe are rejected."""
    estimate = estimate_ring(hypothesis.measured, hypothesis.prior, tolerance_sigmas=tolerance_sigmas)
    if estimate is None:
        return None
    curvature_sd = sqrt(float(estimate.inverse[CURVATURE, CURVATURE]))
    is_ring = estimate.arcs.curvature > -ALARM_SIGMAS * curvature_sd and estimate.arcs.half_band_m > 0
    if not is_ring and Finding.WRONG_ENDS not in hypothesis.findings:
        return None
    wider = 0.0
    if everything is not None and hypothesis.findings & WIDER:
        # the likelihood of a wider prior: what it explains, less all that it could have explained
        assumed: Estimate | None = everything.estimate
        if hypothesis.measured is not everything.hypothesis.measured:  # a frame was left out as well
            prior = everything.hypothesis.prior
            assumed = estimate_ring(hypothesis.measured, prior, tolerance_sigmas=tolerance_sigmas)
        wider = 0.0 if assumed is None else max(estimate.log_determinant - assumed.log_determinant, 0.0)
    return Solved(hypothesis._replace(penalty=hypothesis.penalty + wider), estimate)


def _select(
    everything: Solved | None, tried: list[Solved], both_ends: Callable[[int], Solved | None]
) -> tuple[Solved, list[Solved]]:
    """The best of the explanations, and those that are comparable."""
    ranked = sorted([*([] if everything is None else [everything]), *tried], key=lambda each: each.score)
    near = [each for each in ranked if each.score < ranked[0].score + _margin(ranked[0], each)]
    best = _without_unconfirmed_end(_both_ends_if_either_is_suspect(near, both_ends) or near[0], both_ends)
    competing = [each for each in near if each is not best and not _nested(best, each)]
    if contradicts_itself(best.estimate):
        # nothing explains the shot: everything is kept, and the covariance grows by the differences
        best = everything or best
        inconsistent = best.hypothesis._replace(findings=best.hypothesis.findings | Finding.UNEXPLAINED)
        competing = [each for each in near if each is not best and each.score < best.score]
        return Solved(inconsistent, best.estimate), competing
    return best, competing


def _margin(best: Solved, other: Solved) -> float:
    """The margin in chi-squared by which the best hypothesis must beat another one.

    Two stripes nearly always agree with some ring. Which one of three stripes is rejected is then decided by a single
    degree of freedom, and a priori each of the three is as likely to be wrong. The same holds for visible edges: one
    stripe that was found elsewhere contradicts them, while three stripes alone still agree with some ring.
    """
    both_reject = Finding.WRONG_STRIPE in best.hypothesis.findings & other.hypothesis.findings
    two_left = len(best.hypothesis.measured.stripes) <= STRIPES_OF_A_PLANE
    without_edges = Finding.WRONG_EDGES in best.hypothesis.findings
    return ALARM_SIGMAS**2 if (both_reject and two_left) or without_edges else 2.0 * AGREEMENT


def _explanation(best: Solved, everything: Solved | None, competing: Sequence[Solved]) -> Explanation:
    hypothesis = best.hypothesis
    reduction = nan if everything is None else everything.estimate.chi2 - best.estimate.chi2
    findings = hypothesis.findings
    for each in competing:  # another assignment of the lasers is possible
        findings |= each.hypothesis.findings & Finding.WRONG_LASERS
    return Explanation(
        measured=hypothesis.measured,
        prior=hypothesis.prior,
        estimate=best.estimate,
        findings=findings,
        penalty=hypothesis.penalty,
        rejected=tuple(replace(each, chi2=reduction) for each in hypothesis.rejected),
        side_known=True,
        exchanged=hypothesis.exchanged,
        competing=tuple(each.estimate for each in competing),
        everything=None if everything is None else (everything.hypothesis.measured, everything.estimate),
    )


def _single_stripes(solved: Solved) -> list[Solved]:
    """Explanations by one stripe of two, the other one being on the background, if these are comparable.

    Light planes are nearly parallel, so that any two stripes lie nearly in a plane: two stripes have hardly any
    redundancy. Evidence for a common ring is only that the second stripe agrees with a precise prediction by the first.
    Visible edges are further evidence: for a common ring, or, if they were rejected, against it.
    """
    measured = solved.hypothesis.measured
    edges_contradict = Finding.WRONG_EDGES in solved.hypothesis.findings
    if len(measured.edges.edge) or len(measured.stripes) != STRIPES_OF_A_PLANE:
        return []
    if len(set(measured.points.laser[measured.points.opposite].tolist())) == STRIPES_OF_A_PLANE:
        return []  # four more ends on the same circles
    measured, assumptions = measured.once().of_one_arc(), solved.hypothesis.prior.assumptions
    common = estimate_ring(measured, solved.estimate.prior, solved.estimate, tolerance_sigmas=DECISION_SIGMAS)
    doubtful = [
        laser
        for laser in measured.stripes
        if edges_contradict or common is None or ring_evidence(common, measured, laser) < AGREEMENT
    ]
    explanations = []
    for laser, alone, estimate in single_stripe_estimates(measured, assumptions) if doubtful else ():
        if laser in doubtful:
            rejected = (Rejection(what="stripe", laser=measured.rig.lasers.names[laser]),)
            prior = Prior(assumptions=assumptions)
            hypothesis = Hypothesis(alone, prior, Finding.WRONG_STRIPE, 0.0, rejected, laser)
            explanations.append(Solved(hypothesis, estimate))
    return explanations


def _both_ends_if_either_is_suspect(near: list[Solved], both_ends: Callable[[int], Solved | None]) -> Solved | None:
    """The explanation that rejects both ends of a stripe, if rejecting either end alone is comparable; else None.

    Which of the two ends is off then depends on the ring's curvature.
    """
    points = [each for each in near if each.hypothesis.findings == Finding.WRONG_POINT]
    lasers = {each.hypothesis.laser for each in points}
    if points and near[0] is points[0] and len(points) > 1 and len(lasers) == 1:
        return both_ends(lasers.pop())
    return None


def _nested(best: Solved, other: Solved) -> bool:
    """Whether both explanations reject parts of one laser's stripe, and one of them the whole stripe or both its ends.

    Such explanations do not contradict each other.
    """
    first, second = best.hypothesis, other.hypothesis
    whole = (Finding.WRONG_ENDS | Finding.WRONG_STRIPE) & (first.findings | second.findings)
    return bool(whole) and first.laser == second.laser >= 0


def _without_unconfirmed_end(best: Solved, both_ends: Callable[[int], Solved | None]) -> Solved:
    """The explanation, or one without both ends of a stripe if only the other end determines the ring's curvature.

    What occluded one end may have occluded both; the other end is used only if the rest confirms the curvature.
    """
    hypothesis = best.hypothesis
    if hypothesis.findings != Finding.WRONG_POINT or hypothesis.cause_seen:
        return best
    without = both_ends(hypothesis.laser)
    if without is None:
        return best
    sd, sd_without = (sqrt(float(each.estimate.inverse[CURVATURE, CURVATURE])) for each in (best, without))
    return best if sd_without < CONFIRMED_BELOW * sd else without
