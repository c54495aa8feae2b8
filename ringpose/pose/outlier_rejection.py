"""What contradicts the rest: a wrong break point, a stripe on something else, exchanged lasers, wrong radii.

Six break points and three stripes are twelve numbers for seven unknowns. If these disagree by more than chance
allows, the shot is solved again without each of its parts; the part whose absence heals the fit by far more than
chance is left out. If two parts would do equally well, none is: the fit stays, and says so.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations
from math import sqrt
from typing import NamedTuple

import numpy as np

from ringpose.pose.measurements import ERRORS, Measurements, inflate_sigma
from ringpose.pose.nuisance import RigErrors
from ringpose.pose.residuals import CURVATURE, PARAMETERS, Prior
from ringpose.pose.solver import Fit, fitted
from ringpose.types.arrays import EDGES, Array, Float64
from ringpose.types.pose import PoseFlag
from ringpose.types.rig import Rig

ALARM_SIGMAS = 3.7
"""One shot in ten thousand is beyond it by chance."""

PARAMETER_PENALTY = 4.0
"""What leaving out one number must lower the sum of squares by; it lowers it by one anyway."""

OUTLIER_PENALTY = 12.0
"""The same for any suspicion at all: a factor of 400 in likelihood."""

RELABEL_PENALTY = 20.0
"""For distrusting lasers that were switched one by one; less than for a stripe: other labels explain all numbers."""

CLEARLY = 6.0
"""By how much the best explanation must beat another kind of it: a factor of 20 in likelihood."""

STRAIGHT_SIGMAS = 3.0
"""How many of its standard deviations a curvature may be below zero: two stripes alone hardly tell it."""

CONFIRMED_BELOW = 2.0
"""How many times as uncertain the curvature may be without the end of a stripe whose other end was wrong."""


class Hypothesis(NamedTuple):
    """What was left out or changed, and the fit that it leads to."""

    measured: Measurements
    before: Prior
    fit: Fit
    flag: PoseFlag
    remark: str
    price: float
    """Of the suspicion, in squared standard deviations."""
    laser: int = -1
    """Whose break point or stripe it is that was left out; -1 if it is none."""
    both: bool = False
    """Whether both of them were."""
    rivals: tuple[Fit, ...] = ()
    """Of a contradiction with no one to blame: the fits that each suspicion leads to."""

    @property
    def score(self) -> float:
        """Cost and price: less is better."""
        return chi2(self.fit, self.measured) + self.price


def explained(
    measured: Measurements, rig: Rig, before: Prior, errors: RigErrors | None, labelled: bool
) -> Hypothesis | None:
    """The fit of everything, or of all but what contradicts the rest; None if nothing can be fitted."""
    fit = fitted(measured, rig, before, errors)
    if fit is not None and len(measured.edges.edge):
        measured = replace(measured, edges=inflate_sigma(measured.edges, _of_edges(fit, measured)))
        fit = fitted(measured, rig, before, errors)
    everything = None if fit is None else Hypothesis(measured, before, fit, PoseFlag(0), "", 0.0)
    if everything is not None and not fails_chi2_test(everything.fit, measured, before):
        return everything
    tried = []
    for suspicion in _suspicions(measured, rig, before, labelled):
        other = fitted(suspicion.measured, rig, suspicion.before, errors)
        if other is not None and (_is_ring(other) or suspicion.both):
            tried.append(Hypothesis(fit=other, **suspicion._asdict()))
    best = _confirmed(_clearest(tried), tried)
    if best is not None and (everything is None or best.score < everything.score):
        return _owned_up(best)
    remark = "what was seen disagrees with one ring by more than its errors, and no single part is to blame"
    if everything is None:
        return None
    rivals = tuple(each.fit for each in _near(tried) if each.score < everything.score)
    return everything._replace(flag=PoseFlag.INCONSISTENT, remark=remark, rivals=rivals)


def _is_ring(fit: Fit) -> bool:
    """Whether the edges are curved the right way, as far as their errors tell, and the inner one is inside."""
    curvature_sd = sqrt(float(fit.inverse[CURVATURE, CURVATURE]))
    return fit.state.curvature > -STRAIGHT_SIGMAS * curvature_sd and fit.state.band_m > 0


def _owned_up(best: Hypothesis) -> Hypothesis:
    """With a flag more if what is left disagrees, too."""
    if not fails_chi2_test(best.fit, best.measured, best.before):
        return best
    return best._replace(flag=best.flag | PoseFlag.INCONSISTENT, remark=f"{best.remark}, but the rest disagrees, too")


def _clearest(tried: list[Hypothesis]) -> Hypothesis | None:
    """The best explanation if it beats the others clearly.

    Of two ends of one stripe that would do equally well (another curvature makes the other end look wrong), both are
    left out.
    """
    near = _near(tried)
    lasers = {each.laser for each in near}
    if len(near) > 1 and (len(lasers) > 1 or -1 in lasers):
        return None
    if sum(each.flag == PoseFlag.POINT_LEFT_OUT for each in near) > 1:
        return next((each for each in tried if each.both and each.laser in lasers), None)
    return near[0] if near else None


def _confirmed(best: Hypothesis | None, tried: list[Hypothesis]) -> Hypothesis | None:
    """The same, without the other end of its stripe, too, if nothing but that end tells the ring's curvature.

    What hid one end may have hidden both; the other one is used only where the rest would know the ring without it.
    """
    if best is None or best.flag != PoseFlag.POINT_LEFT_OUT or best.both:
        return best
    less = next((each for each in tried if each.both and each.laser == best.laser), None)
    return best if less is None or _curvature_sd(less) < CONFIRMED_BELOW * _curvature_sd(best) else less


def _curvature_sd(explanation: Hypothesis) -> float:
    return sqrt(float(explanation.fit.inverse[CURVATURE, CURVATURE]))


def _near(tried: list[Hypothesis]) -> list[Hypothesis]:
    """The best explanation, and those that it does not beat clearly."""
    near = sorted((each for each in tried if not each.both), key=lambda each: each.score)
    return [each for each in near if each.score < near[0].score + CLEARLY]


def _of_edges(fit: Fit, measured: Measurements) -> Float64[Array, "visible"]:
    first = _count(measured)
    return fit.residual[first : first + len(measured.edges.edge)]


def chi2(fit: Fit, measured: Measurements) -> float:
    """Sum of squares of stripes, break points, radii and rig; of visible edges there are too many to weigh here."""
    squares = float(np.minimum(fit.residual**2, 1e6).sum())
    edges = float(np.minimum(_of_edges(fit, measured) ** 2, 1e6).sum())
    if fit.rig_step is None:
        return squares - edges
    of_rig = fit.rig_step[: len(fit.rig_step) - (ERRORS if len(measured.edges.edge) else 0)]
    return squares - edges + float(of_rig @ of_rig)


def freedom(fit: Fit, measured: Measurements, before: Prior) -> int:
    """How many numbers there are to spare.

    A shot that leaves something open spares none for what it leaves open; nobody knows how many that are, so that all
    count: what is measured may not cost more than chance allows for so many numbers.
    """
    held = before.regularize_about is not None or fit.weak
    radii = 0 if before.radii is None else int(np.isfinite(before.radii.radius_m).sum())
    return max(_count(measured) + radii - (0 if held else PARAMETERS), 0)


def fails_chi2_test(fit: Fit, measured: Measurements, before: Prior) -> bool:
    """Whether the residuals are larger than chance allows (Wilson and Hilferty's chi-squared)."""
    spare = freedom(fit, measured, before)
    if not spare:
        return False
    limit = spare * (1.0 - 2.0 / (9.0 * spare) + ALARM_SIGMAS * sqrt(2.0 / (9.0 * spare))) ** 3
    return chi2(fit, measured) > limit


def _count(measured: Measurements) -> int:
    """Numbers that stripes and break points give."""
    return 2 * len(measured.lines.laser) + len(measured.points.laser) + int(measured.points.alone.sum())


class OutlierHypothesis(NamedTuple):
    """An explanation before it is tried."""

    measured: Measurements
    before: Prior
    flag: PoseFlag
    remark: str
    price: float
    laser: int = -1
    both: bool = False


def _suspicions(measured: Measurements, rig: Rig, before: Prior, labelled: bool) -> Iterator[OutlierHypothesis]:
    yield from _wrong_points(measured, rig, before)
    yield from _wrong_stripes(measured, rig, before)
    yield from _wrong_labels(measured, rig, before, labelled)
    if before.radii is not None:
        remark = "the ring that was seen does not have the radii that were said; they were left out"
        numbers = float(np.isfinite(before.radii.radius_m).sum())
        price = OUTLIER_PENALTY + PARAMETER_PENALTY * numbers
        yield OutlierHypothesis(measured, before._replace(radii=None), PoseFlag.RADIUS_DISAGREES, remark, price)


def _wrong_points(measured: Measurements, rig: Rig, before: Prior) -> Iterator[OutlierHypothesis]:
    points, flag = measured.points, PoseFlag.POINT_LEFT_OUT
    for laser in sorted(set(points.laser.tolist())):
        own, name = np.flatnonzero(points.laser == laser), rig.lasers.names[laser]
        for number in own.tolist():
            keep = np.arange(len(points.laser)) != number
            which = f"the {EDGES[points.edge[number]]} break point of laser {name}"
            remark = f"{which} contradicts the others and was left out"
            price = OUTLIER_PENALTY + PARAMETER_PENALTY
            yield OutlierHypothesis(measured.with_points(keep), before, flag, remark, price, laser)
        if len(own) > 1:
            remark = f"a break point of laser {name} contradicts the others; both were left out"
            price = OUTLIER_PENALTY + 2 * PARAMETER_PENALTY
            yield OutlierHypothesis(
                measured.with_points(points.laser != laser), before, flag, remark, price, laser, True
            )


def _wrong_stripes(measured: Measurements, rig: Rig, before: Prior) -> Iterator[OutlierHypothesis]:
    seen = _seen(measured)
    for laser in seen if len(seen) > 2 else []:
        less = measured.without_laser(laser)
        price = OUTLIER_PENALTY + PARAMETER_PENALTY * (_count(measured) - _count(less))
        remark = f"the stripe of laser {rig.lasers.names[laser]} contradicts the others and was left out"
        yield OutlierHypothesis(less, before, PoseFlag.STRIPE_LEFT_OUT, remark, price, laser)


def _wrong_labels(measured: Measurements, rig: Rig, before: Prior, labelled: bool) -> Iterator[OutlierHypothesis]:
    """Every other order of up to three lasers."""
    seen, names = _seen(measured), rig.lasers.names
    for order in permutations(seen) if len(seen) <= 3 else []:
        if list(order) != seen:
            changed = measured.relabelled(dict(zip(seen, order, strict=True)))
            said, fits = (", ".join(names[laser] for laser in lasers) for lasers in (seen, order))
            remark = f"the stripes fit one ring only as those of lasers {fits}, not {said}"
            price = RELABEL_PENALTY if labelled else OUTLIER_PENALTY
            yield OutlierHypothesis(changed, before, PoseFlag.RELABELLED, remark, price)


def _seen(measured: Measurements) -> list[int]:
    return sorted({*measured.points.laser.tolist(), *measured.lines.laser.tolist()})


def swapped(measured: Measurements) -> Measurements:
    """Inner edges taken for outer ones and the reverse."""
    points, edges = measured.points, measured.edges
    return replace(measured, points=replace(points, edge=1 - points.edge), edges=replace(edges, edge=1 - edges.edge))
