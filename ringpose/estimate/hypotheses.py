"""What may be wrong in a shot: hypotheses beside that of all measurements on one ring.

One break point, a stripe, the visible edges, the assignment of the lasers, or the assumed radii are wrong; or the
target moves faster, or the ring is less perfect, than assumed. `ringpose.estimate.selection` decides between them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from math import log
from typing import NamedTuple

import numpy as np

from ringpose.estimate.factors.edges import TERMS
from ringpose.estimate.factors.prior import Prior
from ringpose.estimate.measurements import Measurements
from ringpose.estimate.ring_estimate import Estimate, edge_mean_square
from ringpose.optics.feature_errors import AGREEMENT
from ringpose.types.assumptions import MotionPrior, motion_prior
from ringpose.types.detection import UNLABELLED, Rejection
from ringpose.types.finding import NOTHING, Finding

END_PROBABILITY = 3e-3
"""Prior probability that a break point is not on the edge of the face but somewhere else on its stripe: of 308 ends of
59 rendered shots one was, before anything was rejected (`tests/benchmarks/fault_priors.py`). The same that both of a
stripe are, by one occluder or a surface that continues the face (1 of 165 stripes, 95 % interval 0.0002 to 0.03), that
the visible points of an edge are of something else, and that a prior or a name does not hold. With twice as much, 90
instead of 97 % of drawn shots have levels below 5 mm and 3 degrees."""

STRIPE_PROBABILITY = 1.2e-2
"""Prior probability that a stripe is on another surface, a ghost or a reflection; 2 of 165 stripes, of the same shots.
Half of it is that of a layer of `LAYERS`, from which its ends come too."""

PLANE_PROBABILITY = 1e-4
"""Prior probability that a light plane has moved since the calibration by more than its stability, or that lasers
which were switched one by one are exchanged: no picture tells."""


RADIUS_PROBABILITY = 1e-3
"""Prior probability that the assumed radii are those of another ring."""


def penalty_of(probability: float, rejected: int | float = 0) -> float:
    """Penalty in chi-squared of a cause with this prior probability that leaves out so many numbers (method(7), 3.14).

    -2 ln p, and twice `AGREEMENT` for each number, which may then be anywhere in its range.
    """
    return 2.0 * (rejected * AGREEMENT - log(probability))


MAX_PERMUTED = 3
"""Number of lasers up to which all assignments are tried."""

WIDER_BY = 4.0
"""Factor by which a hypothesis widens the standard deviations of a prior."""

MIN_DEVIATION_M = 0.001
"""Smallest standard deviation of a ring's edges and face in an explanation by the ring's form."""


class Hypothesis(NamedTuple):
    """An explanation of a shot before its ring is estimated."""

    measured: Measurements
    prior: Prior
    findings: Finding
    penalty: float
    """Penalty in chi-squared."""
    rejected: tuple[Rejection, ...] = ()
    laser: int = UNLABELLED
    """Laser of the rejected break points or stripe; `UNLABELLED` if there is none."""
    cause_seen: bool = False
    """Whether the image shows what occludes the rejected break point, and nothing at the stripe's other end."""
    exchanged: tuple[str, str] | None = None
    """Names of the lasers to which the stripes are assigned, and of those to which they were; None if they are kept."""

    def rejects_both_ends(self, laser: int) -> bool:
        """Whether both break points of that laser's stripe are rejected."""
        return Finding.WRONG_ENDS in self.findings and self.laser == laser


class Solved(NamedTuple):
    """A hypothesis with the ring estimated under it."""

    hypothesis: Hypothesis
    estimate: Estimate

    @property
    def score(self) -> float:
        """Penalised chi-squared, visible edges included by their mean: less is better."""
        total = self.estimate.chi2 + self.hypothesis.penalty
        return total + TERMS * max(edge_mean_square(self.estimate) - 1.0, 0.0)


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


def outlier_hypotheses(measured: Measurements, prior: Prior, labelled: bool) -> Iterator[Hypothesis]:
    """Hypotheses that something is wrong, one for each possible cause.

    The causes are one break point, both of a stripe, a stripe, the visible edges, the assignment of the lasers, the
    radii.
    """
    yield from _wrong_points(measured, prior)
    yield from _wrong_stripes(measured, prior)
    yield from _wrong_assignments(measured, prior, labelled)
    if len(measured.edges.edge):
        penalty = penalty_of(END_PROBABILITY, 2)
        finding, rejected = Finding.WRONG_EDGES, (Rejection(what="edge"),)
        yield Hypothesis(measured.without_edges(), prior, finding, penalty, rejected)
    if prior.radii is not None:
        penalty = penalty_of(RADIUS_PROBABILITY)
        finding, rejected = Finding.WRONG_RADIUS, (Rejection(what="radius"),)
        yield Hypothesis(measured, prior._replace(radii=None), finding, penalty, rejected)
    yield from _wider_priors(measured, prior)


def _wider_priors(measured: Measurements, prior: Prior) -> Iterator[Hypothesis]:
    """Hypotheses that the target moves faster or less evenly, or the ring is less round and flat, than assumed."""
    motion, tolerance_m = prior.assumptions.motion, prior.assumptions.ring_tolerance_m
    times_s = measured.times_s(measured.stamp_s)
    if times_s.any():
        least, assumed = motion_prior(), motion_prior(0.0, 0.0) if motion is None else motion
        faster = MotionPrior(
            speed_sd_m_s=WIDER_BY * max(least.speed_sd_m_s, assumed.speed_sd_m_s),
            rate_sd_rad_s=WIDER_BY * max(least.rate_sd_rad_s, assumed.rate_sd_rad_s),
        )
        finding = Finding.MOVED if motion is None else Finding.FASTER
        assumptions = replace(prior.assumptions, motion=faster)
        yield Hypothesis(measured, prior._replace(assumptions=assumptions), finding, penalty_of(END_PROBABILITY))
        once = measured.once()
        left_out = len(measured.points.x) - len(once.points.x) + 2 * (len(measured.lines.laser) - len(once.lines.laser))
        if left_out:
            penalty = penalty_of(END_PROBABILITY, left_out)
            yield Hypothesis(once, prior._replace(assumptions=assumptions), Finding.FRAME_DIFFERS, penalty)
    yield with_deviation(Hypothesis(measured, prior, NOTHING, 0.0), max(WIDER_BY * tolerance_m, MIN_DEVIATION_M))


def with_deviation(hypothesis: Hypothesis, deviation_m: float) -> Hypothesis:
    """The hypothesis that, in addition, the ring deviates from a circle or a plane by this standard deviation (m)."""
    assumptions = replace(hypothesis.prior.assumptions, ring_tolerance_m=deviation_m)
    return hypothesis._replace(
        prior=hypothesis.prior._replace(assumptions=assumptions),
        findings=hypothesis.findings | Finding.NOT_ROUND,
        penalty=hypothesis.penalty + penalty_of(END_PROBABILITY),
    )


def _wrong_points(measured: Measurements, prior: Prior) -> Iterator[Hypothesis]:
    points = measured.points
    for laser, opposite in sorted(set(zip(points.laser.tolist(), points.opposite.tolist(), strict=True))):
        is_of_piece = (points.laser == laser) & (points.opposite == opposite)
        of_piece, name = np.flatnonzero(is_of_piece), measured.rig.lasers.names[laser]
        rejected = tuple(
            Rejection(what="point", laser=name, edge="outer" if points.edge[number] else "inner", opposite=opposite)
            for number in of_piece.tolist()
        )
        for number, rejection in zip(of_piece.tolist(), rejected, strict=True):
            rest = measured.with_points(np.arange(len(points.laser)) != number)
            occluded = bool(points.beside_occluder[number])
            penalty = penalty_of(0.5 if occluded else END_PROBABILITY, 1)  # 0.5: as likely as not
            alone = occluded and int(points.beside_occluder[of_piece].sum()) == 1
            yield Hypothesis(rest, prior, Finding.WRONG_POINT, penalty, (rejection,), laser, cause_seen=alone)
        if len(of_piece) > 1:
            rest = measured.with_points(~is_of_piece)
            penalty = penalty_of(END_PROBABILITY, measured.stripe_numbers - rest.stripe_numbers)
            yield Hypothesis(rest, prior, Finding.WRONG_ENDS, penalty, tuple(dict.fromkeys(rejected)), laser)


def _wrong_stripes(measured: Measurements, prior: Prior) -> Iterator[Hypothesis]:
    one_arc = measured.of_one_arc()
    if one_arc is not measured:
        names, points = measured.rig.lasers.names, measured.points
        beyond = sorted(set(points.laser[points.opposite].tolist()))
        rejected = tuple(Rejection(what="stripe", laser=names[laser], opposite=True) for laser in beyond)
        penalty = penalty_of(STRIPE_PROBABILITY, measured.stripe_numbers - one_arc.stripe_numbers)
        yield Hypothesis(one_arc, prior, Finding.WRONG_STRIPE, penalty, rejected)
    seen = measured.lasers
    for laser in seen if len(seen) > 1 else []:
        rest, name = measured.without_laser(laser), measured.rig.lasers.names[laser]
        penalty = penalty_of(STRIPE_PROBABILITY, measured.stripe_numbers - rest.stripe_numbers)
        rejected = (Rejection(what="stripe", laser=name),)
        yield Hypothesis(rest, prior, Finding.WRONG_STRIPE, penalty, rejected, laser)


def _wrong_assignments(measured: Measurements, prior: Prior, labelled: bool) -> Iterator[Hypothesis]:
    seen, names = measured.lasers, measured.rig.lasers.names
    for order in _assignments(seen, len(names)):
        if list(order) != seen:
            changed = measured.relabelled(dict(zip(seen, order, strict=True)))
            given, fitting = (", ".join(names[laser] for laser in lasers) for lasers in (seen, order))
            penalty = penalty_of(PLANE_PROBABILITY if labelled else END_PROBABILITY)
            rejected = (Rejection(what="assignment"),)
            yield Hypothesis(changed, prior, Finding.WRONG_LASERS, penalty, rejected, exchanged=(fitting, given))


def _assignments(seen: list[int], lasers: int) -> Iterator[Sequence[int]]:
    """All assignments of the seen stripes to lasers; for more than three lasers, those that differ in one or two."""
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
