"""How far a pose may be off: protection levels, and covariances that contain a rig in doubt (method(7), section 15)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import erfc, exp, inf, log, pi, sqrt
from statistics import NormalDist

import numpy as np

from ringpose.measure.status import unbounded
from ringpose.types.arrays import Array, Float64
from ringpose.types.pose import PoseFlag, RingPose
from ringpose.types.protection import CENTER, GRASP, INWARD, TILTS, WRONG_SIGMAS, Protection, Separation

UNCOVERED_PROBABILITY = 1e-6
"""Probability p_u of what no hypothesis covers."""


def protection_level(
    weight: Float64[Array, "hypothesis"],
    difference: Float64[Array, "hypothesis"],
    sigma: Float64[Array, "hypothesis"],
    allowed: float,
) -> float:
    """The smallest level L that an error exceeds with the probability `allowed` = risk - p_u, Eq. (15.3).

    sum_j w_j [Q((L - |d_j|) / s_j) + Q((L + |d_j|) / s_j)] <= risk - p_u, with the posterior probability w_j of each
    hypothesis, its difference d_j from the accepted solution, which comes first, and its standard deviation s_j.
    Infinite if there is none. By Newton's method for the logarithm of the sum, within the levels that are known to be
    too low and high enough: root finders of scipy.optimize take 0.4 s to import, longer than a command that measures a
    shot.
    """
    if not allowed > 0.0 or not weight[0] > 0.0:  # or the accepted solution is impossible beside another one
        return inf
    distance, lowest = np.abs(difference), float(sigma[0]) * -NORMAL.inv_cdf(0.5 * min(allowed / float(weight[0]), 1.0))
    for _ in range(2):  # from the level of the accepted solution alone, then from the highest of any one alone
        # without what adds nothing even there: Q(x) <= exp(-x^2 / 2) / 2 for x >= 0
        kept = weight * np.exp(-0.5 * (np.maximum(lowest - distance, 0.0) / sigma) ** 2) > NEGLIGIBLE * allowed
        weight, distance, sigma = weight[kept], distance[kept], sigma[kept]
        terms = [*zip(weight.tolist(), distance.tolist(), sigma.tolist(), strict=True)]
        lowest = max([lowest, TINY_LEVEL, *(d - s * NORMAL.inv_cdf(allowed / w) for w, d, s in terms if w > allowed)])
    low, high, level = lowest, inf, lowest
    while level < MAX_GROWTH * lowest:
        exceeded, slope = exceedance(level, terms)
        if exceeded > allowed:
            low = level
        elif level == lowest:
            return lowest
        else:
            high = level
        step = log(exceeded / allowed) * exceeded / slope if min(exceeded, slope) > 0.0 else -inf
        if abs(step) < LEVEL_PRECISION * level:
            return max(level + step, lowest)
        if low < level + step < high:
            level += step
        else:
            level = sqrt(low * high) if high < inf else 2.0 * level
    return inf


def exceedance(level: float, terms: Sequence[tuple[float, float, float]]) -> tuple[float, float]:
    """The left side of Eq. (15.3) at a level, for terms (w, |d|, s), and minus its derivative by the level.

    Written out, as this runs hundreds of times a shot: Q(x) = erfc(x / sqrt 2) / 2, whose derivative is
    -exp(-x^2 / 2) / sqrt(2 pi).
    """
    tails = densities = 0.0
    for weight, distance, sigma in terms:
        below, above = (level - distance) / sigma, (level + distance) / sigma
        tails += weight * (erfc(below * SQRT_HALF) + erfc(above * SQRT_HALF))
        densities += weight / sigma * (exp(-0.5 * below * below) + exp(-0.5 * above * above))
    return 0.5 * tails, DENSITY_AT_ZERO * densities


NORMAL, SQRT_HALF, DENSITY_AT_ZERO = NormalDist(), sqrt(0.5), 1.0 / sqrt(2.0 * pi)

LEVEL_PRECISION, MAX_GROWTH = 1e-6, 3600.0
"""Precision of a level, as a share, and how many times higher than the first bound it may be."""

TINY_WEIGHT = np.finfo(float).tiny

NEGLIGIBLE, TINY_LEVEL = 1e-6, 1e-12
"""Share of the risk of what is left out in the search, and the smallest level: of exact data."""

MAX_ANGLE_RAD = 0.5 * pi
"""Level of the normal from which there is none: the linearisation of the tilts ends long before."""


def protection_of(separation: Separation, pose: RingPose, risk: float, flags: PoseFlag) -> Protection:
    """The levels of a pose at a risk, in the pose's frame, which is also that of the separation.

    The variances are those of the pose; the hypotheses add to them. Quantities that the flags forbid have no level.
    """
    allowed, weight = risk - UNCOVERED_PROBABILITY, separation.weight
    levels, withheld, difference = partial(protection_level, weight), unbounded(flags), separation.difference
    found = Protection(
        risk=risk,
        uncovered=UNCOVERED_PROBABILITY,
        grasp_normal_m=inf,
        grasp_radial_m=inf,
        normal_rad=inf,
        center_m=np.full(3, inf),
    )
    variances = np.einsum("hqq->hq", separation.covariance)
    if pose.covariance_grasp_m2 is not None and "grasp" not in withheld:
        own = (separation.across @ pose.covariance_grasp_m2 @ separation.across.T).diagonal()
        along, radial = (levels(difference[:, row], _sigmas(variances[:, row], own[row]), allowed) for row in (0, 1))
        found = replace(found, grasp_normal_m=along, grasp_radial_m=radial)
    if pose.covariance is not None and "normal" not in withheld and bool(np.isfinite(pose.covariance[:2, :2]).all()):
        smaller, larger = np.linalg.eigvalsh(pose.covariance[:2, :2]).tolist()
        sigma = _sigmas(np.linalg.eigvalsh(separation.covariance[:, TILTS, TILTS])[:, 1], larger)
        angle = levels(np.linalg.norm(difference[:, TILTS], axis=1), sigma, allowed / in_plane(smaller / larger))
        found = replace(found, normal_rad=angle if angle < MAX_ANGLE_RAD else inf)
    if pose.covariance_center_m2 is not None and "center" not in withheld:
        inward, own = -separation.across[1], pose.covariance_center_m2
        sigma = _sigmas(variances[:, INWARD], inward @ own @ inward)
        # the linear error of the centre is that of a curvature k: the radius is off by x R / (1 - x) for x = dk / k
        share = levels(difference[:, INWARD], sigma, allowed) / separation.radius_m
        if share < 1.0:
            axes = [
                levels(difference[:, row], _sigmas(variances[:, row], own[axis, axis]), allowed)
                for axis, row in enumerate(range(CENTER.start, CENTER.stop))
            ]
            found = replace(found, center_m=np.array(axes) / (1.0 - share))
    return found


def with_covariance_scaled(pose: RingPose, factor: float) -> RingPose:
    """The pose with all standard deviations times a factor."""
    full, center, grasp = (
        None if each is None else factor * factor * each
        for each in (pose.covariance, pose.covariance_center_m2, pose.covariance_grasp_m2)
    )
    return replace(pose, covariance=full, covariance_center_m2=center, covariance_grasp_m2=grasp)


def overbound(separation: Separation, pose: RingPose) -> float:
    """Factor on the standard deviations of a pose for what may have happened to the rig without showing, Eq. (15.4).

    Most shots reject a light plane that has moved; in others it fits about as well as the accepted solution. The
    errors are then a mixture, and the smallest Gaussian that overbounds it where it matters (DeCleene, ION GPS 2000) is
    taken: an error of more than `WRONG_SIGMAS` raised standard deviations is as rare as one of a Gaussian. Inflating
    the prior of the rig instead would take the same from all shots, and the second moments of the mixture hardly show a
    hypothesis of small probability. The largest factor of grasp point, normal and centre.
    """
    accepted, planes = set(separation.sets[0]), set[int]()
    planes.update(number for number, name in enumerate(separation.faults) if name.startswith("plane "))
    more = [set(each) - accepted if accepted <= set(each) else set() for each in separation.sets]
    which = [0, *(number for number, each in enumerate(more) if each and each <= planes)]
    weight = np.maximum(separation.weight[which], TINY_WEIGHT)  # that of an accepted solution may have vanished
    weight /= weight.sum()
    has_normal = pose.covariance is not None and bool(np.isfinite(pose.covariance[:2, :2]).all())
    has = (pose.covariance_grasp_m2 is not None, has_normal, pose.covariance_center_m2 is not None)
    factors = [1.0]
    for part in (part for part, is_determined in zip((GRASP, TILTS, CENTER), has, strict=True) if is_determined):
        covariance = separation.covariance[which, part, part]
        whitening = np.linalg.inv(np.linalg.cholesky(covariance[0]))
        distance = np.linalg.norm(separation.difference[which, part] @ whitening.T, axis=1)
        sigma = np.sqrt(np.linalg.eigvalsh(whitening @ covariance @ whitening.T)[:, -1])
        factors.append(protection_level(weight, distance, sigma, erfc(WRONG_SIGMAS * SQRT_HALF)) / WRONG_SIGMAS)
    return max(factors)


def variances_by_source(
    budget: Mapping[str, Float64[Array, "quantity=7 quantity=7"]],
    pose: RingPose,
    separation: Separation,
    *,
    in_camera: bool,
    factor: float = 1.0,
) -> dict[str, dict[str, float]]:
    """The variances of the reported quantities by source, in the frame of the pose, which is that of the separation.

    What a pose in another frame than the camera's has beyond the sources is the error of the camera's pose there, which
    is that of the mount; what the `factor` of `overbound` on its standard deviations adds is the rig's stability.
    """
    across, frame_from_camera = separation.across, separation.rotation
    found: dict[str, dict[str, float]] = {}
    if pose.covariance_grasp_m2 is not None:
        for row, name in enumerate(("grasp_normal_m2", "grasp_radial_m2")):
            found[name] = {source: float(part[row, row]) for source, part in budget.items()}
            found[name][""] = float(across[row] @ pose.covariance_grasp_m2 @ across[row])
    if pose.covariance is not None and bool(np.isfinite(pose.covariance[:2, :2]).all()):
        found["normal_rad2"] = {source: float(np.trace(part[TILTS, TILTS])) for source, part in budget.items()}
        found["normal_rad2"][""] = float(np.trace(pose.covariance[:2, :2]))
    if pose.covariance_center_m2 is not None:
        turned = {
            source: frame_from_camera @ part[CENTER, CENTER] @ frame_from_camera.T for source, part in budget.items()
        }
        for row, axis in enumerate("xyz"):
            found[f"center_{axis}_m2"] = {source: float(part[row, row]) for source, part in turned.items()}
            found[f"center_{axis}_m2"][""] = float(pose.covariance_center_m2[row, row])
    for variances in found.values():
        total = variances.pop("")
        if not in_camera:
            variances["mount"] = variances.get("mount", 0.0) + total - sum(variances.values())
        variances["stability"] = variances.get("stability", 0.0) + (factor * factor - 1.0) * total
    return {name: {source: each for source, each in of.items() if each != 0.0} for name, of in found.items()}


def _sigmas(variance: Float64[Array, "hypothesis"], reported: float) -> Float64[Array, "hypothesis"]:
    """Standard deviations under each hypothesis: what the pose reports beyond the accepted solution adds to all."""
    total = variance + max(reported - float(variance[0]), 0.0)
    total[0] = reported
    sigmas: Float64[Array, "hypothesis"] = np.sqrt(total)
    return sigmas


def in_plane(ratio: float) -> float:
    """How many times as often a Gaussian in the plane exceeds a level as it does along its longer axis, at most.

    `ratio`: of its variances. 1 / sqrt(1 - ratio) far out, and sqrt(pi / 2) times the level in sigmas for a circle.
    """
    return 1.0 / sqrt(max(1.0 - ratio, CIRCLE))


CIRCLE = 1.0 / 36.0
"""The factor of a circle, sqrt(pi / 2) L / s, is at most 6 down to a risk of 1e-6."""
