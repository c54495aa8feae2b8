"""Rejection of outliers: a break point, a stripe, exchanged lasers, wrong radii.

Six break points and three stripes give twelve numbers for seven parameters. If the fit of all of them fails the
chi-squared test, the shot is solved again for each hypothesis of `outlier_hypotheses`. The best one is selected if it
beats the others clearly; otherwise nothing is rejected, and the fit of everything is flagged as inconsistent.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations
from math import sqrt
from typing import NamedTuple

import numpy as np

from ringpose.estimate.measurements import ERRORS, Measurements, inflate_sigma
from ringpose.estimate.nuisance import RigErrors
from ringpose.estimate.residuals import CURVATURE, PARAMETERS, Prior
from ringpose.estimate.solver import Estimate, estimate_ring
from ringpose.types.arrays import EDGES, Array, Float64
from ringpose.types.pose import PoseFlag
from ringpose.types.rig import Rig

ALARM_SIGMAS = 3.7
"""Limit of the chi-squared test as a normal quantile: one shot in ten thousand exceeds it by chance."""

PARAMETER_PENALTY = 4.0
"""Penalty in chi-squared for each rejected number; by chance, rejecting one lowers chi-squared by 1."""

OUTLIER_PENALTY = 12.0
"""Penalty for any rejection: a factor of 400 in likelihood."""

RELABEL_PENALTY = 20.0
"""Penalty for exchanging lasers that were switched one by one; lower than for a stripe, as no number is rejected."""

CLEARLY = 6.0
"""Margin in chi-squared by which the best hypothesis must beat the others: a factor of 20 in likelihood."""

STRAIGHT_SIGMAS = 3.0
"""How many standard deviations a curvature may be below zero: two stripes alone hardly determine it."""

CONFIRMED_BELOW = 2.0
"""Largest ratio of the curvature's standard deviations without and with the other end of a stripe, see `_confirmed`."""


class Hypothesis(NamedTuple):
    """What was rejected or changed, and the estimate from the rest."""

    measured: Measurements
    prior: Prior
    estimate: Estimate
    flag: PoseFlag
    remark: str
    penalty: float
    """In chi-squared."""
    laser: int = -1
    """Laser of the rejected break points or stripe; -1 if there is none."""
    both: bool = False
    """Whether both break points of the stripe were rejected."""
    competing: tuple[Estimate, ...] = ()
    """Of an inconsistent shot: the estimates of the hypotheses that could not be distinguished."""

    @property
    def score(self) -> float:
        """Penalised chi-squared: less is better."""
        return chi2(self.estimate, self.measured) + self.penalty


class OutlierHypothesis(NamedTuple):
    """A hypothesis before its ring is estimated; fields as in `Hypothesis`."""

    measured: Measurements
    prior: Prior
    flag: PoseFlag
    remark: str
    penalty: float
    laser: int = -1
    both: bool = False


def reject_outliers(
    measured: Measurements, rig: Rig, prior: Prior, errors: RigErrors | None, labelled: bool
) -> Hypothesis | None:
    """The estimate from all measurements, or without those that contradict the rest; None if no estimate converges.

    `labelled`: whether the lasers were identified by switching them.
    """
    estimate = estimate_ring(measured, rig, prior, errors)
    if estimate is not None and len(measured.edges.edge):
        measured = replace(measured, edges=inflate_sigma(measured.edges, _edge_residuals(estimate, measured)))
        estimate = estimate_ring(measured, rig, prior, errors)
    everything = None if estimate is None else Hypothesis(measured, prior, estimate, PoseFlag(0), "", 0.0)
    if everything is not None and not fails_chi2_test(everything.estimate, measured, prior):
        return everything
    tried = []
    for outlier in outlier_hypotheses(measured, rig, prior, labelled):
        estimate = estimate_ring(outlier.measured, rig, outlier.prior, errors)
        if estimate is not None and (_is_ring(estimate) or outlier.both):
            tried.append(Hypothesis(estimate=estimate, **outlier._asdict()))
    best = _confirmed(_clearest(tried), tried)
    if best is not None and (everything is None or best.score < everything.score):
        if not fails_chi2_test(best.estimate, best.measured, best.prior):
            return best
        remark = f"{best.remark}, but the rest disagrees, too"
        return best._replace(flag=best.flag | PoseFlag.INCONSISTENT, remark=remark)
    if everything is None:
        return None
    remark = "what was seen disagrees with one ring by more than its errors, and no single part is to blame"
    competing = tuple(each.estimate for each in _nearly_best(tried) if each.score < everything.score)
    return everything._replace(flag=PoseFlag.INCONSISTENT, remark=remark, competing=competing)


def outlier_hypotheses(measured: Measurements, rig: Rig, prior: Prior, labelled: bool) -> Iterator[OutlierHypothesis]:
    """Each break point, both of a stripe, each stripe, each assignment of three lasers or fewer, and the radii."""
    yield from _wrong_points(measured, rig, prior)
    yield from _wrong_stripes(measured, rig, prior)
    yield from _wrong_labels(measured, rig, prior, labelled)
    if prior.radii is not None:
        remark = "the ring that was seen does not have the given radii; they were left out"
        penalty = OUTLIER_PENALTY + PARAMETER_PENALTY * float(np.isfinite(prior.radii.radius_m).sum())
        yield OutlierHypothesis(measured, prior._replace(radii=None), PoseFlag.RADIUS_INCONSISTENT, remark, penalty)


def _wrong_points(measured: Measurements, rig: Rig, prior: Prior) -> Iterator[OutlierHypothesis]:
    points, flag = measured.points, PoseFlag.POINT_REJECTED
    for laser in sorted(set(points.laser.tolist())):
        of_laser, name = np.flatnonzero(points.laser == laser), rig.lasers.names[laser]
        for number in of_laser.tolist():
            rest = measured.with_points(np.arange(len(points.laser)) != number)
            remark = f"the {EDGES[points.edge[number]]} break point of laser {name} contradicts the others"
            penalty = OUTLIER_PENALTY + PARAMETER_PENALTY
            yield OutlierHypothesis(rest, prior, flag, f"{remark} and was left out", penalty, laser)
        if len(of_laser) > 1:
            rest = measured.with_points(points.laser != laser)
            remark = f"a break point of laser {name} contradicts the others; both were left out"
            penalty = OUTLIER_PENALTY + 2 * PARAMETER_PENALTY
            yield OutlierHypothesis(rest, prior, flag, remark, penalty, laser, both=True)


def _wrong_stripes(measured: Measurements, rig: Rig, prior: Prior) -> Iterator[OutlierHypothesis]:
    seen = _lasers_seen(measured)
    for laser in seen if len(seen) > 2 else []:
        rest = measured.without_laser(laser)
        penalty = OUTLIER_PENALTY + PARAMETER_PENALTY * (_count(measured) - _count(rest))
        remark = f"the stripe of laser {rig.lasers.names[laser]} contradicts the others and was left out"
        yield OutlierHypothesis(rest, prior, PoseFlag.STRIPE_REJECTED, remark, penalty, laser)


def _wrong_labels(measured: Measurements, rig: Rig, prior: Prior, labelled: bool) -> Iterator[OutlierHypothesis]:
    seen, names = _lasers_seen(measured), rig.lasers.names
    for order in permutations(seen) if len(seen) <= 3 else []:
        if list(order) != seen:
            changed = measured.relabelled(dict(zip(seen, order, strict=True)))
            given, fitting = (", ".join(names[laser] for laser in lasers) for lasers in (seen, order))
            remark = f"the stripes fit one ring only as those of lasers {fitting}, not {given}"
            penalty = RELABEL_PENALTY if labelled else OUTLIER_PENALTY
            yield OutlierHypothesis(changed, prior, PoseFlag.ASSIGNMENT_AMBIGUOUS, remark, penalty)


def _lasers_seen(measured: Measurements) -> list[int]:
    return sorted({*measured.points.laser.tolist(), *measured.lines.laser.tolist()})


def _is_ring(estimate: Estimate) -> bool:
    """Whether the curvature is positive within its errors, and the inner edge is inside the outer one."""
    curvature_sd = sqrt(float(estimate.inverse[CURVATURE, CURVATURE]))
    return estimate.state.curvature > -STRAIGHT_SIGMAS * curvature_sd and estimate.state.band_m > 0


def _clearest(tried: list[Hypothesis]) -> Hypothesis | None:
    """The best hypothesis if it beats the others clearly.

    If the two ends of one stripe are equally suspect (with another curvature the other end looks wrong), both are
    rejected.
    """
    near = _nearly_best(tried)
    lasers = {each.laser for each in near}
    if len(near) > 1 and (len(lasers) > 1 or -1 in lasers):
        return None
    if sum(each.flag == PoseFlag.POINT_REJECTED for each in near) > 1:
        return next((each for each in tried if each.both and each.laser in lasers), None)
    return near[0] if near else None


def _confirmed(best: Hypothesis | None, tried: list[Hypothesis]) -> Hypothesis | None:
    """The same, or without the other end of the stripe, too, if only that end determines the ring's curvature.

    What occluded one end may have occluded both; the other one is used only if the rest confirms the curvature.
    """
    if best is None or best.flag != PoseFlag.POINT_REJECTED or best.both:
        return best
    without = next((each for each in tried if each.both and each.laser == best.laser), None)
    if without is None:
        return best
    sd, sd_without = (sqrt(float(each.estimate.inverse[CURVATURE, CURVATURE])) for each in (best, without))
    return best if sd_without < CONFIRMED_BELOW * sd else without


def _nearly_best(tried: list[Hypothesis]) -> list[Hypothesis]:
    """The best hypothesis, and those that it does not beat clearly, in order of their scores."""
    ranked = sorted((each for each in tried if not each.both), key=lambda each: each.score)
    return [each for each in ranked if each.score < ranked[0].score + CLEARLY]


def fails_chi2_test(estimate: Estimate, measured: Measurements, prior: Prior) -> bool:
    """Whether the residuals exceed the quantile of chi-squared (Wilson and Hilferty 1931)."""
    dof = degrees_of_freedom(estimate, measured, prior)
    if not dof:
        return False
    quantile = dof * (1.0 - 2.0 / (9.0 * dof) + ALARM_SIGMAS * sqrt(2.0 / (9.0 * dof))) ** 3
    return chi2(estimate, measured) > quantile


def chi2(estimate: Estimate, measured: Measurements) -> float:
    """Chi-squared of stripes, break points, radii and rig; visible edges are too many to be compared with these."""
    total = float(np.minimum(estimate.remaining**2, 1e6).sum())
    edges = float(np.minimum(_edge_residuals(estimate, measured) ** 2, 1e6).sum())
    if estimate.nuisance_step is None:
        return total - edges
    of_edges = ERRORS if len(measured.edges.edge) else 0
    of_rig = estimate.nuisance_step[: len(estimate.nuisance_step) - of_edges]
    return total - edges + float(of_rig @ of_rig)


def degrees_of_freedom(estimate: Estimate, measured: Measurements, prior: Prior) -> int:
    """Numbers of stripes, break points and radii less the parameters.

    If weak priors hold some of the parameters, their number is not defined; no parameter is then subtracted, which
    makes the test conservative.
    """
    held = prior.regularize_about is not None or estimate.regularized
    radii = 0 if prior.radii is None else int(np.isfinite(prior.radii.radius_m).sum())
    return max(_count(measured) + radii - (0 if held else PARAMETERS), 0)


def _edge_residuals(estimate: Estimate, measured: Measurements) -> Float64[Array, "visible"]:
    first = _count(measured)
    return estimate.remaining[first : first + len(measured.edges.edge)]


def _count(measured: Measurements) -> int:
    """Number of residuals of stripes and break points."""
    return 2 * len(measured.lines.laser) + len(measured.points.laser) + int(measured.points.isolated.sum())


def with_edges_exchanged(measured: Measurements) -> Measurements:
    """The measurements with inner edges taken for outer ones and the reverse."""
    points, edges = measured.points, measured.edges
    return replace(measured, points=replace(points, edge=1 - points.edge), edges=replace(edges, edge=1 - edges.edge))
