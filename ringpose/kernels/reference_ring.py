"""Readable NumPy twins of the kernels that look for the ring: the oracles of the tests."""

from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from ringpose.geometry.planes import nearest_plane
from ringpose.geometry.rays import intersect
from ringpose.kernels.reference_tracks import undistorted
from ringpose.kernels.ring import ArcFit, Group, Lens, RingRules
from ringpose.types.arrays import Array, Float64, Int32

NOTHING = -np.inf


def best_groups(
    track: Int32[Array, "candidate"],
    laser: Int32[Array, "candidate"],
    ends: Float64[Array, "candidate end=2 xy=2"],
    merit: Float64[Array, "candidate"],
    planes: Float64[Array, "laser xyz=3"],
    rules: RingRules,
) -> tuple[Group, Group, Group]:
    """Twin of `ringpose.kernels.ring.best_groups`."""
    pool = Pool(track, laser, ends, merit, planes)
    one, two, three = (_best_of_size(size, pool, rules) for size in (1, 2, 3))
    return one, two, three


class Pool(NamedTuple):
    """What groups are made of."""

    track: Int32[Array, "candidate"]
    laser: Int32[Array, "candidate"]
    ends: Float64[Array, "candidate end=2 xy=2"]
    merit: Float64[Array, "candidate"]
    planes: Float64[Array, "laser xyz=3"]


def _best_of_size(size: int, pool: Pool, rules: RingRules) -> Group:
    scores = {}
    for lasers in combinations(np.unique(pool.laser), size):
        for members in product(*(np.flatnonzero(pool.laser == each) for each in lasers)):
            group = list(members)
            if len(set(pool.track[group])) == size:
                cost = group_cost(pool.laser[group], pool.ends[group], pool.planes, rules)
                scores[tuple(int(each) for each in group)] = float(pool.merit[group].sum() - cost)
    best = max(scores, key=lambda group: scores[group], default=())
    if not best or scores[best] == NOTHING:
        return Group((-1,) * size, NOTHING, NOTHING)
    own = set(pool.track[list(best)])
    same = [scores[group] for group in scores if group != best and set(pool.track[list(group)]) == own]
    return Group(best, scores[best], max(same, default=NOTHING))


def group_cost(
    laser: Int32[Array, "member"], ends: Float64[Array, "member end=2 xy=2"], planes: Array, rules: RingRules
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
    used = (x >= rules.left_x) & (x <= rules.right_x)
    flat, arc = flat[used], (np.arange(len(flat)) % 2)[used]
    everything = _arcs(flat, arc, sigma, rules, free_radius=len(points) > 2)
    if len(points) < 3 or everything < rules.dropped_end_cost:
        return everything
    kept = [np.arange(len(flat)) != each for each in range(len(flat))]
    dropped = [_arcs(flat[each], arc[each], sigma, rules, free_radius=True) for each in kept]
    return min(everything, min(dropped) + rules.dropped_end_cost)


def _arcs(flat: Array, arc: Array, sigma: float, rules: RingRules, *, free_radius: bool) -> float:
    """Cost of points off two arcs; infinite for rings that nobody builds, nothing if one arc has no point."""
    if len(set(arc.tolist())) < 2:
        return 0.0
    outside, curvature, band = arcs(flat, arc)
    if not free_radius and abs(curvature) > 1 / rules.minimum_radius_m:
        outside, _, band = arcs(flat, arc, straight=True)
    return np.inf if band < rules.minimum_band_m else float(0.5 * np.sum((outside / sigma) ** 2))


def arcs(
    flat: Float64[Array, "n xy=2"], arc: Array, *, straight: bool = False
) -> tuple[Float64[Array, "n"], float, float]:
    """Distances of points off the arcs a (x^2 + y^2) + x + b y + c_arc = 0, their curvature, their distance."""
    x, y = flat.T
    square = (x**2 + y**2) * (not straight)
    rows = np.column_stack([square, y, arc == 0, arc == 1]).astype(np.float64)
    (bend, lean, *constant), *_ = np.linalg.lstsq(rows, -x, rcond=1e-13)
    residual = bend * square + x + lean * y + np.array(constant)[arc]
    outside: Float64[Array, "n"] = residual / np.maximum(np.hypot(2 * bend * x + 1, 2 * bend * y + lean), 1e-9)
    level = np.sqrt(max(1 + lean**2 - 2 * bend * sum(constant), 1e-12))
    return outside, float(-2 * bend / level), float(abs(constant[1] - constant[0]) / np.hypot(1, lean))


def arc_fit(
    position_px: Float64[Array, "n xy=2"],
    arc: Int32[Array, "n"],
    along_sigma_px: Float64[Array, "n"],
    planes: Float64[Array, "n normal_and_distance=4"],
    lens: Lens,
    circle_sigma_px: float,
) -> ArcFit:
    """Twin of `ringpose.kernels.ring.arc_fit`."""
    points, metres = flat_ends(position_px, planes, lens)
    along = along_sigma_px * metres
    sigma = np.hypot(along, circle_sigma_px * metres)

    def cost(used: Array) -> float:
        return float(0.5 * np.sum((arcs(points[used], arc[used])[0] / sigma[used]) ** 2))

    number = np.arange(len(points))
    curvature = arcs(points, arc)[1]
    moved = [arcs(points + np.outer(number == each, [along[each], 0.0]), arc)[1] for each in number]
    without = np.array([cost(number != each) for each in number])
    return ArcFit(cost(number >= 0), without, curvature, float(np.linalg.norm(np.array(moved) - curvature)))


def flat_ends(
    position_px: Float64[Array, "n xy=2"], planes: Float64[Array, "n normal_and_distance=4"], lens: Lens
) -> tuple[Float64[Array, "n xy=2"], Float64[Array, "n"]]:
    """Points in the plane nearest to them, with x along the image's rows, and what a pixel is worth there in metres."""
    straight = (undistorted(position_px, lens) - [lens.cx, lens.cy]) / [lens.fx, lens.fy]
    directions = np.column_stack([straight, np.ones(len(straight))])
    points = intersect(directions, planes[:, :3], planes[:, 3])
    normal, _, _ = nearest_plane(points)
    along = np.array([normal[2], 0.0, -normal[0]])  # so that "right" keeps its meaning
    along *= np.sign(along[0]) / np.linalg.norm(along)
    flat = (points - points.mean(axis=0)) @ np.stack([along, np.cross(normal, along)], axis=-1)
    return flat, points[:, 2] / lens.fx
