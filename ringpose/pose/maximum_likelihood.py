"""Method `ml`: the maximum-likelihood ring with its covariance (ringpose-method(7), section 5)."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from math import isfinite, isnan, sqrt
from typing import NamedTuple

import numpy as np

from ringpose.estimate.budget import error_budget
from ringpose.estimate.covariance import (
    BAND_OUT,
    CENTER,
    CURVATURE_OUT,
    EDGE_ON_BELOW,
    GRASP,
    GRASP_UNKNOWN_FROM_M,
    TILTS,
    UNKNOWN_FROM,
    WEAK_SD,
    Quantities,
    difference_from,
    exceeds_sd,
    joint_covariance,
    quantities,
    ring_velocity,
    second_order_bias_m,
    standard_deviation,
    with_second_order,
    with_unknown_distance,
)
from ringpose.estimate.explanation import explain
from ringpose.estimate.factors.prior import Prior
from ringpose.estimate.hypotheses import Explanation
from ringpose.estimate.information import plane_evidence, prior_rows, ring_measurement
from ringpose.estimate.measurements import Measurements, measurements_of
from ringpose.estimate.ring_estimate import MIN_FREEDOM, STRIPES_OF_A_PLANE, Estimate, edge_mean_square
from ringpose.estimate.selection import WIDER
from ringpose.estimate.separation import solution_separation
from ringpose.estimate.solver import CERTAIN_SIGMAS
from ringpose.estimate.stripe_evidence import edge_evidence, ends_evidence
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.geometry.rays import GRAZING
from ringpose.geometry.ring import EDGE_SIGN
from ringpose.measure import status
from ringpose.optics.feature_errors import AGREEMENT
from ringpose.pose.catalogue import likely_ring, ring_posterior
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.assumptions import IDEAL, Assumptions
from ringpose.types.detection import BreakPointFlag, BreakPoints, JudgedRing, Rejection, RingEdgePoints
from ringpose.types.finding import NOTHING, Finding
from ringpose.types.options import Method
from ringpose.types.pose import (
    KnownRadii,
    NoPose,
    PlaneEvidence,
    PoseResult,
    Priors,
    RadiusPrior,
    Ring,
    RingPose,
    RingVelocity,
)
from ringpose.types.rig import Rig

RIG_SUSPECT = Finding.WRONG_STRIPE | Finding.UNEXPLAINED | WIDER
"""Findings of an explanation for which an error of the rig is an alternative."""

VERIFIED_BELOW = 0.01 / CERTAIN_SIGMAS
"""Relative standard deviation of the radius by the shot alone below which an assumed radius counts as verified: an
error of 1 % then contradicts the shot. With 1 % here, radii up to 4 % off were neither contradicted nor flagged."""

CURVED_SIGMAS = 3.0
"""Curvature in standard deviations from which a shot shows a ring, not a straight bar."""

ENDS_OF_A_RING = 3
"""Number of clear ends of stripes that show a ring if no stripe lacks one."""


def most_likely_pose(
    break_points: BreakPoints,
    rig: Rig,
    ring_edges: RingEdgePoints | None = None,
    known: KnownRadii | Sequence[Ring] | None = None,
    assumptions: Assumptions = IDEAL,
    lasers_on: Bool[Array, "laser"] | None = None,
    rejected: Sequence[Rejection] = (),
    camera: CameraMotion | None = None,
    judged: JudgedRing | None = None,
) -> PoseResult:
    """The pose, or the reason why there is none; covariances are None if the covariance of a break point is NaN.

    The radii of a catalogue's ring are used if the shot identifies it with high probability. `lasers_on`: which lasers
    were on in the shot, to report those whose stripe is missing; None if unknown. `rejected`: what the detector has
    rejected. `camera`: its motion, which is removed from that of the target; None for a camera that counts as inertial.
    `judged`: the ring by which the break points were judged, from which the iteration starts.
    """
    untimed = _untimed(break_points, assumptions, moving=camera is not None)
    assumptions = replace(assumptions, motion=None) if untimed else assumptions
    measured = measurements_of(break_points, rig, ring_edges, camera)

    def without(reason: NoPose) -> PoseResult:
        lasers = status.unused_lasers(rig, lasers_on, break_points.of_lasers)
        return PoseResult(pose=reason, lasers=lasers, rejected=tuple(rejected))

    if measured.unusable is not None:
        return without(measured.unusable)
    radii, source, posterior = (known if isinstance(known, KnownRadii) else None), "given", None
    flags_seen = break_points.flags[measured.points.laser, measured.points.edge]
    named = not bool((flags_seen & int(BreakPointFlag.EDGE_UNKNOWN)).any())
    explained = partial(explain, measured, labelled=break_points.labelled, edges_named=named, judged=judged)
    best = explained(Prior(radii, assumptions))
    if best is None:
        return without(_why_no_estimate(measured))
    if known is not None and not isinstance(known, KnownRadii):
        covariance = joint_covariance(best.estimate, quantities(best.estimate))[CURVATURE_OUT:, CURVATURE_OUT:]
        arcs = best.estimate.arcs
        posterior = ring_posterior(abs(arcs.curvature), 2.0 * arcs.half_band_m, covariance, known)
        ring = likely_ring(posterior, known)
        if ring is not None:
            if ring.tolerance_m is not None:
                assumptions = replace(assumptions, ring_tolerance_m=ring.tolerance_m)
            best = explained(Prior(ring.known_radii, assumptions)) or best
            source = ring.name
    result, findings = _result(best, source)
    displaced = _displaced(rejected)
    doubts = untimed or (Finding.DISPLACED_STRIPE if displaced else _doubts(best, break_points))
    doubts |= _several_faces(best, break_points)
    result = result if untimed or break_points.labelled else _confirmed(result, best, doubts)
    rejected = (*rejected, *result.rejected)
    states, in_view = status.seen_lasers(best, break_points, rig, lasers_on, rejected)
    flags, remark = status.flags_of(findings | doubts | in_view), status.explained(best)
    pose = result.pose
    if not isinstance(pose, NoPose):
        pose = replace(pose, flags=flags, ring_posterior=posterior, remark=remark)
    remark = "; ".join(filter(None, [remark, status.sentences(doubts, laser=displaced)]))
    return replace(result, pose=pose, flags=flags, remark=remark, lasers=states, rejected=rejected)


def _why_no_estimate(measured: Measurements) -> NoPose:
    """The reason for an estimate that is not finite: a ray is nearly parallel to its light plane or meets it behind."""
    points, lasers = measured.points, measured.rig.lasers
    rays = np.stack([points.x, points.y, np.ones_like(points.x)], axis=-1)
    cosine = (rays * lasers.normal[points.laser]).sum(axis=1)
    behind = lasers.distance_m[points.laser] * cosine <= 0
    grazing = np.abs(cosine) < GRAZING * np.sqrt((rays * rays).sum(axis=1))
    return NoPose.UNTRIANGULATED if bool((grazing | behind).any()) else NoPose.NOT_FINITE


def _result(best: Explanation, source: str) -> tuple[PoseResult, Finding]:
    """The pose of the best explanation, with NaN for what is not determined, and the findings about it."""
    estimate, measured = best.estimate, best.measured
    evidence, pose_quantities = _plane_evidence(best), quantities(estimate)
    covariance = _covariance(best, pose_quantities)
    result = PoseResult(
        pose=NoPose.NOT_FINITE,
        stamp_s=measured.reference_s,
        priors=_priors(best, pose_quantities, source),
        rejected=best.rejected,
        plane_evidence=evidence,
    )
    if not bool(np.isfinite(covariance).all()):
        return result, best.findings
    bias_m, inflated = second_order_bias_m(covariance, estimate, pose_quantities), covariance
    covariance = with_second_order(covariance, bias_m, estimate, pose_quantities)
    covariance = with_unknown_distance(covariance, estimate, pose_quantities)
    origin = estimate.arcs.origin
    if abs(float(origin @ pose_quantities.normal)) < EDGE_ON_BELOW * sqrt(float(origin @ origin)):
        return replace(result, pose=NoPose.EDGE_ON), best.findings
    reported = _determined(best, pose_quantities, covariance)
    if not reported.grasp and not reported.normal:
        return replace(result, pose=_why_nothing(best)), best.findings
    findings = best.findings | _open(pose_quantities, covariance, reported) | _unverified(best)
    pose = replace(
        _reported_pose(estimate, pose_quantities, covariance if measured.has_covariances else None, reported),
        residual_rms_px=_residual_rms_px(estimate, measured),
    )
    if not measured.has_covariances:
        return replace(result, pose=pose), findings | Finding.NO_ERRORS | _open_velocity(best)
    velocity, of_velocity = _velocity(best, pose_quantities, findings)
    result = replace(
        result,
        pose=pose,
        velocity=velocity,
        measurement=ring_measurement(estimate, measured, pose_quantities),
        separation=partial(solution_separation, best, pose_quantities),
        budget=partial(error_budget, estimate, pose_quantities, inflated, covariance),
    )
    return result, findings | of_velocity


def _why_nothing(best: Explanation) -> NoPose:
    """Why neither the plane nor a grasp point is determined."""
    if best.differing:
        return NoPose.AMBIGUOUS
    collinear = len(set(best.measured.points.laser.tolist())) > 1
    return NoPose.COLLINEAR if collinear else NoPose.UNDETERMINED


def _open_velocity(best: Explanation) -> Finding:
    """That the velocity cannot be relied on, if there is one: a target that is assumed to be still has none."""
    return NOTHING if best.prior.assumptions.motion is None else Finding.VELOCITY_OPEN


def _velocity(best: Explanation, pose_quantities: Quantities, findings: Finding) -> tuple[RingVelocity | None, Finding]:
    """The velocity, with the mean and variance of the prior where the shot does not determine it, and its findings.

    The velocity of the centre depends on the side of the centre, and on the radius: within the errors of an unknown
    radius not linearly.
    """
    velocity = ring_velocity(best.estimate, pose_quantities)
    if velocity is None:
        return None, NOTHING
    if "velocity" in best.differing or not best.side_known:
        return None, Finding.VELOCITY_OPEN
    return velocity, Finding.VELOCITY_OPEN if Finding.CENTER_OPEN in findings else NOTHING


def _untimed(break_points: BreakPoints, assumptions: Assumptions, *, moving: bool) -> Finding:
    """Whether a motion cannot be estimated although it is assumed.

    Stripes that were taken one after the other need stamps of their own.
    """
    if not (moving or assumptions.motion is not None) or not break_points.labelled:  # the camera or the target
        return NOTHING
    seen = break_points.of_lasers
    stamps = [] if break_points.stamp_s is None else break_points.stamp_s[seen].tolist()
    if int(seen.sum()) == 1 or (len(set(stamps)) == int(seen.sum()) and all(map(isfinite, stamps))):
        return NOTHING
    return Finding.NOT_TIMED


def _displaced(rejected: Sequence[Rejection]) -> str:
    """The laser whose stripe, a third one, the detector found beside the plane of two others; empty if there is none.

    Two stripes always agree with some ring, so that each of the three may be the wrong one.
    """
    return next(
        (rejection.laser or "" for rejection in rejected if rejection.what == "stripe" and isnan(rejection.chi2)), ""
    )


def _doubts(best: Explanation, break_points: BreakPoints) -> Finding:
    """What shows that something else than a ring may have left the shot, such as the side of a board.

    A ring is shown by its curvature, or by given radii; without visible edges also by most ends of its stripes. The two
    ends of a single stripe alone may be those of any surface: visible edges must predict it, or, with given radii, its
    ends on both arcs each other. Without radii these would also be two bars of equal width.
    """
    if not best.estimate.converged:
        return Finding.NOT_CONVERGED | _open_velocity(best)
    curvature, sd = best.estimate.curvature_alone
    if best.prior.radii is None and not curvature > CURVED_SIGMAS * sd:
        return Finding.STRAIGHT | _open_velocity(best)
    if len(best.measured.edges.edge):
        single = len(set(best.measured.observations.laser.tolist())) == 1
        if single and not edge_evidence(best.estimate, best.measured) >= AGREEMENT:  # also if it is NaN
            return Finding.OTHER_SURFACE | _open_velocity(best)
        return NOTHING
    seen, is_alone = break_points.seen, len(best.measured.stripes) == 1
    if is_alone and best.prior.radii is not None and ends_evidence(best.estimate, best.measured) >= AGREEMENT:
        return Finding.CENTER_OPEN | Finding.RADIUS_OPEN  # not linear in the stripe's distance from the centre
    clear = int((seen & (break_points.flags & int(BreakPointFlag.UNCLEAR) == 0)).sum())
    one_missing = bool((seen.sum(axis=1)[break_points.of_lasers] < len(EDGE_SIGN)).any())
    if clear < ENDS_OF_A_RING or (clear == ENDS_OF_A_RING and one_missing):
        return Finding.FEW_ENDS | _open_velocity(best)
    return Finding.ONE_STRIPE_ALONE if is_alone else NOTHING


def _several_faces(best: Explanation, break_points: BreakPoints) -> Finding:
    """Whether another face may be the ring's: given radii that the shot does not contradict are those of this one."""
    seen = bool((break_points.flags & int(BreakPointFlag.SEVERAL_FACES)).any())
    return Finding.SEVERAL_FACES if seen and best.prior.radii is None else NOTHING


def _confirmed(result: PoseResult, best: Explanation, doubts: Finding) -> PoseResult:
    """The result of unlabelled stripes, without a pose if fewer than three may not be on a ring.

    Nothing shows then that they are light of these lasers at all, as any two lines in a photograph lie in a plane, and
    no quantity of the pose could be used. The measurement may still continue the track of a ring.
    """
    if not doubts & status.NOT_A_RING or len(best.measured.stripes) > STRIPES_OF_A_PLANE:
        return result
    return replace(result, pose=NoPose.UNCONFIRMED, velocity=None)


def _plane_evidence(best: Explanation) -> PlaneEvidence | None:
    """Evidence for errors of the rig; of all measurements where what contradicts one ring may be due to the rig."""
    if best.findings & Finding.WRONG_LASERS:
        return None
    if best.findings & RIG_SUSPECT and len(best.measured.lines.laser) > len(best.measured.stripes):
        return None  # a stripe that was measured twice may have moved in between
    if best.competing or best.findings & RIG_SUSPECT:
        return None if best.everything is None else plane_evidence(best.everything[1], best.everything[0])
    return plane_evidence(best.estimate, best.measured)


def _unverified(best: Explanation) -> Finding:
    """What the pose assumes without a check by the shot itself: its side, the radius, the rig."""
    findings = NOTHING if best.side_known else Finding.SIDE_OPEN
    if best.prior.radii is not None:
        curvature, sd = best.estimate.curvature_alone
        findings |= Finding.RADIUS_ASSUMED if not sd < VERIFIED_BELOW * curvature else NOTHING
    if len(best.measured.stripes) <= STRIPES_OF_A_PLANE:
        findings |= Finding.FEW_STRIPES
    return findings


def _priors(best: Explanation, pose_quantities: Quantities, source: str) -> Priors:
    radius, rig = None, best.measured.rig
    if best.prior.radii is not None:
        inner_m, outer_m = best.prior.radii.radius_m.tolist()
        inner_sd_m, outer_sd_m = best.prior.radii.sd_m.tolist()
        radius = RadiusPrior(
            inner_m=inner_m, outer_m=outer_m, inner_sd_m=inner_sd_m, outer_sd_m=outer_sd_m, source=source
        )
    return Priors(
        assumptions=best.prior.assumptions,
        radius=radius,
        rig_covariance=rig.covariance is not None and bool(np.isfinite(rig.covariance.data).all()),
        moved_planes=rig.moved_planes,
        bent_planes=rig.bows,
        regularization=prior_rows(best.estimate, best.prior, pose_quantities),
    )


def _covariance(best: Explanation, pose_quantities: Quantities) -> Float64[Array, "15 15"]:
    """Joint covariance; for an inconsistent shot it is multiplied by the reduced chi-squared.

    The outer products of the differences from the competing fits are then added. If stripes and break points have no
    redundancy, the factor is the mean square of the visible edges' residuals.
    """
    estimate = best.estimate
    covariance = joint_covariance(estimate, pose_quantities)
    if best.findings & Finding.UNEXPLAINED:
        freedom = estimate.expected_chi2
        ratio = estimate.chi2 / freedom if freedom > MIN_FREEDOM else edge_mean_square(estimate)
        covariance = covariance * max(ratio, 1.0)
        for other in best.competing:
            difference = difference_from(other, quantities(other), estimate, pose_quantities)
            covariance = covariance + np.outer(difference, difference)
    return covariance


def _residual_rms_px(estimate: Estimate, measured: Measurements) -> float:
    """Root mean square distance of the break points from the predicted ones: along their lines, and across."""
    points, residuals, matrix = measured.points, estimate.residuals, measured.rig.camera.camera_matrix
    at, ends, count = residuals.at, residuals.observations.view.ends, len(points.x)
    along_px = residuals.residual[ends : ends + count] * points.sigma_x * matrix[0, 0]
    across_px = (points.y - at.stripes.rays[-count:, 1]) * matrix[1, 1]
    stretch = 1.0 + at.stripes.slope[-count:] ** 2
    return sqrt(float((stretch * along_px**2 + across_px**2).sum()) / len(along_px))


# Which quantities are determined

MAX_RADIUS_M = 5.0
"""Larger rings do not exist: a larger radius comes from break points that are wrong in the same way."""


class _Determined(NamedTuple):
    """Which quantities are determined well enough to be reported."""

    normal: bool
    center: bool
    grasp: bool
    radius: Bool[Array, "edge=2"]


def _determined(best: Explanation, pose_quantities: Quantities, covariance: Float64[Array, "15 15"]) -> _Determined:
    """The normal is determined by its tilts, centre and radii by the curvature, the grasp point by its own sigma.

    A quantity in which comparable explanations of the shot differ is not determined.
    """
    normal = standard_deviation(covariance[TILTS, TILTS]) <= UNKNOWN_FROM
    curvature = best.estimate.arcs.curvature
    curved = sqrt(covariance[CURVATURE_OUT, CURVATURE_OUT]) < UNKNOWN_FROM * curvature
    curved = curved and curvature > 1.0 / MAX_RADIUS_M
    across = np.array([pose_quantities.normal, pose_quantities.outward])
    grasp_sd_m = standard_deviation(across @ covariance[GRASP, GRASP] @ across.T)
    edges = {*best.measured.points.edge.tolist(), *best.measured.edges.edge.tolist()}
    radii_given = best.prior.radii is not None
    radii = (best.side_known or radii_given) and curved and "radius" not in best.differing
    grasp = max(grasp_sd_m, sqrt(covariance[BAND_OUT, BAND_OUT])) <= GRASP_UNKNOWN_FROM_M
    return _Determined(
        normal=normal and "normal" not in best.differing,
        center=normal and best.side_known and curved and "center" not in best.differing,
        grasp=grasp and "grasp" not in best.differing,
        radius=np.array([radii and (edge in edges or radii_given) for edge in range(2)]),
    )


def _reported_pose(
    estimate: Estimate, pose_quantities: Quantities, covariance: Float64[Array, "15 15"] | None, reported: _Determined
) -> RingPose:
    """The pose, with NaN for what is not determined; without covariances if there is none.

    The condition number is that of the Jacobian of all residuals, its columns scaled to unit length.
    """
    unknown, of_seven = np.full(3, np.nan), None
    kept = np.array([reported.normal] * 3 + [reported.center] * 2 + reported.radius.tolist())
    if covariance is not None and kept.any():
        of_seven = covariance[:7, :7] if kept.all() else np.where(kept[:, None] & kept, covariance[:7, :7], np.nan)
    scale = 1.0 / np.sqrt(np.maximum(estimate.normal_matrix.diagonal(), np.finfo(float).tiny))
    values = np.linalg.eigvalsh(estimate.normal_matrix * scale[:, None] * scale)
    radius_inner_m, radius_outer_m = np.where(reported.radius, pose_quantities.radius_m, np.nan).tolist()
    return RingPose(
        center_m=pose_quantities.center_m if reported.center else unknown,
        normal=pose_quantities.normal if reported.normal else unknown,
        radius_inner_m=radius_inner_m,
        radius_outer_m=radius_outer_m,
        grasp_m=pose_quantities.grasp_m if reported.grasp else unknown,
        method=Method.ML.value,
        condition_number=float(np.sqrt(values[-1] / max(float(values[0]), np.finfo(float).eps))),
        residual_rms_px=np.nan,
        covariance=of_seven,
        covariance_center_m2=None if covariance is None or not reported.center else covariance[CENTER, CENTER],
        covariance_grasp_m2=None if covariance is None or not reported.grasp else covariance[GRASP, GRASP],
    )


def _open(pose_quantities: Quantities, covariance: Float64[Array, "15 15"], reported: _Determined) -> Finding:
    """What is not determined, or has a sigma over `WEAK_SD`."""
    limit_m = WEAK_SD * min(map(abs, pose_quantities.radius_m.tolist()))
    findings = NOTHING if reported.normal else Finding.NORMAL_OPEN
    if not reported.grasp:
        findings |= Finding.GRASP_OPEN
    if not reported.center or exceeds_sd(covariance[CENTER, CENTER], limit_m):
        findings |= Finding.CENTER_OPEN
    if not reported.radius.all() or max(covariance[5, 5], covariance[6, 6]) > limit_m**2:
        findings |= Finding.RADIUS_OPEN
    return findings
