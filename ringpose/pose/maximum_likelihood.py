"""Method `ml`: the most likely ring with its covariance, and what of it is determined (method(7), section 5)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import sqrt

import numpy as np

from ringpose.geometry.rays import GRAZING
from ringpose.pose.catalogue import likely_ring, ring_posterior
from ringpose.pose.covariance import (
    BEND,
    EDGE_ON_BELOW,
    Quantities,
    bow_m,
    covariance_of,
    determined,
    poorly_determined_flags,
    quantities,
    reported_pose,
    spread_of,
    with_second_order,
)
from ringpose.pose.drift import plane_evidence
from ringpose.pose.measurements import Measurements, measurements_of
from ringpose.pose.nuisance import rig_errors
from ringpose.pose.outlier_rejection import Hypothesis, chi2, explained, freedom, swapped
from ringpose.pose.residuals import CURVATURE, Prior
from ringpose.pose.solver import Fit
from ringpose.types.arrays import Array, Float64
from ringpose.types.detection import BreakPointFlag, BreakPoints, RingEdgePoints
from ringpose.types.pose import NoPose, PoseFlag, RingPose
from ringpose.types.rig import Rig
from ringpose.types.ring import KnownRadii, Ring

DOUBTS = PoseFlag.RELABELLED | PoseFlag.STRIPE_LEFT_OUT | PoseFlag.RADIUS_DISAGREES
"""A shot that had to be mended says nothing about the rig."""

SIDE_MARGIN = 9.0
"""By how much, in squared standard deviations, the better of two sides for the centre must fit: 3 sigma."""


def most_likely_pose(
    break_points: BreakPoints,
    rig: Rig,
    ring_edges: RingEdgePoints | None = None,
    known: KnownRadii | Sequence[Ring] | None = None,
) -> RingPose | NoPose:
    """The most likely pose, or the reason why there is none; covariances are None if a break point's is NaN.

    Of a catalogue the ring that it is by all likelihood lends its radii; if it may be several, or none of these, the
    radii stay unknown.
    """
    measured = measurements_of(break_points, rig, ring_edges)
    impossible = _why_impossible(measured)
    if impossible is not None:
        return impossible
    radii = known if isinstance(known, KnownRadii) else None
    best, sure_of_side = _on_the_better_side(break_points, measured, rig, Prior(radii))
    if best is None:
        return _why_nothing_fits(measured, rig)
    if known is None or isinstance(known, KnownRadii):
        return _pose(best, rig, sure_of_side)
    posterior = _posterior(best, known)
    ring = likely_ring(posterior, known)
    if ring is not None:
        with_radii = _on_the_better_side(break_points, measured, rig, Prior(ring.known_radii))
        best, sure_of_side = (with_radii[0] or best), with_radii[1]
    pose = _pose(best, rig, sure_of_side)
    return pose if isinstance(pose, NoPose) else replace(pose, ring_posterior=posterior)


def _posterior(best: Hypothesis, rings: Sequence[Ring]) -> Mapping[str, float]:
    fit = best.fit
    joint = covariance_of(fit, quantities(fit), best.measured)
    return ring_posterior(abs(fit.state.curvature), fit.state.band_m, joint[BEND:, BEND:], rings)


def _why_impossible(measured: Measurements) -> NoPose | None:
    """Why these points determine nothing: none was seen, or one where no ray goes."""
    points = measured.points
    if not len(points.x):
        return NoPose.TOO_FEW_BREAK_POINTS
    if not bool(np.isfinite(points.x + points.y).all()):
        return NoPose.UNTRIANGULATED
    return None


def _why_nothing_fits(measured: Measurements, rig: Rig) -> NoPose:
    points = measured.points
    rays = np.stack([points.x, points.y, np.ones_like(points.x)], axis=-1)
    cosine = (rays * rig.lasers.normal[points.laser]).sum(axis=1)
    behind = rig.lasers.distance_m[points.laser] * cosine <= 0
    grazing = np.abs(cosine) < GRAZING * np.sqrt((rays * rays).sum(axis=1))
    return NoPose.UNTRIANGULATED if bool((grazing | behind).any()) else NoPose.NOT_FINITE


def _on_the_better_side(
    break_points: BreakPoints, measured: Measurements, rig: Rig, before: Prior
) -> tuple[Hypothesis | None, bool]:
    """The best explanation and whether its side is sure: guessed edges are tried both ways round."""
    errors, labelled = rig_errors(rig), break_points.labelled
    best = explained(measured, rig, before, errors, labelled)
    guessed = bool((break_points.flags[break_points.seen] & int(BreakPointFlag.EDGE_UNKNOWN)).any())
    if not guessed:
        return best, True
    other = explained(swapped(measured), rig, before, errors, labelled)
    if best is None or other is None:
        return best or other, True
    first, second = sorted((best, other), key=_side_score)
    return first, _side_score(second) - _side_score(first) > SIDE_MARGIN


def _side_score(explanation: Hypothesis) -> float:
    """Its score; a curvature below zero says by how many of its standard deviations it is on the wrong side."""
    fit = explanation.fit
    return explanation.score + min(fit.state.curvature, 0.0) ** 2 / float(fit.inverse[CURVATURE, CURVATURE])


def _pose(best: Hypothesis, rig: Rig, sure_of_side: bool) -> RingPose | NoPose:
    fit = best.fit
    found = quantities(fit)
    joint = _joint_covariance(best, found)
    if not bool(np.isfinite(joint).all()):
        return NoPose.NOT_FINITE
    bow = bow_m(joint, fit)
    joint = with_second_order(joint, bow, fit)
    position = fit.rows.origin.position_m
    if abs(float(position @ fit.state.normal)) < EDGE_ON_BELOW * sqrt(float(position @ position)):
        return NoPose.EDGE_ON
    known = determined(best, joint, sure_of_side)
    if not known.grasp and not known.normal:
        return NoPose.COLLINEAR if len(set(best.measured.points.laser.tolist())) > 1 else NoPose.UNDETERMINED
    pose = reported_pose(fit, found, joint if best.measured.sure else None, known)
    side = PoseFlag(0) if sure_of_side else PoseFlag.SIDE_UNKNOWN
    return replace(
        pose,
        residual_rms_px=_residual_rms_px(fit, best.measured, rig),
        flags=best.flag | poorly_determined_flags(fit, found, joint, known, bow) | side,
        remark=best.remark,
        plane_evidence=None if best.flag & DOUBTS else plane_evidence(fit, best.measured, rig),
    )


def _joint_covariance(best: Hypothesis, found: Quantities) -> Float64[Array, "15 15"]:
    """That of the fit; of one that contradicts itself as much more as its residuals say and its rivals are apart."""
    fit = best.fit
    joint = covariance_of(fit, found, best.measured)
    if best.flag & PoseFlag.INCONSISTENT:
        joint = joint * max(chi2(fit, best.measured) / freedom(fit, best.measured, best.before), 1.0)
        joint += spread_of(best.rivals, fit, found)
    return joint


def _residual_rms_px(fit: Fit, measured: Measurements, rig: Rig) -> float:
    """Distance of the break points from those that the pose predicts: along their lines, and from these."""
    points, rows, matrix = measured.points, fit.rows, rig.camera.camera_matrix
    along = rows.arcs.distance_m / rows.by_x * matrix[0, 0]
    across = (points.y - rows.y) * matrix[1, 1]
    return sqrt(float(((1.0 + rows.slope**2) * along**2 + across**2).sum()) / len(along))
