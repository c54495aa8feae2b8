"""Readable NumPy twin of the kernel that scores groups of tracks: the oracle of its tests."""

from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from ringpose.kernels.faces import Group, RingRules
from ringpose.kernels.reference_ring import arcs
from ringpose.types.arrays import Array, Float64, Int64

NOTHING, MOST_MEMBERS = -np.inf, 3


class Pool(NamedTuple):
    """Candidates, tracks under a laser, and the light planes as m / d."""

    track: Int64[Array, "candidate"]
    laser: Int64[Array, "candidate"]
    ends: Float64[Array, "candidate end=2 xy=2"]
    """Normalised image coordinates."""
    merit: Float64[Array, "candidate"]
    forgiven: Float64[Array, "candidate"]
    """What a group of three adds to the merit."""
    planes: Float64[Array, "laser xyz=3"]


def best_groups(pool: Pool, rules: RingRules) -> tuple[Group, Group, Group]:
    """The best groups of one, two and three candidates of different lasers and different tracks."""
    one, two, three = (_best_of_size(size, pool, rules) for size in (1, 2, 3))
    return one, two, three


def _best_of_size(size: int, pool: Pool, rules: RingRules) -> Group:
    scores = {}
    merit = pool.merit + pool.forgiven * (size == MOST_MEMBERS)
    for lasers in combinations(np.unique(pool.laser), size):
        for members in product(*(np.flatnonzero(pool.laser == each) for each in lasers)):
            group = list(members)
            if len(set(pool.track[group])) == size:
                cost = group_cost(pool.laser[group], pool.ends[group], pool.planes, rules)
                scores[tuple(int(each) for each in group)] = float(merit[group].sum() - cost)
    best = max(scores, key=lambda group: scores[group], default=())
    if not best or scores[best] == NOTHING:
        return Group((-1,) * size, (-1,) * size, NOTHING, NOTHING)
    own = set(pool.track[list(best)])
    same = [scores[group] for group in scores if group != best and set(pool.track[list(group)]) == own]
    lasers, tracks = (tuple(each[list(best)].tolist()) for each in (pool.laser, pool.track))
    return Group(lasers, tracks, scores[best], max(same, default=NOTHING))


def group_cost(
    laser: Int64[Array, "member"], ends: Float64[Array, "member end=2 xy=2"], planes: Array, rules: RingRules
) -> float:
    """Costs of one group; infinite if it is impossible."""
    rays = np.concatenate([ends, np.ones((*ends.shape[:-1], 1))], axis=-1)
    inverse_depth = np.einsum("mek,mk->me", rays, planes[laser])
    plane, cost = _plane(laser, rays, inverse_depth, planes, rules)
    tilt = np.arctan2(np.hypot(plane[0], plane[1]), abs(plane[2])) if len(laser) > 1 else 0.0
    if not cost < rules.plane_limit * len(laser) or tilt > rules.maximum_tilt_rad:
        return np.inf
    if len(laser) > 1:
        circle = _circles(rays / inverse_depth[..., None], plane, rules)
        if not circle < rules.circle_limit * len(laser):
            return np.inf
        cost += circle
    unseen = _unseen(laser, ends, plane, planes, rules)
    return float(cost + rules.unseen_cost * unseen + 0.5 * (tilt / 0.5) ** 2)


def _plane(
    laser: Array, rays: Array, inverse_depth: Array, planes: Array, rules: RingRules
) -> tuple[Float64[Array, "3"], float]:
    """The plane 1/z = p . (x, y, 1) nearest to the ends, and its cost; for one track that facing the camera."""
    if len(laser) == 1:
        return np.array([0.0, 0.0, inverse_depth.mean()]), 0.0
    sigma = np.repeat(rules.across_sigma_px * np.abs(planes[laser, 1]) / rules.focal_y, 2)
    rows = rays.reshape(-1, 3) / sigma[:, None]
    plane, *_ = np.linalg.lstsq(rows, inverse_depth.ravel() / sigma, rcond=None)
    residual = rows @ plane - inverse_depth.ravel() / sigma
    return plane, float(0.5 * residual @ residual)


def _unseen(laser: Array, ends: Array, plane: Array, planes: Array, rules: RingRules) -> int:
    """Lasers outside the group whose stripe on the plane the image would show."""
    x = ends[..., 0].mean()
    others = np.setdiff1d(np.arange(len(planes)), laser)
    difference = plane - planes[others]
    row = -(difference[:, 0] * x + difference[:, 2]) / difference[:, 1] * rules.focal_y + rules.principal_y
    return int(np.count_nonzero((row > rules.border_px) & (row < rules.image_height - rules.border_px)))


def _circles(points: Float64[Array, "member end=2 xyz=3"], plane: Array, rules: RingRules) -> float:
    """Cost of the ends off two arcs about one centre; one end of six or more may be dropped at a price."""
    normal = plane / np.linalg.norm(plane)
    middle = points.mean(axis=(0, 1))
    along = (points[:, 1] - points[:, 0]).mean(axis=0)
    along -= along @ normal * normal
    along /= np.linalg.norm(along)
    flat = (points - middle).reshape(-1, 3) @ np.stack([along, np.cross(normal, along)], axis=-1)
    sigma = rules.along_sigma_px * middle[2] / rules.focal_x
    x = points[..., 0].ravel() / points[..., 2].ravel()
    y = points[..., 1].ravel() / points[..., 2].ravel()
    used = (x >= rules.left_x) & (x <= rules.right_x) & (y >= rules.top_y) & (y <= rules.bottom_y)
    flat, arc = flat[used], (np.arange(len(flat)) % 2)[used]
    everything = _arcs(flat, arc, sigma, rules)
    if len(points) < 3 or everything < rules.dropped_end_cost:
        return everything
    kept = [np.arange(len(flat)) != each for each in range(len(flat))]
    dropped = [_arcs(flat[each], arc[each], sigma, rules) for each in kept]
    return min(everything, min(dropped) + rules.dropped_end_cost)


def _arcs(flat: Array, arc: Array, sigma: float, rules: RingRules) -> float:
    """Cost of points off two arcs; infinite for rings that nobody builds, nothing if one arc has no point."""
    if len(set(arc.tolist())) < 2:
        return 0.0
    outside, curvature, band = arcs(flat, arc)
    if abs(curvature) > 1 / rules.minimum_radius_m:
        outside, _, band = arcs(flat, arc, straight=True)
    return np.inf if band < rules.minimum_band_m else float(0.5 * np.sum((outside / sigma) ** 2))
