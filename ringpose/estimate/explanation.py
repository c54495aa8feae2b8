"""The explanation of a shot: its ring to the precision of a pose, with the radii, sides and tilt that the shot shows.

`ringpose.estimate.selection` finds the best hypothesis for given names of the edges and given radii. Where an
explanation by other radii, the other side or the other tilt is comparable, only the quantities that they have in common
are determined (`Explanation.differing`).
"""

from dataclasses import replace
from math import atan2, inf, isfinite

import numpy as np

from ringpose.estimate.covariance import differing_quantities
from ringpose.estimate.factors.edges import TERMS
from ringpose.estimate.factors.prior import Prior
from ringpose.estimate.hypotheses import Explanation
from ringpose.estimate.linearization import PARAMETERS, ring_residuals
from ringpose.estimate.measurements import Measurements
from ringpose.estimate.ring_estimate import Estimate, estimate_ring, precise_ring
from ringpose.estimate.selection import Search, explained_as_named
from ringpose.estimate.solver import CERTAIN_SIGMAS, NEAR_SIGMAS, PRECISE_SIGMAS, initial_guess
from ringpose.geometry.ring import CURVATURE, EDGE_SIGN, HALF_BAND, RingArcs, motion_derivatives, rotation_by
from ringpose.geometry.rotations import cross
from ringpose.types.detection import JudgedRing, Rejection
from ringpose.types.finding import Finding
from ringpose.types.pose import KnownRadii


def explain(
    measured: Measurements,
    prior: Prior,
    *,
    labelled: bool,
    edges_named: bool,
    precise: bool = True,
    judged: JudgedRing | None = None,
) -> Explanation | None:
    """The best explanation of the measurements; None if no estimate converges.

    `labelled`: whether the lasers were identified by switching them. `edges_named`: whether it is known which edges are
    the inner ones; if it is not, or if the centre turns out to be on the other side, both ways are tried. `precise`:
    whether the ring is needed to the precision of a pose, and not only the decision. `judged`: the ring by which the
    break points were judged; the estimate from all measurements starts there.
    """
    guess, search = None, Search(labelled, edges_named, for_pose=precise)
    if precise:  # the decision is the same at any time
        measured, guess = _at_reference_time(measured, prior)
    if judged is not None:
        search = search._replace(start=judged)
    best = _decided(measured, prior, guess, search)
    if best is None or not precise:
        return best
    estimate: Estimate | None = best.estimate
    if best.estimate.distance_sigmas >= PRECISE_SIGMAS:
        estimate = precise_ring(best.estimate)
    if estimate is not None and abs(estimate.chi2 - best.estimate.chi2) < NEAR_SIGMAS:
        best = replace(best, estimate=estimate)
    else:  # the shorter iteration had ended near a saddle point
        best = _decided(measured, prior, guess, search._replace(tolerance_sigmas=PRECISE_SIGMAS))
    if best is None:
        return None
    best = _with_other_tilt(best)
    competing = (*best.competing, *([] if best.other_side is None else [best.other_side]))
    differing = frozenset[str]().union(*(differing_quantities(best.estimate, each) for each in competing))
    return replace(best, differing=differing)


def _with_other_tilt(best: Explanation) -> Explanation:
    """The explanation with that of the two tilts about a single stripe which fits better, and the other if it may hold.

    Only the visible edges show this tilt, and an ellipse is the image of two circles, whose normals are mirrored in the
    line of sight (Dhome et al., 1990): the one of the other tilt through the same stripe is tried.
    """
    measured, estimate = best.measured, best.estimate
    lasers = set(measured.observations.laser.tolist())
    if len(lasers) > 1 or not len(measured.edges.edge) or not estimate.determined:
        return best
    arcs, rates, normal = estimate.arcs, estimate.rates, estimate.arcs.axes[2]
    along = cross(measured.rig.lasers.normal[lasers.pop()], normal)
    along /= np.linalg.norm(along)
    sight = -arcs.center
    turn_rad = 2.0 * atan2(float(along @ cross(normal, sight)), float(normal @ sight))
    start = JudgedRing(
        origin_m=arcs.origin,
        axes=arcs.axes @ rotation_by(turn_rad * along).T,
        curvature_per_m=arcs.curvature,
        half_band_m=arcs.half_band_m,
        velocity_m_s=rates.velocity_m_s,
        rate_rad_s=rates.rate_rad_s,
        stamp_s=measured.reference_s if isfinite(measured.reference_s) else None,
    )
    other = estimate_ring(measured, best.prior, start)
    if other is None or not differing_quantities(estimate, other):
        return best
    of_both = [each.chi2 + TERMS * float(np.square(each.edge_residuals).mean()) for each in (estimate, other)]
    if abs(of_both[1] - of_both[0]) > CERTAIN_SIGMAS**2:
        return best if of_both[0] < of_both[1] else replace(best, estimate=other)
    first, second = (estimate, other) if of_both[0] <= of_both[1] else (other, estimate)
    return replace(best, estimate=first, competing=(*best.competing, second))


def decision(measured: Measurements, prior: Prior, *, labelled: bool, edges_named: bool) -> Explanation | None:
    """The explanation of `explain` without the precision of a pose; None also if the normal equations are singular."""
    try:
        return explain(measured, prior, labelled=labelled, edges_named=edges_named, precise=False)
    except np.linalg.LinAlgError:
        return None


def _at_reference_time(measured: Measurements, prior: Prior) -> tuple[Measurements, RingArcs | None]:
    """The measurements with t_0 the mean of their stamps, weighted by the information on the ring's position.

    At this time pose and rates are least correlated (ringpose-method(7), section 8). Also the initial guess of the
    ring, None if it was not needed or there is none.
    """
    stamp_s, observations = measured.stamp_s, measured.observations
    first = float(stamp_s.min(initial=np.inf))
    if not 0.0 < float(stamp_s.max()) - first < np.inf:  # of a single instant, or unknown
        return measured, None
    arcs = initial_guess(measured, prior)
    if arcs is None:
        return measured, None
    residuals = ring_residuals(arcs, observations, Prior())
    rows = residuals.jacobian[: len(stamp_s)] @ motion_derivatives(arcs, arcs, 1.0)[:, PARAMETERS : PARAMETERS + 3]
    weight = (rows * rows).sum(axis=1)
    if not 0.0 < float(weight.sum()) < np.inf:
        return measured, arcs
    moved = replace(measured, reference_s=first + float(weight @ (stamp_s - first) / weight.sum()))
    covered = measured.camera is None or moved.observations.view.camera is not None  # by the robot's poses
    return (moved if covered else measured), arcs


def _decided(measured: Measurements, prior: Prior, guess: RingArcs | None, search: Search) -> Explanation | None:
    """The best explanation with the radii of the prior or, if the shot contradicts them, without."""
    best = _better_side(measured, prior, guess, search)
    if prior.radii is None or best is None or Finding.WRONG_RADIUS in best.findings:
        return best
    # visible edges are too many to be compared with two radii by chi-squared: the ring without the radii is, unless a
    # weak prior holds its radii, as that of a single stripe
    alone = _better_side(measured, prior._replace(radii=None), None, search)
    if alone is None or not alone.estimate.determined or not _contradicts(alone.estimate, prior.radii):
        return best
    return replace(
        alone,
        findings=alone.findings | Finding.WRONG_RADIUS,
        rejected=(*alone.rejected, Rejection(what="radius")),
    )


def _contradicts(alone: Estimate, radii: KnownRadii) -> bool:
    """Whether the ring estimated from the shot alone has other radii than the assumed ones.

    The curvatures of the edges, k = 1 / radius, are compared: their errors are Gaussian even where those of radii are
    not.
    """
    arcs = alone.arcs
    for radius_m, sign, assumed_m, sd_m in zip(
        arcs.radius_m.tolist(), EDGE_SIGN, radii.radius_m.tolist(), radii.sd_m.tolist(), strict=True
    ):
        if assumed_m != assumed_m:
            continue
        wrt_step = np.zeros(PARAMETERS)
        wrt_step[CURVATURE], wrt_step[HALF_BAND] = (arcs.mean_radius_m / radius_m) ** 2, -sign / radius_m**2
        variance = float(wrt_step @ alone.inverse @ wrt_step) + (sd_m / assumed_m**2) ** 2
        if (1.0 / radius_m - 1.0 / assumed_m) ** 2 > CERTAIN_SIGMAS**2 * variance:
            return True
    return False


def _better_side(measured: Measurements, prior: Prior, guess: RingArcs | None, search: Search) -> Explanation | None:
    """The best explanation, with inner and outer edges as they are named or exchanged."""
    best, edges_named = explained_as_named(measured, prior, search, guess=guess), search.edges_named
    search = search._replace(start=None)  # with edges exchanged it is another ring
    if best is not None:
        curvature, sd = best.estimate.curvature_alone
        # with unknown rates, both sides may explain a shot with a significant curvature each
        compared = len(best.estimate.residuals.rate_sds) and not len(measured.edges.edge) and not edges_named
        if curvature > (-CERTAIN_SIGMAS if edges_named else CERTAIN_SIGMAS) * sd and not compared:
            return best
        if not compared and _is_unique(best) and (curvature >= 0 or not search.for_pose):
            # with its edges exchanged this would be the same ring, with the opposite curvature
            return replace(best, edges_exchanged=curvature < 0, side_known=abs(curvature) > CERTAIN_SIGMAS * sd)
    max_score = inf if best is None else _side_score(best) + CERTAIN_SIGMAS**2
    other = explained_as_named(measured.with_edges_exchanged(), prior, search, max_score=max_score)
    other = None if other is None else replace(other, edges_exchanged=True)
    if best is None or other is None:
        only = best or other
        return None if only is None else replace(only, side_known=False)
    first, second = sorted((best, other), key=_side_score)
    clear = _side_score(second) - _side_score(first) > CERTAIN_SIGMAS**2
    side_known = clear and not (edges_named and first.edges_exchanged)
    if clear:
        return replace(first, side_known=side_known)
    same = _left_out(first) == _left_out(second)
    competing = first.competing if same else (*first.competing, second.estimate)
    return replace(first, side_known=side_known, other_side=second.estimate, competing=competing)


def _left_out(explanation: Explanation) -> frozenset[tuple[str, str | None, bool]]:
    """The measurements that an explanation rejects, with edge names as given, to compare explanations of both sides."""
    other = "inner" if explanation.edges_exchanged else "outer"
    return frozenset((each.what, each.laser, each.edge in (other, None)) for each in explanation.rejected)


def _is_unique(best: Explanation) -> bool:
    """Whether an explanation rejects nothing, and no prior prefers one side of the ring: it has a single optimum."""
    prior = best.estimate.prior
    plain = best.everything is not None and best.everything[1] is best.estimate and not best.findings
    return plain and prior.regularize_about is None and not prior.single_edge and prior.radii is None


def _side_score(explanation: Explanation) -> float:
    """Penalised chi-squared, plus that of a negative curvature, with which the centre is on the wrong side."""
    estimate = explanation.estimate
    variance = float(estimate.inverse[CURVATURE, CURVATURE])
    score = estimate.chi2 + explanation.penalty
    return score + min(estimate.arcs.curvature, 0.0) ** 2 / variance
