"""Evidence that a stripe is on the ring, and not on the background, where two stripes or one were seen.

Light planes are nearly parallel, so that any two stripes lie nearly in a plane: two stripes have hardly any redundancy.
"""

from collections.abc import Iterator
from dataclasses import replace
from math import inf, log

import numpy as np

from ringpose.estimate.factors.prior import Prior
from ringpose.estimate.linearization import PARAMETERS
from ringpose.estimate.measurements import Measurements
from ringpose.estimate.ring_estimate import DECISION_SIGMAS, STRIPES_OF_A_PLANE, Estimate, estimate_ring
from ringpose.types.arrays import EDGES
from ringpose.types.assumptions import Assumptions

BACKGROUND_RANGE_PX = (150.0, 30.0, 100.0)
"""Where a stripe on the background may be seen: range of its line's position, of the change along it, of an end."""

LINEAR_SIGMAS = 100.0
"""Standard deviation of a predicted number, in those of the measured one, from which its error is not linear and does
not count: with more, the prediction of right stripes by visible edges is often missed."""


def single_stripe_estimates(
    measured: Measurements, assumptions: Assumptions
) -> Iterator[tuple[int, Measurements, Estimate]]:
    """For each of two stripes: its laser, and the measurements and the ring without it.

    Nothing is returned for other numbers of stripes. Assumed radii are not used: with them the length of one stripe
    determines the angle at which it crosses the face, but not to which side.
    """
    for laser in measured.stripes if len(measured.stripes) == STRIPES_OF_A_PLANE else []:
        alone = measured.without_laser(laser)
        if not len(alone.points.x):
            continue
        estimate = estimate_ring(alone, Prior(assumptions=assumptions), tolerance_sigmas=DECISION_SIGMAS)
        if estimate is not None:
            yield laser, alone, estimate


def ring_evidence(common: Estimate, measured: Measurements, laser: int) -> float:
    """Log likelihood ratio of a laser's stripe on the ring that everything else predicts, against one anywhere (5.12).

    `common` is the ring of all measurements, each of which is there once. The stripe's whitened residuals r have the
    covariance 1 - H, with its block H of the hat matrix: the rest predicts the stripe with the precision
    W^T (1 - H) W, W its whitening, and the prediction is missed by r^T (1 - H)^-1 r in squared standard deviations.
    What the rest leaves open, such as the scale, is as likely as anywhere: ln N(0; 0, range^2 / 2 pi) = -ln(range).

    The problem is linear at the common ring: another stripe alone leaves the tilt about it open, and the least tilted
    ring may be far away. With assumed radii, the length of that stripe determines the angle at which it crosses the
    face, but not to which side: the common ring is one of two.
    """
    residuals, points, lines = common.residuals, measured.points, measured.lines
    observations = residuals.observations
    count, ends = int(np.count_nonzero(~observations.many)), observations.view.ends
    jacobian = np.concatenate([residuals.jacobian, common.nuisance], axis=1) * np.sqrt(common.weights)[:, None]
    prior = np.eye(jacobian.shape[1])[PARAMETERS:]
    basis = np.linalg.qr(np.concatenate([jacobian, prior]))[0][:count]  # normal equations of few stripes are singular
    of_rows = np.concatenate([np.repeat(lines.laser, 2), points.laser, points.laser[points.isolated]])
    rows = np.flatnonzero(of_rows == laser)
    free = np.eye(len(rows)) - basis[rows] @ basis[rows].T
    remaining = common.remaining[rows]
    missed = remaining @ np.linalg.solve(free + np.eye(len(rows)) / LINEAR_SIGMAS**2, remaining)

    # in pixels: ordinates of the lines' two ends, abscissae of the break points, ordinates of those without a line
    focal = measured.rig.camera.camera_matrix[[0, 1], [0, 1]]
    of_points = [1.0 / points.sigma_x / focal[0], observations.points.ordinate_weights(residuals.at)[1] / focal[1]]
    whitening = np.diag(np.concatenate([np.ones(ends), *of_points]))
    position_px, change_px, end_px = BACKGROUND_RANGE_PX
    range_px = np.full(count, position_px)
    range_px[ends : ends + len(points.x)] = end_px
    to_range = np.eye(count)
    if ends:  # position and change of each line
        whitening[:ends, :ends] = observations.whitening / focal[1]
        range_px[1:ends:2] = change_px
        to_range[:ends, :ends] = np.kron(np.eye(ends // 2), [[0.5, 0.5], [-1.0, 1.0]])
    own = np.ix_(rows, rows)
    whitening, to_range, range_px = whitening[own], to_range[own], range_px[rows]
    anywhere = to_range.T @ np.diag(2.0 * np.pi / range_px**2) @ to_range
    predicted = whitening.T @ free @ whitening + anywhere
    log_ring = 0.5 * (np.linalg.slogdet(predicted / (2.0 * np.pi))[1] - missed)
    of_sides = log(2.0) if common.prior.radii is not None and not len(measured.edges.edge) else 0.0
    return float(log_ring + np.log(range_px).sum() - of_sides)


def edge_evidence(common: Estimate, measured: Measurements) -> float:
    """The evidence of `ring_evidence` for a single stripe on the ring that the visible edges predict.

    The edges count as those of the face, not as the feet of walls, whose depth would leave the prediction open.
    """
    measured = measured.of_one_arc()
    if len(measured.points.x) + 2 * len(measured.lines.laser) > measured.stripe_numbers:
        measured = measured.once()  # it must not predict itself
    measured = replace(measured, edges=replace(measured.edges, walls=False))
    again = estimate_ring(measured, common.prior, common, tolerance_sigmas=DECISION_SIGMAS)
    return -inf if again is None else ring_evidence(again, measured, measured.lasers[0])


def ends_evidence(estimate: Estimate, measured: Measurements) -> float:
    """Log likelihood ratio of the ends of a single stripe on both arcs of a ring, against one of them anywhere.

    An end is r / (1 - h) off the others' prediction, whose variance with its own is 1 / (1 - h), both in its standard
    deviations: ln N(r / (1 - h); 0, 1 / (1 - h)) + ln(range), Eq. (5.13). The range is the length of what is seen. The
    evidence is the end that the others predict best; with fewer than four ends there is none.
    """
    points = measured.points
    if len(set(points.ends.tolist())) < 2 * len(EDGES):  # of a stripe across both arcs
        return -np.inf
    ends = estimate.residuals.observations.view.ends
    rows = slice(ends, ends + len(points.x))
    free, remaining = 1.0 - estimate.leverages[rows], estimate.remaining[rows]
    log_range = np.log(np.ptp(points.x) / points.sigma_x)
    evidence = log_range + 0.5 * np.log(free / (2.0 * np.pi)) - 0.5 * remaining**2 / free
    return float(evidence.max())
