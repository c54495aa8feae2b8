"""Which explanation of a shot is the best one: all measurements on one ring, or some of them wrong.

Six break points and three stripes give twelve numbers for seven parameters. If the ring that fits all of them fails the
chi-squared test, or misses one of them clearly, the shot is solved again for the hypotheses of `outlier_hypotheses`:
one break point, a stripe, the visible edges, the assignment of the lasers, or the assumed radii are wrong; or the
target moves faster, or the ring is less perfect, than assumed. The hypotheses are compared by chi-squared plus a
penalty for what they reject, or for how much wider their priors are; one whose penalty alone exceeds the score of
another is not solved. (The normal equations of all measurements do not predict which one it will be: a gross outlier
moves the ring so far that they do not hold.) Where two of them are comparable, only the quantities that they have in
common are determined (`Explanation.differing`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import permutations, product
from math import inf, nan, sqrt
from typing import NamedTuple

import numpy as np

from ringpose.estimate.covariance import (
    CENTER,
    GRASP,
    RADII,
    TILTS,
    difference_from,
    joint_covariance,
    quantities,
    ring_velocity,
)
from ringpose.estimate.measurements import Measurements, inflate_sigma
from ringpose.estimate.residuals import PARAMETERS, Estimate, Prior
from ringpose.estimate.solver import (
    DECISION_SIGMAS,
    OUTLIER_SIGMAS,
    PRECISE_SIGMAS,
    STRIPES_OF_A_PLANE,
    at_reference_time,
    estimate_ring,
    precise_ring,
    predicted_residuals,
)
from ringpose.geometry.ring import CURVATURE, EDGE_SIGN, HALF_BAND, RingArcs, edge_distances
from ringpose.types.arrays import Array, Float64
from ringpose.types.assumptions import Assumptions, MotionPrior, motion_prior
from ringpose.types.detection import Rejection
from ringpose.types.pose import KnownRadii, PoseFlag
from ringpose.types.rig import Rig

PARAMETER_PENALTY = 4.0
"""Penalty in chi-squared for each rejected number; by chance, rejecting one lowers chi-squared by 1."""

OUTLIER_PENALTY = 12.0
"""Penalty for any rejection: a factor of 400 in likelihood."""

ALARM_SIGMAS = 3.0
"""Limit of the chi-squared test as a normal quantile: one right shot in seven hundred exceeds it by chance."""

SUSPICIOUS_REDUCTION = 20.0
"""Reduction of chi-squared by leaving out one number from which a shot is examined: one shot in ten thousand."""

BOTH_PENALTY = 18.0
"""Penalty for rejecting both break points of a stripe: two causes, or an occluder over both."""

OCCLUDED_PENALTY = 4.0
"""Penalty for rejecting a break point beside which the image shows a surface in front of the ring."""

RELABEL_PENALTY = 20.0
"""Penalty for exchanging lasers that were switched one by one; lower than for a stripe, as no number is rejected."""

DECISION_CHI2 = 0.1
"""Change of chi-squared from that of a decision to that of a pose from which the decision is repeated."""

CLEARLY = 6.0
"""Margin in chi-squared by which the best hypothesis must beat the others: a factor of 20 in likelihood."""

SIDE_SIGMAS = 4.0
"""Curvature in standard deviations, or root of the margin in chi-squared, from which the centre's side is known."""

RADIUS_SIGMAS = 4.5
"""Difference in standard deviations from which assumed radii contradict the ring that a shot shows by itself."""

RADIUS_REMARK = "the ring that was seen does not have the given radii; they were left out"
"""Reason in the record if assumed radii were rejected."""

STRAIGHT_SIGMAS = 3.0
"""How many standard deviations a curvature may be below zero: two stripes alone hardly determine it."""

CONFIRMED_BELOW = 2.0
"""Largest ratio of the curvature's sigmas without and with the other end of a stripe (`_without_unconfirmed_end`)."""

WIDER = PoseFlag.MOTION | PoseFlag.RING_FORM
"""Flags of explanations that reject nothing but need a wider prior."""

MAX_PERMUTED = 3
"""Number of lasers up to which all assignments are tried."""

WIDER_BY = 4.0
"""Factor on the standard deviations of that prior."""

MIN_DEVIATION_M = 0.001
"""Smallest standard deviation of a ring's edges and face in an explanation by the ring's form."""

EDGE_NUMBERS = 8.0
"""Independent numbers that the visible edges count as when explanations are compared: one per correlation length."""

MAX_EDGE_MEAN_SQUARE = 2.0
"""Mean square of the whitened edge residuals from which visible edges contradict the rest. The standard deviations are
those of the fit to all measurements: 150 drawn shots without outliers have at most 1.05."""

BACKGROUND_RANGE_PX = (150.0, 30.0, 100.0, 100.0)
"""Where a stripe on the background may be seen: range of its line's position, of the change along it, of its ends."""

COINCIDENCE = 3.0
"""Log likelihood ratio from which two stripes agree with one ring too well for one of them to be on the background."""

DIFFERS = 4.0
"""Squared Mahalanobis distance, per degree of freedom, from which two explanations differ in a quantity."""


class Hypothesis(NamedTuple):
    """An explanation of a shot before its ring is estimated."""

    measured: Measurements
    prior: Prior
    flag: PoseFlag = PoseFlag(0)
    remark: str = ""
    penalty: float = 0.0
    """In chi-squared."""
    rejected: tuple[Rejection, ...] = ()
    laser: int = -1
    """Laser of the rejected break points or stripe; -1 if there is none."""
    both: bool = False
    """Whether both break points of the stripe were rejected."""
    cause_seen: bool = False
    """Whether the image shows what occludes the rejected break point, and nothing at the stripe's other end."""


class Search(NamedTuple):
    """What all explanations of a shot are estimated with."""

    rig: Rig
    labelled: bool
    edges_named: bool
    for_pose: bool
    """Whether a pose follows, which needs all comparable explanations."""
    max_left: float = DECISION_SIGMAS
    """Length of the steps that are left at the end of each estimate, in standard deviations."""


class Solved(NamedTuple):
    """A hypothesis with its ring."""

    hypothesis: Hypothesis
    estimate: Estimate

    @property
    def score(self) -> float:
        """Penalised chi-squared, visible edges included by their mean: less is better."""
        total = self.estimate.chi2 + self.hypothesis.penalty
        return total + EDGE_NUMBERS * max(_edge_mean_square(self.estimate) - 1.0, 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Explanation:
    """The best explanation of a shot."""

    measured: Measurements
    """The measurements that it uses."""
    prior: Prior
    estimate: Estimate
    flag: PoseFlag
    remark: str
    penalty: float
    """In chi-squared, for what was rejected."""
    rejected: tuple[Rejection, ...]
    side_known: bool
    """Whether the shot determines on which side of the face the ring's centre lies."""
    edges_exchanged: bool = False
    """Whether the inner edges are those that were given as outer ones."""
    competing: tuple[Estimate, ...] = ()
    """The rings of other explanations that are comparable ..."""
    other_side: Estimate | None = None
    """... and the one with inner and outer edges exchanged, if the shot does not determine which are the inner ones."""
    everything: tuple[Measurements, Estimate] | None = None
    """All measurements with the ring that fits them best; None if the iteration diverges."""

    @cached_property
    def differing(self) -> frozenset[str]:
        """Quantities in which these rings differ: `center`, `normal`, `grasp`, `radius`, `velocity`."""
        rivals = (*self.competing, *([] if self.other_side is None else [self.other_side]))
        return frozenset[str]().union(*(differing_quantities(self.estimate, each) for each in rivals))


def explain(
    measured: Measurements, rig: Rig, prior: Prior, *, labelled: bool, edges_named: bool, precise: bool = True
) -> Explanation | None:
    """The best explanation of the measurements; None if no estimate converges.

    `labelled`: whether the lasers were identified by switching them. `edges_named`: whether it is known which edges are
    the inner ones; if it is not, or if the centre turns out to be on the other side, both ways are tried. `precise`:
    whether the ring is needed to the precision of a pose, and not only the decision.
    """
    guess, search = None, Search(rig, labelled, edges_named, for_pose=precise)
    if precise:  # the decision is the same at any time
        measured, guess = at_reference_time(measured, rig.lasers, prior)
    best = _decided(measured, prior, guess, search)
    if best is None or not precise:
        return best
    estimate = precise_ring(best.estimate, best.measured, rig)
    if estimate is not None and abs(estimate.chi2 - best.estimate.chi2) < DECISION_CHI2:
        return replace(best, estimate=estimate)
    # the shorter iteration had ended near a saddle point
    return _decided(measured, prior, guess, search._replace(max_left=PRECISE_SIGMAS))


def _decided(measured: Measurements, prior: Prior, guess: RingArcs | None, search: Search) -> Explanation | None:
    """The best explanation with the radii of the prior or, if the shot contradicts them, without."""
    best = _better_side(measured, prior, guess, search)
    if prior.radii is None or best is None or PoseFlag.RADIUS_INCONSISTENT in best.flag:
        return best
    # visible edges are too many to be compared with two radii by chi-squared: the ring without the radii is
    alone = _better_side(measured, prior._replace(radii=None), None, search)
    if alone is None or not _contradicts(alone.estimate, prior.radii):
        return best
    return replace(
        alone,
        flag=alone.flag | PoseFlag.RADIUS_INCONSISTENT,
        remark=RADIUS_REMARK,
        rejected=(*alone.rejected, Rejection(what="radius")),
    )


def _contradicts(alone: Estimate, radii: KnownRadii) -> bool:
    """Whether the ring by the shot alone has other radii than the assumed ones.

    Compared by the curvature of each edge, k = 1 / radius: its errors are Gaussian even where those of radii are not.
    """
    arcs = alone.arcs
    for radius_m, sign, assumed_m, sd_m in zip(
        arcs.radius_m.tolist(), EDGE_SIGN, radii.radius_m.tolist(), radii.sd_m.tolist(), strict=True
    ):
        if assumed_m != assumed_m:
            continue
        by_step = np.zeros(PARAMETERS)
        by_step[CURVATURE], by_step[HALF_BAND] = (arcs.mean_radius_m / radius_m) ** 2, -sign / radius_m**2
        variance = float(by_step @ alone.inverse @ by_step) + (sd_m / assumed_m**2) ** 2
        if (1.0 / radius_m - 1.0 / assumed_m) ** 2 > RADIUS_SIGMAS**2 * variance:
            return True
    return False


def _better_side(measured: Measurements, prior: Prior, guess: RingArcs | None, search: Search) -> Explanation | None:
    """The best explanation, with inner and outer edges as they are named or exchanged."""
    best, edges_named = _explained(measured, prior, search, guess=guess), search.edges_named
    if best is not None:
        curvature, sd = best.estimate.curvature_alone
        # with unknown rates, both sides may explain a shot with a significant curvature each
        compared = len(best.estimate.residuals.rate_sds) and not len(measured.edges.edge) and not edges_named
        if curvature > (-SIDE_SIGMAS if edges_named else SIDE_SIGMAS) * sd and not compared:
            return best
    max_score = inf if best is None else _side_score(best) + SIDE_SIGMAS**2
    other = _explained(measured.with_edges_exchanged(), prior, search, max_score=max_score)
    other = None if other is None else replace(other, edges_exchanged=True)
    if best is None or other is None:
        only = best or other
        return None if only is None else replace(only, side_known=False)
    first, second = sorted((best, other), key=_side_score)
    clear = _side_score(second) - _side_score(first) > SIDE_SIGMAS**2
    side_known = clear and not (edges_named and first.edges_exchanged)
    return replace(first, side_known=side_known, other_side=None if clear else second.estimate)


def _side_score(explanation: Explanation) -> float:
    """Penalised chi-squared, and that of a negative curvature, which puts the centre on the wrong side."""
    estimate = explanation.estimate
    variance = float(estimate.inverse[CURVATURE, CURVATURE])
    score = estimate.chi2 + explanation.penalty
    return score + min(estimate.arcs.curvature, 0.0) ** 2 / variance


def _explained(
    measured: Measurements, prior: Prior, search: Search, *, guess: RingArcs | None = None, max_score: float = inf
) -> Explanation | None:
    """The best explanation with inner and outer edges as they are named; it need not be the best above `max_score`."""
    rig, edges_seen = search.rig, len(measured.edges.edge) > 0
    estimate = estimate_ring(measured, rig, prior, guess=guess, max_left=search.max_left)
    if estimate is not None and edges_seen:
        measured = replace(measured, edges=inflate_sigma(measured.edges, estimate.edge_residuals))
        max_left = PRECISE_SIGMAS if search.for_pose else search.max_left
        estimate = estimate_ring(measured, rig, prior, estimate, guess=guess, max_left=max_left)
    everything = None if estimate is None else Solved(Hypothesis(measured, prior), estimate)
    if everything is not None and not _is_suspicious(everything):
        return _explanation(everything, everything, _single_stripes(everything, rig) if search.for_pose else [])
    hypotheses = sorted(outlier_hypotheses(measured, rig, prior, search.labelled), key=lambda each: each.penalty)
    solved = partial(_solved, everything=everything, rig=rig, max_left=search.max_left)
    tried = _possibly_best(hypotheses, solved, inf if everything is None else min(everything.score, max_score))
    if everything is None and not tried:
        return None

    def both_ends(laser: int) -> Solved | None:
        """The explanation that rejects both ends of a laser's stripe, also if it is not nearly the best one."""
        known = [each for each in tried if each.hypothesis.both and each.hypothesis.laser == laser]
        others = (each for each in hypotheses if each.both and each.laser == laser)
        return known[0] if known else next((solved(each) for each in others), None)

    best, rivals = _select(everything, tried, both_ends)
    return _explanation(best, everything, [*rivals, *_single_stripes(best, rig)])


def _possibly_best(
    hypotheses: Sequence[Hypothesis], solved: Callable[[Hypothesis], Solved | None], lowest: float
) -> list[Solved]:
    """The hypotheses that may be the best one or comparable to it: the penalty of the others alone exceeds its score.

    `hypotheses`: in the order of their penalties. `lowest`: score of the best explanation that is known.
    """
    tried: list[Solved] = []
    for hypothesis in hypotheses:
        if hypothesis.penalty > lowest + CLEARLY:
            break
        found = solved(hypothesis)
        if found is not None:
            tried.append(found)
            lowest = min(lowest, found.score)
    return tried


def _solved(hypothesis: Hypothesis, everything: Solved | None, rig: Rig, max_left: float) -> Solved | None:
    """A hypothesis with its ring; None if the arcs are not a ring, unless both ends of a stripe are rejected."""
    estimate = estimate_ring(hypothesis.measured, rig, hypothesis.prior, max_left=max_left)
    if estimate is None or not (_is_ring(estimate) or hypothesis.both):
        return None
    wider = 0.0
    if everything is not None and hypothesis.flag & WIDER:
        # the likelihood of a wider prior: what it explains, less all that it could have explained
        wider = max(estimate.log_determinant - everything.estimate.log_determinant, 0.0)
    return Solved(hypothesis._replace(penalty=hypothesis.penalty + wider), estimate)


def _select(
    everything: Solved | None, tried: list[Solved], both_ends: Callable[[int], Solved | None]
) -> tuple[Solved, list[Solved]]:
    """The best of the explanations, and its comparable rivals."""
    near = _nearly_best([*([] if everything is None else [everything]), *tried])
    best = _without_unconfirmed_end(_both_ends_if_either_is_suspect(near, both_ends) or near[0], both_ends)
    rivals = [each for each in near if each is not best and not _nested(best, each)]
    if _contradicts_itself(best.estimate):
        # nothing explains the shot: everything is kept, and the covariance grows by the differences
        best = everything or best
        remark = "what was seen disagrees with one ring by more than its errors, and no single part is to blame"
        if best.hypothesis.remark:
            remark = f"{best.hypothesis.remark}, but the rest disagrees, too"
        inconsistent = best.hypothesis._replace(flag=best.hypothesis.flag | PoseFlag.INCONSISTENT, remark=remark)
        rivals = [each for each in near if each is not best and each.score < best.score]
        return Solved(inconsistent, best.estimate), rivals
    return best, rivals


def _explanation(best: Solved, everything: Solved | None, rivals: Sequence[Solved]) -> Explanation:
    hypothesis = best.hypothesis
    reduction = nan if everything is None else everything.estimate.chi2 - best.estimate.chi2
    flag = hypothesis.flag
    for each in rivals:  # another assignment of the lasers is possible
        flag |= each.hypothesis.flag & PoseFlag.ASSIGNMENT_AMBIGUOUS
    return Explanation(
        measured=hypothesis.measured,
        prior=hypothesis.prior,
        estimate=best.estimate,
        flag=flag,
        remark=hypothesis.remark,
        penalty=hypothesis.penalty,
        rejected=tuple(replace(each, chi2=reduction) for each in hypothesis.rejected),
        side_known=True,
        competing=tuple(each.estimate for each in rivals),
        everything=None if everything is None else (everything.hypothesis.measured, everything.estimate),
    )


def differing_quantities(best: Estimate, rival: Estimate) -> frozenset[str]:
    """In which quantities two explanations differ by more than the errors of the best one."""
    found, other = quantities(best), quantities(rival)
    covariance = joint_covariance(best, found)
    difference = difference_from(rival, other, best, found)
    # the grasp points lie at different places along the face: how far the best one is from the rival's ring
    height_m = float(rival.arcs.normal @ (found.grasp_m - rival.arcs.origin))
    radial = edge_distances(rival.arcs, (found.grasp_m / found.grasp_m[2])[None], np.zeros(1))
    across = np.array([best.arcs.normal, found.outward])
    tested = {
        "center": (difference[CENTER], covariance[CENTER, CENTER]),
        "normal": (difference[TILTS], covariance[TILTS, TILTS]),
        "grasp": (np.array([height_m, float(radial.distance_m[0])]), across @ covariance[GRASP, GRASP] @ across.T),
        "radius": (difference[RADII], covariance[RADII, RADII]),
    }
    velocity, of_rival = ring_velocity(best), ring_velocity(rival)
    if velocity is not None and of_rival is not None:
        change = of_rival.center_m_s - velocity.center_m_s
        tested["velocity"] = (change, velocity.covariance[:3, :3])
    return frozenset(name for name, (by, of) in tested.items() if not _within(by, of))


def _within(difference: Float64[Array, "n"], covariance: Float64[Array, "n n"]) -> bool:
    """Whether a difference is within `DIFFERS` of the errors; false for numbers that are not finite."""
    if not bool(np.isfinite(difference).all() and np.isfinite(covariance).all()):
        return False
    squared = float(difference @ np.linalg.pinv(covariance, hermitian=True) @ difference)
    return squared <= DIFFERS * len(difference)


def _single_stripes(solved: Solved, rig: Rig) -> list[Solved]:
    """Explanations by one stripe of two, the other one being on the background, if these are comparable.

    Light planes are nearly parallel, so that any two stripes lie nearly in a plane: two stripes have hardly any
    redundancy. Only that the second one agrees with the prediction by the first one, if that is precise, is evidence
    for a common ring. Visible edges are further evidence: for it, or, if they were rejected, against it.
    """
    measured = solved.hypothesis.measured
    edges_contradict = PoseFlag.EDGE_REJECTED in solved.hypothesis.flag
    if len(measured.edges.edge) or len(measured.stripes) != STRIPES_OF_A_PLANE:
        return []
    measured = measured.once()
    found = []
    assumptions = solved.hypothesis.prior.assumptions
    for laser, alone, estimate in single_stripe_estimates(measured, rig, assumptions):
        if edges_contradict or ring_evidence(estimate, measured, laser, rig) < COINCIDENCE:
            rejected = (Rejection(what="stripe", laser=rig.lasers.names[laser]),)
            prior = Prior(assumptions=assumptions)
            hypothesis = Hypothesis(alone, prior, PoseFlag.STRIPE_REJECTED, rejected=rejected, laser=laser)
            found.append(Solved(hypothesis, estimate))
    return found


def single_stripe_estimates(
    measured: Measurements, rig: Rig, assumptions: Assumptions
) -> Iterator[tuple[int, Measurements, Estimate]]:
    """For each of two stripes its laser, and measurements and ring without it; nothing for other numbers of stripes.

    Assumed radii are not used: with them the length of one stripe determines the angle at which it crosses the face,
    but not to which side.
    """
    for laser in measured.stripes if len(measured.stripes) == STRIPES_OF_A_PLANE else []:
        alone = measured.without_laser(laser)
        if not len(alone.points.x):
            continue
        estimate = estimate_ring(alone, rig, Prior(assumptions=assumptions), max_left=DECISION_SIGMAS)
        if estimate is not None:
            yield laser, alone, estimate


def ring_evidence(estimate: Estimate, measured: Measurements, laser: int, rig: Rig) -> float:
    """Log likelihood ratio of a laser's stripe on the ring that another stripe predicts, against one anywhere.

    ln N(r; 0, C) - ln(1 / range): r are the stripe's whitened residuals at the prediction, C is their covariance.
    """
    line = np.flatnonzero(np.repeat(measured.lines.laser == laser, 2))
    points = np.flatnonzero(measured.points.laser == laser)
    rows = np.concatenate([line, 2 * len(measured.lines.laser) + points])
    residual, covariance = predicted_residuals(estimate, measured, rig)
    residual, covariance = residual[rows], covariance[np.ix_(rows, rows)]
    log_ring = -0.5 * (
        residual @ np.linalg.solve(covariance, residual) + np.linalg.slogdet(2.0 * np.pi * covariance)[1]
    )
    # the same range in standard deviations
    focal = rig.camera.camera_matrix[[0, 1], [0, 1]]
    whitening = measured.lines.whitening[measured.lines.laser == laser][0]
    sigma_px = measured.points.sigma_x[points] * focal[0]
    log_range = np.log(BACKGROUND_RANGE_PX[: len(rows)]).sum()
    log_range += np.linalg.slogdet(whitening)[1] - 2.0 * np.log(focal[1]) - np.log(sigma_px).sum()
    return float(log_ring + log_range)


def outlier_hypotheses(measured: Measurements, rig: Rig, prior: Prior, labelled: bool) -> Iterator[Hypothesis]:
    """One break point, both of a stripe, a stripe, the visible edges, the assignment of the lasers, the radii wrong."""
    yield from _wrong_points(measured, rig, prior)
    yield from _wrong_stripes(measured, rig, prior)
    yield from _wrong_assignments(measured, rig, prior, labelled)
    if len(measured.edges.edge):
        remark = "the visible edges contradict the stripes and were left out"
        penalty = OUTLIER_PENALTY + 2 * PARAMETER_PENALTY
        flag, rejected = PoseFlag.EDGE_REJECTED, (Rejection(what="edge"),)
        yield Hypothesis(measured.without_edges(), prior, flag, remark, penalty, rejected)
    if prior.radii is not None:
        penalty = OUTLIER_PENALTY + PARAMETER_PENALTY  # one cause: the wrong ring was named
        flag, rejected = PoseFlag.RADIUS_INCONSISTENT, (Rejection(what="radius"),)
        yield Hypothesis(measured, prior._replace(radii=None), flag, RADIUS_REMARK, penalty, rejected)
    yield from _wider_priors(measured, prior)


def _wider_priors(measured: Measurements, prior: Prior) -> Iterator[Hypothesis]:
    """The target moves faster, or the ring is less round and flat, than assumed: nothing is rejected."""
    motion, tolerance_m = prior.assumptions.motion, prior.assumptions.ring_tolerance_m
    times_s = measured.times_s(measured.stamp_s)
    if times_s.any():
        least, assumed = motion_prior(), motion_prior(0.0, 0.0) if motion is None else motion
        faster = MotionPrior(
            speed_sd_m_s=WIDER_BY * max(least.speed_sd_m_s, assumed.speed_sd_m_s),
            rate_sd_rad_s=WIDER_BY * max(least.rate_sd_rad_s, assumed.rate_sd_rad_s),
        )
        remark = "the target moved within the shot" if motion is None else "the target moves faster than assumed"
        assumptions = replace(prior.assumptions, motion=faster)
        yield Hypothesis(measured, prior._replace(assumptions=assumptions), PoseFlag.MOTION, remark, OUTLIER_PENALTY)
    deviation_m = max(WIDER_BY * tolerance_m, MIN_DEVIATION_M)
    remark = "the ring deviates from a circle or a plane by more than assumed"
    assumptions = replace(prior.assumptions, ring_tolerance_m=deviation_m)
    yield Hypothesis(measured, prior._replace(assumptions=assumptions), PoseFlag.RING_FORM, remark, OUTLIER_PENALTY)


def _wrong_points(measured: Measurements, rig: Rig, prior: Prior) -> Iterator[Hypothesis]:
    points, flag = measured.points, PoseFlag.POINT_REJECTED
    for laser in sorted(set(points.laser.tolist())):
        of_laser, name = np.flatnonzero(points.laser == laser), rig.lasers.names[laser]
        rejected = tuple(
            Rejection(what="point", laser=name, edge="outer" if points.edge[number] else "inner")
            for number in of_laser.tolist()
        )
        for number, rejection in zip(of_laser.tolist(), rejected, strict=True):
            rest = measured.with_points(np.arange(len(points.laser)) != number)
            remark = f"the {rejection.edge} break point of laser {name} contradicts the others and was left out"
            occluded = bool(points.beside_occluder[number])
            penalty = PARAMETER_PENALTY + (OCCLUDED_PENALTY if occluded else OUTLIER_PENALTY)
            alone = occluded and int(points.beside_occluder[of_laser].sum()) == 1
            yield Hypothesis(rest, prior, flag, remark, penalty, (rejection,), laser, cause_seen=alone)
        if len(of_laser) > 1:
            rest = measured.with_points(points.laser != laser)
            remark = f"a break point of laser {name} contradicts the others; both were left out"
            penalty = BOTH_PENALTY + PARAMETER_PENALTY * (measured.stripe_numbers - rest.stripe_numbers)
            yield Hypothesis(rest, prior, flag, remark, penalty, tuple(dict.fromkeys(rejected)), laser, both=True)


def _wrong_stripes(measured: Measurements, rig: Rig, prior: Prior) -> Iterator[Hypothesis]:
    seen = measured.lasers
    for laser in seen if len(seen) > 1 else []:
        rest, name = measured.without_laser(laser), rig.lasers.names[laser]
        penalty = OUTLIER_PENALTY + PARAMETER_PENALTY * (measured.stripe_numbers - rest.stripe_numbers)
        remark = f"the stripe of laser {name} contradicts the others and was left out"
        rejected = (Rejection(what="stripe", laser=name),)
        yield Hypothesis(rest, prior, PoseFlag.STRIPE_REJECTED, remark, penalty, rejected, laser)


def _wrong_assignments(measured: Measurements, rig: Rig, prior: Prior, labelled: bool) -> Iterator[Hypothesis]:
    seen, names = measured.lasers, rig.lasers.names
    for order in _assignments(seen, len(names)):
        if list(order) != seen:
            changed = measured.relabelled(dict(zip(seen, order, strict=True)))
            given, fitting = (", ".join(names[laser] for laser in lasers) for lasers in (seen, order))
            remark = f"the stripes fit one ring only as those of lasers {fitting}, not {given}"
            penalty = RELABEL_PENALTY if labelled else OUTLIER_PENALTY
            rejected = (Rejection(what="assignment"),)
            yield Hypothesis(changed, prior, PoseFlag.ASSIGNMENT_AMBIGUOUS, remark, penalty, rejected)


def _assignments(seen: list[int], lasers: int) -> Iterator[Sequence[int]]:
    """All assignments of the seen stripes to lasers; of more than three lasers those that differ in one or two."""
    if lasers <= MAX_PERMUTED:
        yield from permutations(range(lasers), len(seen))
        return
    for place, other in product(range(len(seen)), range(lasers)):
        order = seen.copy()
        if other in seen:
            order[seen.index(other)] = seen[place]
        order[place] = other
        if other not in seen or seen.index(other) > place:
            yield order


def _is_ring(estimate: Estimate) -> bool:
    """Whether the curvature is positive within its errors, and the inner edge is inside the outer one."""
    curvature_sd = sqrt(float(estimate.inverse[CURVATURE, CURVATURE]))
    return estimate.arcs.curvature > -STRAIGHT_SIGMAS * curvature_sd and estimate.arcs.half_band_m > 0


def _nearly_best(tried: Sequence[Solved]) -> list[Solved]:
    """The best explanation, and those that it does not beat clearly, in order of their scores."""
    ranked = sorted(tried, key=lambda each: each.score)
    return [each for each in ranked if each.score < ranked[0].score + CLEARLY]


def _both_ends_if_either_is_suspect(near: list[Solved], both_ends: Callable[[int], Solved | None]) -> Solved | None:
    """Both ends of a stripe rejected, if either is equally suspect: with another curvature the other one is off."""
    points = [each for each in near if each.hypothesis.flag == PoseFlag.POINT_REJECTED and not each.hypothesis.both]
    lasers = {each.hypothesis.laser for each in points}
    if points and near[0] is points[0] and len(points) > 1 and len(lasers) == 1:
        return both_ends(lasers.pop())
    return None


def _nested(best: Solved, other: Solved) -> bool:
    """Whether both reject parts of the same laser, and one its whole stripe or both its points: no contradiction."""
    first, second = best.hypothesis, other.hypothesis
    whole = first.both or second.both or PoseFlag.STRIPE_REJECTED in first.flag | second.flag
    return whole and first.laser == second.laser >= 0


def _without_unconfirmed_end(best: Solved, both_ends: Callable[[int], Solved | None]) -> Solved:
    """The same, or without the other end of the stripe, too, if only that end determines the ring's curvature.

    What occluded one end may have occluded both; the other one is used only if the rest confirms the curvature.
    """
    hypothesis = best.hypothesis
    if hypothesis.flag != PoseFlag.POINT_REJECTED or hypothesis.both or hypothesis.cause_seen:
        return best
    without = both_ends(hypothesis.laser)
    if without is None:
        return best
    sd, sd_without = (sqrt(float(each.estimate.inverse[CURVATURE, CURVATURE])) for each in (best, without))
    return best if sd_without < CONFIRMED_BELOW * sd else without


def _is_suspicious(solved: Solved) -> bool:
    """Whether the measurements contradict each other, or the ring would fit much better without one of its numbers."""
    estimate = solved.estimate
    return _contradicts_itself(estimate) or estimate.largest_reduction > SUSPICIOUS_REDUCTION


def _contradicts_itself(estimate: Estimate) -> bool:
    """Whether stripes and break points do not fit one ring, or the visible edges do not fit it."""
    return fails_chi2_test(estimate) or _edge_mean_square(estimate) > MAX_EDGE_MEAN_SQUARE


def _edge_mean_square(estimate: Estimate) -> float:
    """Mean square of the whitened edge residuals, each limited as in the robust fit; 0 without visible edges."""
    squares = np.minimum(estimate.edge_residuals**2, OUTLIER_SIGMAS**2)
    return float(squares.mean()) if len(squares) else 0.0


def fails_chi2_test(estimate: Estimate) -> bool:
    """Whether the residuals of stripes, break points and priors exceed the quantile of chi-squared.

    Visible edges are too many, and their errors too correlated, to be added to these few numbers.
    """
    dof = estimate.degrees_of_freedom
    return dof > 0 and estimate.chi2 > chi2_quantile(dof, ALARM_SIGMAS)


def chi2_quantile(degrees_of_freedom: int, sigmas: float) -> float:
    """Quantile of chi-squared at the probability of a normal quantile (Wilson and Hilferty 1931)."""
    spread = 2.0 / (9.0 * degrees_of_freedom)
    return degrees_of_freedom * (1.0 - spread + sigmas * sqrt(spread)) ** 3
