"""Evidence that a stripe is on the ring, and not on the background, where two stripes or one were seen.

Light planes are nearly parallel, so that any two stripes lie nearly in a plane: two stripes have hardly any redundancy.
"""

from collections.abc import Iterator
from dataclasses import replace
from math import inf, log

import numpy as np

from ringpose.estimate.factors.prior import Prior
from ringpose.estimate.hypotheses import Solved
from ringpose.estimate.linearization import PARAMETERS, ring_residuals
from ringpose.estimate.measurements import Measurements
from ringpose.estimate.nuisance import common_errors, nuisance_columns
from ringpose.estimate.ring_estimate import DECISION_SIGMAS, STRIPES_OF_A_PLANE, Estimate, estimate_ring
from ringpose.types.arrays import Array, Float64
from ringpose.types.assumptions import Assumptions

BACKGROUND_RANGE_PX = (150.0, 30.0, 100.0, 100.0)
"""Where a stripe on the background may be seen: range of its line's position, of the change along it, of its ends."""

LINEAR_SIGMAS = 100.0
"""Standard deviation of a predicted number, in those of the measured one, from which its error is not linear and does
not count: with more, the prediction of right stripes by visible edges is often missed."""

BOTH_ARCS = 4
"""Ends of a stripe that crosses both arcs."""


def single_stripe_estimates(
    measured: Measurements, assumptions: Assumptions
) -> Iterator[tuple[int, Measurements, Estimate]]:
    """For each of two stripes: its laser, and the measurements and the ring without it.

    Nothing is returned for other numbers of stripes. Assumed radii are not used: with them the length of one stripe
    determines the angle at which it crosses the face, but not to which side (`evidence_with_radii`).
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


def evidence_with_radii(solved: Solved, measured: Measurements, alone: Measurements, laser: int) -> float:
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


def ends_evidence(estimate: Estimate, measured: Measurements) -> float:
    """Log likelihood ratio of the ends of a single stripe on both arcs of a ring, against one of them anywhere.

    An end is r / (1 - h) off the others' prediction, whose variance with its own is 1 / (1 - h), both in its standard
    deviations: ln N(r / (1 - h); 0, 1 / (1 - h)) + ln(range), Eq. (5.13). The range is the length of what is seen. The
    evidence is the end that the others predict best; with fewer than four ends there is none.
    """
    points = measured.points
    if len(set(points.ends.tolist())) < BOTH_ARCS:
        return -np.inf
    ends = estimate.residuals.observations.view.ends
    rows = slice(ends, ends + len(points.x))
    free, remaining = 1.0 - estimate.leverages[rows], estimate.remaining[rows]
    log_range = np.log(np.ptp(points.x) / points.sigma_x)
    evidence = log_range + 0.5 * np.log(free / (2.0 * np.pi)) - 0.5 * remaining**2 / free
    return float(evidence.max())
