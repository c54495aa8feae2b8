"""What may be wrong in a shot: hypotheses beside that of all measurements on one ring, and the evidence of one stripe.

One break point, a stripe, the visible edges, the assignment of the lasers, or the assumed radii are wrong; or the
target moves faster, or the ring is less perfect, than assumed. `ringpose.estimate.explanation` decides between them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from ringpose.estimate.factors import PARAMETERS, Prior, common_errors, ring_residuals
from ringpose.estimate.measurements import Measurements
from ringpose.estimate.solver import DECISION_SIGMAS, STRIPES_OF_A_PLANE, Estimate, estimate_ring, nuisance_columns
from ringpose.types.arrays import Array, Float64
from ringpose.types.assumptions import Assumptions, MotionPrior, motion_prior
from ringpose.types.detection import Rejection
from ringpose.types.finding import NOTHING, Finding

PARAMETER_PENALTY = 4.0
"""Penalty in chi-squared for each rejected number; by chance, rejecting one lowers chi-squared by 1."""

OUTLIER_PENALTY = 12.0
"""Penalty for any rejection: a factor of 400 in likelihood."""

BOTH_PENALTY = 18.0
"""Penalty for rejecting both break points of a stripe: two causes, or an occluder over both."""

OCCLUDED_PENALTY = 4.0
"""Penalty for rejecting a break point beside which the image shows a surface in front of the ring."""

RELABEL_PENALTY = 20.0
"""Penalty for exchanging lasers that were switched one by one; lower than for a stripe, as no number is rejected."""

MAX_PERMUTED = 3
"""Number of lasers up to which all assignments are tried."""

WIDER_BY = 4.0
"""Factor by which a hypothesis widens the standard deviations of a prior."""

MIN_DEVIATION_M = 0.001
"""Smallest standard deviation of a ring's edges and face in an explanation by the ring's form."""

BACKGROUND_RANGE_PX = (150.0, 30.0, 100.0, 100.0)
"""Where a stripe on the background may be seen: range of its line's position, of the change along it, of its ends."""

LINEAR_SIGMAS = 100.0
"""Standard deviation of a predicted number, in those of the measured one, from which its error is not linear and does
not count: with more, the prediction of right stripes by visible edges is often missed."""


class Hypothesis(NamedTuple):
    """An explanation of a shot before its ring is estimated."""

    measured: Measurements
    prior: Prior
    findings: Finding = NOTHING
    penalty: float = 0.0
    """Penalty in chi-squared."""
    rejected: tuple[Rejection, ...] = ()
    laser: int = -1
    """Laser of the rejected break points or stripe; -1 if there is none."""
    cause_seen: bool = False
    """Whether the image shows what occludes the rejected break point, and nothing at the stripe's other end."""
    exchanged: tuple[str, str] | None = None
    """Names of the lasers to which the stripes are assigned, and of those to which they were; None if they are kept."""

    def rejects_both_ends(self, laser: int) -> bool:
        """Whether both break points of that laser's stripe are rejected."""
        return Finding.WRONG_ENDS in self.findings and self.laser == laser


def outlier_hypotheses(measured: Measurements, prior: Prior, labelled: bool) -> Iterator[Hypothesis]:
    """Hypotheses that something is wrong, one for each possible cause.

    The causes are one break point, both of a stripe, a stripe, the visible edges, the assignment of the lasers, the
    radii.
    """
    yield from _wrong_points(measured, prior)
    yield from _wrong_stripes(measured, prior)
    yield from _wrong_assignments(measured, prior, labelled)
    if len(measured.edges.edge):
        penalty = OUTLIER_PENALTY + 2 * PARAMETER_PENALTY
        finding, rejected = Finding.WRONG_EDGES, (Rejection(what="edge"),)
        yield Hypothesis(measured.without_edges(), prior, finding, penalty, rejected)
    if prior.radii is not None:
        penalty = OUTLIER_PENALTY + PARAMETER_PENALTY  # one cause: the wrong ring was named
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
        yield Hypothesis(measured, prior._replace(assumptions=assumptions), finding, OUTLIER_PENALTY)
        once = measured.once()
        left_out = len(measured.points.x) - len(once.points.x) + 2 * (len(measured.lines.laser) - len(once.lines.laser))
        if left_out:
            penalty = OUTLIER_PENALTY + PARAMETER_PENALTY * left_out
            yield Hypothesis(once, prior._replace(assumptions=assumptions), Finding.FRAME_DIFFERS, penalty)
    yield with_deviation(Hypothesis(measured, prior), max(WIDER_BY * tolerance_m, MIN_DEVIATION_M))


def with_deviation(hypothesis: Hypothesis, deviation_m: float) -> Hypothesis:
    """The hypothesis that, in addition, the ring deviates from a circle or a plane by this standard deviation (m)."""
    assumptions = replace(hypothesis.prior.assumptions, ring_tolerance_m=deviation_m)
    return hypothesis._replace(
        prior=hypothesis.prior._replace(assumptions=assumptions),
        findings=hypothesis.findings | Finding.NOT_ROUND,
        penalty=hypothesis.penalty + OUTLIER_PENALTY,
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
            penalty = PARAMETER_PENALTY + (OCCLUDED_PENALTY if occluded else OUTLIER_PENALTY)
            alone = occluded and int(points.beside_occluder[of_piece].sum()) == 1
            yield Hypothesis(rest, prior, Finding.WRONG_POINT, penalty, (rejection,), laser, cause_seen=alone)
        if len(of_piece) > 1:
            rest = measured.with_points(~is_of_piece)
            penalty = BOTH_PENALTY + PARAMETER_PENALTY * (measured.stripe_numbers - rest.stripe_numbers)
            yield Hypothesis(rest, prior, Finding.WRONG_ENDS, penalty, tuple(dict.fromkeys(rejected)), laser)


def _wrong_stripes(measured: Measurements, prior: Prior) -> Iterator[Hypothesis]:
    one_arc = measured.of_one_arc()
    if one_arc is not measured:
        names, points = measured.rig.lasers.names, measured.points
        beyond = sorted(set(points.laser[points.opposite].tolist()))
        rejected = tuple(Rejection(what="stripe", laser=names[laser], opposite=True) for laser in beyond)
        penalty = OUTLIER_PENALTY + PARAMETER_PENALTY * (measured.stripe_numbers - one_arc.stripe_numbers)
        yield Hypothesis(one_arc, prior, Finding.WRONG_STRIPE, penalty, rejected)
    seen = measured.lasers
    for laser in seen if len(seen) > 1 else []:
        rest, name = measured.without_laser(laser), measured.rig.lasers.names[laser]
        penalty = OUTLIER_PENALTY + PARAMETER_PENALTY * (measured.stripe_numbers - rest.stripe_numbers)
        rejected = (Rejection(what="stripe", laser=name),)
        yield Hypothesis(rest, prior, Finding.WRONG_STRIPE, penalty, rejected, laser)


def _wrong_assignments(measured: Measurements, prior: Prior, labelled: bool) -> Iterator[Hypothesis]:
    seen, names = measured.lasers, measured.rig.lasers.names
    for order in _assignments(seen, len(names)):
        if list(order) != seen:
            changed = measured.relabelled(dict(zip(seen, order, strict=True)))
            given, fitting = (", ".join(names[laser] for laser in lasers) for lasers in (seen, order))
            penalty = RELABEL_PENALTY if labelled else OUTLIER_PENALTY
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


# Whether one stripe is on the background


def single_stripe_estimates(
    measured: Measurements, assumptions: Assumptions
) -> Iterator[tuple[int, Measurements, Estimate]]:
    """For each of two stripes: its laser, and the measurements and the ring without it.

    Nothing is returned for other numbers of stripes. Assumed radii are not used: with them the length of one stripe
    determines the angle at which it crosses the face, but not to which side (`explanation._evidence_with_radii`).
    """
    for laser in measured.stripes if len(measured.stripes) == STRIPES_OF_A_PLANE else []:
        alone = measured.without_laser(laser)
        if not len(alone.points.x):
            continue
        estimate = estimate_ring(alone, Prior(assumptions=assumptions), tolerance_sigmas=DECISION_SIGMAS)
        if estimate is not None:
            yield laser, alone, estimate


def ring_evidence(estimate: Estimate, measured: Measurements, laser: int) -> float:
    """Log likelihood ratio of a laser's stripe on the ring that another stripe predicts, against one anywhere.

    ln N(r; 0, C) - ln(1 / range): r are the stripe's whitened residuals at the prediction, C is their covariance.
    """
    line = np.flatnonzero(np.repeat(measured.lines.laser == laser, 2))
    points = np.flatnonzero(measured.points.laser == laser)
    rows = np.concatenate([line, 2 * len(measured.lines.laser) + points])
    residual, covariance = _predicted_residuals(estimate, measured)
    residual, covariance = residual[rows], covariance[np.ix_(rows, rows)]
    log_ring = -0.5 * (
        residual @ np.linalg.solve(covariance, residual) + np.linalg.slogdet(2.0 * np.pi * covariance)[1]
    )
    # the same range in standard deviations
    focal = measured.rig.camera.camera_matrix[[0, 1], [0, 1]]
    whitening = measured.lines.whitening[measured.lines.laser == laser][0]
    sigma_px = measured.points.sigma_x[points] * focal[0]
    log_range = np.log(BACKGROUND_RANGE_PX[: len(rows)]).sum()
    log_range += np.linalg.slogdet(whitening)[1] - 2.0 * np.log(focal[1]) - np.log(sigma_px).sum()
    return float(log_ring + log_range)


def _predicted_residuals(
    estimate: Estimate, measured: Measurements
) -> tuple[Float64[Array, "row"], Float64[Array, "row row"]]:
    """Residuals of stripes and break points at a ring that was estimated without some of them, and their covariance.

    1 + [J B] C [J B]^T, with the joint covariance C of ring and common errors.
    """
    residuals = ring_residuals(estimate.arcs, measured.observations, estimate.prior, estimate.rates)
    fixed = common_errors(residuals, estimate.prior)
    jacobian = np.concatenate([residuals.jacobian, nuisance_columns(residuals, fixed)], axis=1)
    step = np.concatenate([np.zeros(PARAMETERS), estimate.nuisance_step])
    covariance = np.linalg.inv(estimate.joint_information)
    rows = slice(residuals.data_rows)
    return (residuals.residual + jacobian @ step)[rows], (
        np.eye(residuals.data_rows) + jacobian[rows] @ covariance @ jacobian[rows].T
    )


def edge_evidence(estimate: Estimate, measured: Measurements) -> float:
    """Log likelihood ratio of a single stripe on the ring that the visible edges predict, against one anywhere.

    The stripe's whitened residuals r at the common ring have the covariance 1 - H, with its block H of the hat matrix:
    the edges alone predict the stripe with the precision W^T (1 - H) W, W its whitening, and the prediction is missed
    by r^T (1 - H)^-1 r in squared standard deviations. What the edges leave open, such as the scale, is as likely as
    anywhere: ln N(0; 0, range^2 / 2 pi) = -ln(range). The edges count as those of the face, not as the feet of walls,
    whose depth would leave the prediction open.
    """
    measured = measured.of_one_arc()
    if len(measured.points.x) + 2 * len(measured.lines.laser) > measured.stripe_numbers:
        measured = measured.once()  # it must not predict itself
    measured = replace(measured, edges=replace(measured.edges, walls=False))
    again = estimate_ring(measured, estimate.prior, estimate, tolerance_sigmas=DECISION_SIGMAS)
    if again is None:
        return -np.inf
    estimate = again
    residuals, points = estimate.residuals, measured.points
    focal = measured.rig.camera.camera_matrix[[0, 1], [0, 1]]
    observations = residuals.observations
    count, ends = int(np.count_nonzero(~observations.many)), observations.view.ends
    rows = np.concatenate([residuals.jacobian, estimate.nuisance], axis=1) * np.sqrt(estimate.weights)[:, None]
    prior = np.eye(rows.shape[1])[PARAMETERS:]
    basis = np.linalg.qr(np.concatenate([rows, prior]))[0][:count]  # the normal equations of one stripe are singular
    free = np.eye(count) - basis @ basis.T
    remaining = estimate.remaining[:count]
    missed = remaining @ np.linalg.solve(free + np.eye(count) / LINEAR_SIGMAS**2, remaining)

    # in pixels: ordinates of the line's two ends, abscissae of the break points, ordinates of those without a line
    of_points = [1.0 / points.sigma_x / focal[0], observations.points.ordinate_weights(residuals.at)[1] / focal[1]]
    whitening = np.diag(np.concatenate([np.ones(ends), *of_points]))
    whitening[:ends, :ends] = observations.whitening / focal[1]
    position_px, change_px, end_px, _ = BACKGROUND_RANGE_PX
    range_px = np.full(count, position_px)
    range_px[ends : ends + len(points.x)] = end_px
    to_range = np.eye(count)
    if ends:
        range_px[1], to_range[:2, :2] = change_px, [[0.5, 0.5], [-1.0, 1.0]]  # position and change of the line
    anywhere = to_range.T @ np.diag(2.0 * np.pi / range_px**2) @ to_range
    predicted = whitening.T @ free @ whitening + anywhere
    log_ring = 0.5 * (np.linalg.slogdet(predicted / (2.0 * np.pi))[1] - missed)
    return float(log_ring + np.log(range_px).sum())
