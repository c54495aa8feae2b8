"""Which explanation of a shot is the best one: all measurements on one ring, or some of them wrong.

Six break points and three stripes give twelve numbers for seven parameters. If the ring that fits all of them fails the
chi-squared test, or misses one of them clearly, the shot is solved again for each of `ringpose.estimate.hypotheses`.
They are compared by chi-squared plus a penalty for what they reject, or for how much wider their priors are; one whose
penalty alone exceeds the score of another is not solved. (The normal equations of all measurements do not predict which
one it will be: a gross outlier moves the ring so far that they do not hold.) Where two of them are comparable, only the
quantities that they have in common are determined (`Explanation.differing`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import atan2, inf, isfinite, log, nan, sqrt
from typing import NamedTuple

import numpy as np

from ringpose.estimate.covariance import differing_quantities
from ringpose.estimate.factors import PARAMETERS, Prior, form_jacobian, ring_residuals
from ringpose.estimate.hypotheses import (
    MIN_DEVIATION_M,
    WIDER_BY,
    Hypothesis,
    outlier_hypotheses,
    ring_evidence,
    single_stripe_estimates,
    with_deviation,
)
from ringpose.estimate.measurements import Measurements, error_inflation
from ringpose.estimate.nuisance import FORM_SHARE
from ringpose.estimate.solver import (
    DECISION_SIGMAS,
    OUTLIER_SIGMAS,
    PRECISE_SIGMAS,
    STRIPES_OF_A_PLANE,
    Estimate,
    estimate_ring,
    initial_guess,
    precise_ring,
    reweighted_ring,
)
from ringpose.geometry.ring import CURVATURE, EDGE_SIGN, HALF_BAND, RingArcs, motion_derivatives, rotation_by
from ringpose.geometry.rotations import cross
from ringpose.types.detection import JudgedRing, Rejection
from ringpose.types.finding import Finding
from ringpose.types.pose import KnownRadii

ALARM_SIGMAS = 3.0
"""Limit of the chi-squared test as a normal quantile: one right shot in seven hundred exceeds it by chance."""

SUSPICIOUS_REDUCTION = 20.0
"""Reduction of chi-squared by leaving out one number from which a shot is examined: one shot in ten thousand."""

DECISION_CHI2 = 0.1
"""Change of chi-squared from that of a decision to that of a pose from which the decision is repeated."""

CLEARLY = 6.0
"""Margin in chi-squared by which the best hypothesis must beat the others: a factor of 20 in likelihood."""

MORE_CLEARLY = ALARM_SIGMAS**2
"""The same where a single degree of freedom decides."""

SIDE_SIGMAS = 4.0
"""Curvature in standard deviations, or root of the margin in chi-squared, from which the centre's side is known."""

RADIUS_SIGMAS = 4.5
"""Difference in standard deviations from which assumed radii contradict the ring that a shot shows by itself."""

STRAIGHT_SIGMAS = 3.0
"""How many standard deviations a curvature may be below zero: two stripes alone hardly determine it."""

CONFIRMED_BELOW = 2.0
"""Largest ratio of the curvature's sigmas without and with the other end of a stripe (`_without_unconfirmed_end`)."""

WIDER = Finding.FASTER | Finding.MOVED | Finding.FRAME_DIFFERS | Finding.NOT_ROUND
"""Findings of explanations that reject nothing but need a wider prior."""

EDGE_NUMBERS = 8.0
"""Independent numbers that the visible edges count as when explanations are compared: one per correlation length."""

MAX_EDGE_MEAN_SQUARE = 2.0
"""Mean square of the whitened edge residuals from which visible edges contradict the rest. The standard deviations are
those of the fit to all measurements: 150 drawn shots without outliers have at most 1.05."""

MAX_DEVIATION_M = 0.01
"""Largest deviation of a ring's form that is tried; one of more is not a launch-adapter ring."""

MIN_FREEDOM = 0.1
"""Degrees of freedom of a test below which there is nothing to test."""

COINCIDENCE = 3.0
"""Log likelihood ratio from which two stripes agree with one ring too well for one of them to be on the background."""


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


class Solved(NamedTuple):
    """A hypothesis with the ring estimated under it."""

    hypothesis: Hypothesis
    estimate: Estimate

    @property
    def score(self) -> float:
        """Penalised chi-squared, visible edges included by their mean: less is better."""
        total = self.estimate.chi2 + self.hypothesis.penalty
        return total + EDGE_NUMBERS * max(edge_mean_square(self.estimate) - 1.0, 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Explanation:
    """The best explanation of a shot."""

    measured: Measurements
    """The measurements that it uses."""
    prior: Prior
    estimate: Estimate
    findings: Finding
    penalty: float
    """Penalty in chi-squared for what was rejected."""
    rejected: tuple[Rejection, ...]
    side_known: bool
    """Whether the shot determines on which side of the face the ring's centre lies."""
    exchanged: tuple[str, str] | None = None
    """Names of the lasers as which the stripes fit, and as which they were given; None if these are the same."""
    edges_exchanged: bool = False
    """Whether the inner edges are those that were given as outer ones."""
    competing: tuple[Estimate, ...] = ()
    """The rings of other explanations that are comparable ..."""
    other_side: Estimate | None = None
    """... and the one with inner and outer edges exchanged, if the shot does not determine which are the inner ones."""
    everything: tuple[Measurements, Estimate] | None = None
    """All measurements with the ring that fits them best; None if the iteration diverges."""

    differing: frozenset[str] = frozenset()
    """Quantities in which these rings differ: `center`, `normal`, `grasp`, `radius`, `velocity`; set for a pose."""


def explain(
    measured: Measurements,
    prior: Prior,
    *,
    labelled: bool,
    edges_named: bool,
    precise: bool = True,
    judged: JudgedRing | None = None,
) -> Explanation | None:
    """The best explanation of the measurements; None if no estimate converges.

    `labelled`: whether the lasers were identified by switching them. `edges_named`: whether it is known which edges are
    the inner ones; if it is not, or if the centre turns out to be on the other side, both ways are tried. `precise`:
    whether the ring is needed to the precision of a pose, and not only the decision. `judged`: the ring by which the
    break points were judged; the estimate from all measurements starts there.
    """
    guess, search = None, Search(labelled, edges_named, for_pose=precise)
    if precise:  # the decision is the same at any time
        measured, guess = _at_reference_time(measured, prior)
    if judged is not None:
        search = search._replace(start=judged)
    best = _decided(measured, prior, guess, search)
    if best is None or not precise:
        return best
    estimate: Estimate | None = best.estimate
    if best.estimate.distance_sigmas >= PRECISE_SIGMAS:
        estimate = precise_ring(best.estimate)
    if estimate is not None and abs(estimate.chi2 - best.estimate.chi2) < DECISION_CHI2:
        best = replace(best, estimate=estimate)
    else:  # the shorter iteration had ended near a saddle point
        best = _decided(measured, prior, guess, search._replace(tolerance_sigmas=PRECISE_SIGMAS))
    if best is None:
        return None
    best = _with_other_tilt(best)
    competing = (*best.competing, *([] if best.other_side is None else [best.other_side]))
    differing = frozenset[str]().union(*(differing_quantities(best.estimate, each) for each in competing))
    return replace(best, differing=differing)


def _with_other_tilt(best: Explanation) -> Explanation:
    """The explanation with that of the two tilts about a single stripe which fits better, and the other if it may hold.

    Only the visible edges show this tilt, and an ellipse is the image of two circles, whose normals are mirrored in the
    line of sight (Dhome et al., 1990): the one of the other tilt through the same stripe is tried.
    """
    measured, estimate = best.measured, best.estimate
    lasers = set(measured.observations.laser.tolist())
    if len(lasers) > 1 or not len(measured.edges.edge) or not estimate.determined:
        return best
    arcs, rates, normal = estimate.arcs, estimate.rates, estimate.arcs.axes[2]
    along = cross(measured.rig.lasers.normal[lasers.pop()], normal)
    along /= np.linalg.norm(along)
    sight = -arcs.center
    turn_rad = 2.0 * atan2(float(along @ cross(normal, sight)), float(normal @ sight))
    start = JudgedRing(
        origin_m=arcs.origin,
        axes=arcs.axes @ rotation_by(turn_rad * along).T,
        curvature_per_m=arcs.curvature,
        half_band_m=arcs.half_band_m,
        velocity_m_s=rates.velocity_m_s,
        rate_rad_s=rates.rate_rad_s,
        stamp_s=measured.reference_s if isfinite(measured.reference_s) else None,
    )
    other = estimate_ring(measured, best.prior, start)
    if other is None or not differing_quantities(estimate, other):
        return best
    of_both = [each.chi2 + EDGE_NUMBERS * float(np.square(each.edge_residuals).mean()) for each in (estimate, other)]
    if abs(of_both[1] - of_both[0]) > SIDE_SIGMAS**2:
        return best if of_both[0] < of_both[1] else replace(best, estimate=other)
    first, second = (estimate, other) if of_both[0] <= of_both[1] else (other, estimate)
    return replace(best, estimate=first, competing=(*best.competing, second))


def decision(measured: Measurements, prior: Prior, *, labelled: bool, edges_named: bool) -> Explanation | None:
    """The explanation of `explain` without the precision of a pose; None also if the normal equations are singular."""
    try:
        return explain(measured, prior, labelled=labelled, edges_named=edges_named, precise=False)
    except np.linalg.LinAlgError:
        return None


def _at_reference_time(measured: Measurements, prior: Prior) -> tuple[Measurements, RingArcs | None]:
    """The measurements with t_0 the mean of their stamps, weighted by the information on the ring's position.

    At this time pose and rates are least correlated (ringpose-method(7), section 8). Also the initial guess of the
    ring, None if it was not needed or there is none.
    """
    stamp_s, observations = measured.stamp_s, measured.observations
    first = float(stamp_s.min(initial=np.inf))
    if not 0.0 < float(stamp_s.max()) - first < np.inf:  # of a single instant, or unknown
        return measured, None
    arcs = initial_guess(measured, prior)
    if arcs is None:
        return measured, None
    residuals = ring_residuals(arcs, observations, Prior())
    rows = residuals.jacobian[: len(stamp_s)] @ motion_derivatives(arcs, arcs, 1.0)[:, PARAMETERS : PARAMETERS + 3]
    weight = (rows * rows).sum(axis=1)
    if not 0.0 < float(weight.sum()) < np.inf:
        return measured, arcs
    moved = replace(measured, reference_s=first + float(weight @ (stamp_s - first) / weight.sum()))
    covered = measured.camera is None or moved.observations.view.camera is not None  # by the robot's poses
    return (moved if covered else measured), arcs


def _decided(measured: Measurements, prior: Prior, guess: RingArcs | None, search: Search) -> Explanation | None:
    """The best explanation with the radii of the prior or, if the shot contradicts them, without."""
    best = _better_side(measured, prior, guess, search)
    if prior.radii is None or best is None or Finding.WRONG_RADIUS in best.findings:
        return best
    # visible edges are too many to be compared with two radii by chi-squared: the ring without the radii is, unless a
    # weak prior holds its radii, as that of a single stripe
    alone = _better_side(measured, prior._replace(radii=None), None, search)
    if alone is None or not alone.estimate.determined or not _contradicts(alone.estimate, prior.radii):
        return best
    return replace(
        alone,
        findings=alone.findings | Finding.WRONG_RADIUS,
        rejected=(*alone.rejected, Rejection(what="radius")),
    )


def _contradicts(alone: Estimate, radii: KnownRadii) -> bool:
    """Whether the ring estimated from the shot alone has other radii than the assumed ones.

    The curvatures of the edges, k = 1 / radius, are compared: their errors are Gaussian even where those of radii are
    not.
    """
    arcs = alone.arcs
    for radius_m, sign, assumed_m, sd_m in zip(
        arcs.radius_m.tolist(), EDGE_SIGN, radii.radius_m.tolist(), radii.sd_m.tolist(), strict=True
    ):
        if assumed_m != assumed_m:
            continue
        wrt_step = np.zeros(PARAMETERS)
        wrt_step[CURVATURE], wrt_step[HALF_BAND] = (arcs.mean_radius_m / radius_m) ** 2, -sign / radius_m**2
        variance = float(wrt_step @ alone.inverse @ wrt_step) + (sd_m / assumed_m**2) ** 2
        if (1.0 / radius_m - 1.0 / assumed_m) ** 2 > RADIUS_SIGMAS**2 * variance:
            return True
    return False


def _better_side(measured: Measurements, prior: Prior, guess: RingArcs | None, search: Search) -> Explanation | None:
    """The best explanation, with inner and outer edges as they are named or exchanged."""
    best, edges_named = _explained(measured, prior, search, guess=guess), search.edges_named
    search = search._replace(start=None)  # with edges exchanged it is another ring
    if best is not None:
        curvature, sd = best.estimate.curvature_alone
        # with unknown rates, both sides may explain a shot with a significant curvature each
        compared = len(best.estimate.residuals.rate_sds) and not len(measured.edges.edge) and not edges_named
        if curvature > (-SIDE_SIGMAS if edges_named else SIDE_SIGMAS) * sd and not compared:
            return best
        if not compared and _is_unique(best) and (curvature >= 0 or not search.for_pose):
            # with its edges exchanged this would be the same ring, with the opposite curvature
            return replace(best, edges_exchanged=curvature < 0, side_known=abs(curvature) > SIDE_SIGMAS * sd)
    max_score = inf if best is None else _side_score(best) + SIDE_SIGMAS**2
    other = _explained(measured.with_edges_exchanged(), prior, search, max_score=max_score)
    other = None if other is None else replace(other, edges_exchanged=True)
    if best is None or other is None:
        only = best or other
        return None if only is None else replace(only, side_known=False)
    first, second = sorted((best, other), key=_side_score)
    clear = _side_score(second) - _side_score(first) > SIDE_SIGMAS**2
    side_known = clear and not (edges_named and first.edges_exchanged)
    if clear:
        return replace(first, side_known=side_known)
    same = _left_out(first) == _left_out(second)
    competing = first.competing if same else (*first.competing, second.estimate)
    return replace(first, side_known=side_known, other_side=second.estimate, competing=competing)


def _left_out(explanation: Explanation) -> frozenset[tuple[str, str | None, bool]]:
    """The measurements that an explanation rejects, with edge names as given, to compare explanations of both sides."""
    other = "inner" if explanation.edges_exchanged else "outer"
    return frozenset((each.what, each.laser, each.edge in (other, None)) for each in explanation.rejected)


def _is_unique(best: Explanation) -> bool:
    """Whether an explanation rejects nothing, and no prior prefers one side of the ring: it has a single optimum."""
    prior = best.estimate.prior
    plain = best.everything is not None and best.everything[1] is best.estimate and not best.findings
    return plain and prior.regularize_about is None and not prior.single_edge and prior.radii is None


def _side_score(explanation: Explanation) -> float:
    """Penalised chi-squared, plus that of a negative curvature, with which the centre is on the wrong side."""
    estimate = explanation.estimate
    variance = float(estimate.inverse[CURVATURE, CURVATURE])
    score = estimate.chi2 + explanation.penalty
    return score + min(estimate.arcs.curvature, 0.0) ** 2 / variance


def _explained(
    measured: Measurements, prior: Prior, search: Search, *, guess: RingArcs | None = None, max_score: float = inf
) -> Explanation | None:
    """The best explanation with inner and outer edges as they are named.

    An explanation with a score above `max_score` is not necessarily the best one.
    """
    measured, estimate = _of_everything(measured, prior, search, guess)
    everything = None if estimate is None else Solved(Hypothesis(measured, prior), estimate)
    if everything is not None and not _is_suspicious(everything.estimate):
        best = _with_form(everything, search)
        return _explanation(best, everything, _single_stripes(best) if search.for_pose else [])
    hypotheses = sorted(outlier_hypotheses(measured, prior, search.labelled), key=lambda each: each.penalty)
    solved = partial(_solved, everything=everything, tolerance_sigmas=search.tolerance_sigmas)
    tried: list[Solved] = []
    lowest = inf if everything is None else min(everything.score, max_score)
    for hypothesis in hypotheses:
        if hypothesis.penalty > lowest + MORE_CLEARLY:  # of this one and all that follow
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
    with the weights w = s^2 m / (1 + s^2 m), m the eigenvalues of M, and so nearly a multiple of chi-squared.
    """
    estimate = solved.estimate
    residuals, weights = estimate.residuals, estimate.weights
    form = estimate.fixed.form
    if form is None:
        form = form_jacobian(residuals)
    form = FORM_SHARE * deviation_m * form  # by amplitudes in units of s
    weighted = form.T * weights
    cross_information = weighted @ np.concatenate([residuals.jacobian, estimate.nuisance], axis=1)
    information = weighted @ form
    information -= cross_information @ np.linalg.solve(estimate.joint_information, cross_information.T)
    size, axes = np.linalg.eigh(information)
    size = np.maximum(size, 0.0)
    weight = size / (1.0 + size)
    total = float(weight.sum())
    if total < MIN_FREEDOM:
        return False
    scores = axes.T @ (weighted @ estimate.remaining)
    scale = float(weight @ weight) / total
    return float((scores**2 / (1.0 + size)).sum()) > scale * chi2_quantile(total / scale, ALARM_SIGMAS)


def _solved(hypothesis: Hypothesis, everything: Solved | None, tolerance_sigmas: float) -> Solved | None:
    """A hypothesis with its ring; None if the arcs are not a ring, unless both ends of a stripe are rejected."""
    estimate = estimate_ring(hypothesis.measured, hypothesis.prior, tolerance_sigmas=tolerance_sigmas)
    if estimate is None:
        return None
    curvature_sd = sqrt(float(estimate.inverse[CURVATURE, CURVATURE]))
    is_ring = estimate.arcs.curvature > -STRAIGHT_SIGMAS * curvature_sd and estimate.arcs.half_band_m > 0
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
    if _contradicts_itself(best.estimate):
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
    return MORE_CLEARLY if (both_reject and two_left) or without_edges else CLEARLY


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
    measured = measured.once().of_one_arc()
    explanations = []
    assumptions = solved.hypothesis.prior.assumptions
    for laser, alone, estimate in single_stripe_estimates(measured, assumptions):
        evidence = max(ring_evidence(estimate, measured, laser), _evidence_with_radii(solved, measured, alone, laser))
        if edges_contradict or evidence < COINCIDENCE:
            rejected = (Rejection(what="stripe", laser=measured.rig.lasers.names[laser]),)
            prior = Prior(assumptions=assumptions)
            hypothesis = Hypothesis(alone, prior, Finding.WRONG_STRIPE, rejected=rejected, laser=laser)
            explanations.append(Solved(hypothesis, estimate))
    return explanations


def _evidence_with_radii(solved: Solved, measured: Measurements, alone: Measurements, laser: int) -> float:
    """The same evidence if the radii are assumed: then the other stripe, `alone`, predicts this one up to the side.

    With the radii, its length determines the angle at which it crosses the face, but not to which side: that of the
    common ring is one of two. Minus infinity if no radii are assumed.
    """
    prior = solved.hypothesis.prior
    if prior.radii is None or not bool(np.isfinite(prior.radii.radius_m).all()):
        return -inf
    radii = Prior(assumptions=prior.assumptions, radii=prior.radii)
    estimate = estimate_ring(alone, radii, solved.estimate, tolerance_sigmas=DECISION_SIGMAS)
    return -inf if estimate is None else ring_evidence(estimate, measured, laser) - log(2.0)


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


def _is_suspicious(estimate: Estimate) -> bool:
    """Whether the measurements contradict each other, or the ring would fit much better without one of its numbers."""
    return _contradicts_itself(estimate) or estimate.largest_reduction > SUSPICIOUS_REDUCTION


def _contradicts_itself(estimate: Estimate) -> bool:
    """Whether stripes and break points fail the chi-squared test of one ring, or the visible edges do not fit it.

    Visible edges are too many, and their errors too correlated, to be added to the few numbers of stripes and break
    points.
    """
    dof = estimate.expected_chi2
    fails_test = dof > MIN_FREEDOM and estimate.chi2 > chi2_quantile(dof, ALARM_SIGMAS)
    return fails_test or edge_mean_square(estimate) > MAX_EDGE_MEAN_SQUARE


def edge_mean_square(estimate: Estimate) -> float:
    """Mean square of the whitened edge residuals, each limited as in the robust fit; 0 without visible edges."""
    squares = np.minimum(estimate.edge_residuals**2, OUTLIER_SIGMAS**2)
    return float(squares.mean()) if len(squares) else 0.0


def chi2_quantile(degrees_of_freedom: float | int, sigmas: float) -> float:
    """Quantile of chi-squared at the probability of a normal quantile (Wilson and Hilferty 1931)."""
    spread = 2.0 / (9.0 * degrees_of_freedom)
    return degrees_of_freedom * (1.0 - spread + sigmas * sqrt(spread)) ** 3
