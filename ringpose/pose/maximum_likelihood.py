"""Method `ml`: the maximum-likelihood ring with its covariance (ringpose-method(7), section 5)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import sqrt

import numpy as np

from ringpose.estimate.covariance import (
    CURVATURE_OUT,
    EDGE_ON_BELOW,
    Quantities,
    covariance_of_competing,
    determined,
    joint_covariance,
    poorly_determined_flags,
    quantities,
    reported_pose,
    second_order_bias_m,
    with_second_order,
)
from ringpose.estimate.hypotheses import (
    Hypothesis,
    chi2,
    degrees_of_freedom,
    reject_outliers,
    with_edges_exchanged,
)
from ringpose.estimate.measurements import Measurements, measurements_of
from ringpose.estimate.nuisance import rig_errors
from ringpose.estimate.residuals import CURVATURE, Prior
from ringpose.estimate.solver import Estimate
from ringpose.geometry.rays import GRAZING
from ringpose.pose.catalogue import likely_ring, ring_posterior
from ringpose.pose.drift import plane_evidence
from ringpose.types.arrays import Array, Float64
from ringpose.types.detection import BreakPointFlag, BreakPoints, RingEdgePoints
from ringpose.types.pose import NoPose, PoseFlag, RingPose
from ringpose.types.rig import Rig
from ringpose.types.ring import KnownRadii, Ring

DOUBTS = PoseFlag.ASSIGNMENT_AMBIGUOUS | PoseFlag.STRIPE_REJECTED | PoseFlag.RADIUS_INCONSISTENT
"""Shots with one of these flags contribute no evidence about the rig."""

SIDE_MARGIN = 9.0
"""Margin in chi-squared from which the better of two sides for the centre counts as known: 3 sigma."""


def most_likely_pose(
    break_points: BreakPoints,
    rig: Rig,
    ring_edges: RingEdgePoints | None = None,
    known: KnownRadii | Sequence[Ring] | None = None,
) -> RingPose | NoPose:
    """The pose, or the reason why there is none; covariances are None if the covariance of a break point is NaN.

    The radii of a catalogue's ring are used if the shot identifies it with high probability.
    """
    measured = measurements_of(break_points, rig, ring_edges)
    if not len(measured.points.x):
        return NoPose.TOO_FEW_BREAK_POINTS
    if not bool(np.isfinite(measured.points.x + measured.points.y).all()):
        return NoPose.UNTRIANGULATED
    radii = known if isinstance(known, KnownRadii) else None
    best, side_known = _better_side(break_points, measured, rig, Prior(radii))
    if best is None:
        return _why_no_estimate(measured, rig)
    if known is None or isinstance(known, KnownRadii):
        return _pose(best, rig, side_known)
    posterior = _posterior(best, known)
    ring = likely_ring(posterior, known)
    if ring is not None:
        with_radii, side_known = _better_side(break_points, measured, rig, Prior(ring.known_radii))
        best = with_radii or best
    pose = _pose(best, rig, side_known)
    return pose if isinstance(pose, NoPose) else replace(pose, ring_posterior=posterior)


def _better_side(
    break_points: BreakPoints, measured: Measurements, rig: Rig, prior: Prior
) -> tuple[Hypothesis | None, bool]:
    """The best hypothesis, and whether the centre's side is known: edges that were guessed are tried both ways."""
    errors, labelled = rig_errors(rig), break_points.labelled
    best = reject_outliers(measured, rig, prior, errors, labelled)
    guessed = bool((break_points.flags[break_points.seen] & int(BreakPointFlag.EDGE_UNKNOWN)).any())
    if not guessed:
        return best, True
    other = reject_outliers(with_edges_exchanged(measured), rig, prior, errors, labelled)
    if best is None or other is None:
        return best or other, True
    first, second = sorted((best, other), key=_side_score)
    return first, _side_score(second) - _side_score(first) > SIDE_MARGIN


def _side_score(hypothesis: Hypothesis) -> float:
    """Penalised chi-squared, and that of a negative curvature, which puts the centre on the wrong side."""
    estimate = hypothesis.estimate
    variance = float(estimate.inverse[CURVATURE, CURVATURE])
    return hypothesis.score + min(estimate.state.curvature, 0.0) ** 2 / variance


def _why_no_estimate(measured: Measurements, rig: Rig) -> NoPose:
    """Whether a ray runs along its light plane, or meets it behind the camera."""
    points = measured.points
    rays = np.stack([points.x, points.y, np.ones_like(points.x)], axis=-1)
    cosine = (rays * rig.lasers.normal[points.laser]).sum(axis=1)
    behind = rig.lasers.distance_m[points.laser] * cosine <= 0
    grazing = np.abs(cosine) < GRAZING * np.sqrt((rays * rays).sum(axis=1))
    return NoPose.UNTRIANGULATED if bool((grazing | behind).any()) else NoPose.NOT_FINITE


def _posterior(best: Hypothesis, rings: Sequence[Ring]) -> Mapping[str, float]:
    estimate = best.estimate
    covariance = joint_covariance(estimate, quantities(estimate), best.measured)[CURVATURE_OUT:, CURVATURE_OUT:]
    return ring_posterior(abs(estimate.state.curvature), estimate.state.band_m, covariance, rings)


def _pose(best: Hypothesis, rig: Rig, side_known: bool) -> RingPose | NoPose:
    """The pose of the best hypothesis, with everything that is not determined set to NaN and flagged."""
    estimate = best.estimate
    found = quantities(estimate)
    covariance = _covariance(best, found)
    if not bool(np.isfinite(covariance).all()):
        return NoPose.NOT_FINITE
    bias_m = second_order_bias_m(covariance, estimate)
    covariance = with_second_order(covariance, bias_m, estimate)
    position_m = estimate.residuals.origin.position_m
    if abs(float(position_m @ estimate.state.normal)) < EDGE_ON_BELOW * sqrt(float(position_m @ position_m)):
        return NoPose.EDGE_ON
    reported = determined(best, covariance, side_known)
    if not reported.grasp and not reported.normal:
        return NoPose.COLLINEAR if len(set(best.measured.points.laser.tolist())) > 1 else NoPose.UNDETERMINED
    pose = reported_pose(estimate, found, covariance if best.measured.has_covariances else None, reported)
    side = PoseFlag(0) if side_known else PoseFlag.SIDE_UNKNOWN
    return replace(
        pose,
        residual_rms_px=_residual_rms_px(estimate, best.measured, rig),
        flags=best.flag | poorly_determined_flags(estimate, found, covariance, reported, bias_m) | side,
        remark=best.remark,
        plane_evidence=None if best.flag & DOUBTS else plane_evidence(estimate, best.measured, rig),
    )


def _covariance(best: Hypothesis, found: Quantities) -> Float64[Array, "15 15"]:
    """Joint covariance; of an inconsistent shot times its reduced chi-squared, plus that of the competing fits."""
    estimate = best.estimate
    covariance = joint_covariance(estimate, found, best.measured)
    if best.flag & PoseFlag.INCONSISTENT:
        dof = degrees_of_freedom(estimate, best.measured, best.prior)
        covariance = covariance * max(chi2(estimate, best.measured) / dof, 1.0)
        covariance += covariance_of_competing(best.competing, estimate, found)
    return covariance


def _residual_rms_px(estimate: Estimate, measured: Measurements, rig: Rig) -> float:
    """Root mean square distance of the break points from the predicted ones: along their lines, and across."""
    points, residuals, matrix = measured.points, estimate.residuals, rig.camera.camera_matrix
    along_px = residuals.circles.distance / residuals.distance_wrt_x * matrix[0, 0]
    across_px = (points.y - residuals.y) * matrix[1, 1]
    return sqrt(float(((1.0 + residuals.slope**2) * along_px**2 + across_px**2).sum()) / len(along_px))
