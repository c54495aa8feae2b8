"""Readable NumPy twins of the kernels that follow a ring's edges: the oracles of the tests."""

import numpy as np

from ringpose.geometry.ring_arcs import RingArcs, arc_points, moved, off_face_m
from ringpose.kernels.edges import FitRules, PlaceRules, PlanePoints, ProfileRules, Sights, StepRules, Templates
from ringpose.kernels.ring import Lens
from ringpose.types.arrays import Array, Bool, Float64, UInt


def edge_places(
    arcs: RingArcs, covariance: Float64[Array, "state=7 state=7"], lens: Lens, rules: PlaceRules
) -> Float64[Array, "n column=13"]:
    """Twin of `ringpose.kernels.edges.edge_places`."""
    size = np.array([rules.image_width, rules.image_height])
    metres_per_px = arcs.origin[2] / lens.fx
    middle = np.abs(_straight(arcs.origin, lens) - size / 2)
    count = int(min(rules.detour * np.hypot(*(middle + size / 2)) / rules.spacing_px, rules.farthest))
    number = np.arange(-count, count + 1, dtype=np.float64)
    number = number[np.abs(arcs.curvature * number * rules.spacing_px * metres_per_px) < rules.half_turn_rad]
    side, number = np.repeat([1.0, -1.0], len(number)), np.tile(number, 2)
    point, outward = arc_points(arcs, number * rules.spacing_px * metres_per_px, side)

    _, rows = off_face_m(arcs, point, side)
    sigma_m = np.sqrt(np.maximum(np.sum((rows @ covariance) * rows, axis=-1), 0.0))
    straight = _straight(point, lens)
    near = (point[:, 2] > 0) & (sigma_m < rules.oblique * rules.sigma_px * metres_per_px)
    near &= np.all((straight > -rules.wider * size) & (straight < (1 + rules.wider) * size), axis=-1)
    point, outward, side, number, sigma_m = point[near], outward[near], side[near], number[near], sigma_m[near]

    along = np.cross(arcs.axes[2], outward)
    place, nudged, beside = (_imaged(point + rules.nudge_m * step, lens) for step in (0 * outward, outward, along))
    normal = np.stack([-(beside - place)[:, 1], (beside - place)[:, 0]], axis=-1)
    normal /= np.hypot(*normal.T)[:, None]
    px_per_m = np.sum(normal * (nudged - place), axis=-1) / rules.nudge_m
    normal *= np.sign(px_per_m)[:, None]
    found = np.column_stack([point, outward, side, place, normal, 1 / np.abs(px_per_m), number])
    inside = np.all((place > rules.margin_px) & (place < size - 1 - rules.margin_px), axis=-1)
    seen: Float64[Array, "n column=13"] = found[inside & (sigma_m * np.abs(px_per_m) < rules.sigma_px)]
    return seen


def _straight(point: Float64[Array, "*shape xyz=3"], lens: Lens) -> Float64[Array, "*shape xy=2"]:
    """Pixels in the image without distortion."""
    at: Float64[Array, "*shape xy=2"] = point[..., :2] / point[..., 2:] * lens[:2] + lens[2:4]
    return at


def _imaged(point: Float64[Array, "n xyz=3"], lens: Lens) -> Float64[Array, "n xy=2"]:
    """Pixels by OpenCV's distortion, as its documentation has it."""
    x, y = (point[:, :2] / point[:, 2:]).T
    r2 = x**2 + y**2
    radial = (1 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))) / (1 + r2 * (lens.k4 + r2 * (lens.k5 + r2 * lens.k6)))
    distorted_x = x * radial + 2 * lens.p1 * x * y + lens.p2 * (r2 + 2 * x**2)
    distorted_y = y * radial + lens.p1 * (r2 + 2 * y**2) + 2 * lens.p2 * x * y
    return np.stack([distorted_x * lens.fx + lens.cx, distorted_y * lens.fy + lens.cy], axis=-1)


def edge_profiles(
    image: UInt[Array, "row column"],
    place_px: Float64[Array, "n xy=2"],
    normal: Float64[Array, "n xy=2"],
    rules: ProfileRules,
) -> tuple[Float64[Array, "n sample"], Bool[Array, "n sample"], Float64[Array, "n"]]:
    """Twin of `ringpose.kernels.edges.edge_profiles`."""
    across = np.arange(-rules.reach_px - rules.inside_px, rules.reach_px + rules.outside_px + 1)
    along = np.arange(rules.along_px) - (rules.along_px - 1) / 2
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=-1)
    start = place_px[:, None] + along[:, None] * tangent[:, None]
    sampled = _between_pixels(image, start[:, :, None] + across[:, None] * normal[:, None, None])
    value, surface = sampled.mean(axis=1), slice(0, int(rules.inside_px))
    noise_dn = np.var(value[:, surface], axis=1, ddof=1)
    noise_dn = np.sqrt(pooled(noise_dn, int(rules.pooled)) + rules.noise_dn**2 / rules.along_px)
    above = (value - value[:, surface].mean(axis=1, keepdims=True)) / noise_dn[:, None]
    return above, sampled.max(axis=1) >= rules.saturation_dn - 0.5, noise_dn


def _between_pixels(image: UInt[Array, "row column"], at: Float64[Array, "*shape xy=2"]) -> Float64[Array, "*shape"]:
    last = np.array(image.shape[::-1]) - 1
    at = np.clip(at, 0, last)
    left, top = np.moveaxis(np.floor(at).astype(np.int64), -1, 0)
    right, bottom = np.minimum(left + 1, last[0]), np.minimum(top + 1, last[1])
    u, v = np.moveaxis(at, -1, 0) - (left, top)
    grey = image.astype(np.float64)
    upper = (1 - u) * grey[top, left] + u * grey[top, right]
    lower = (1 - u) * grey[bottom, left] + u * grey[bottom, right]
    return np.asarray((1 - v) * upper + v * lower)


def edge_steps(
    value: Float64[Array, "n sample"],
    saturated: Bool[Array, "n sample"],
    noise_dn: Float64[Array, "n"],
    templates: Templates,
    rules: StepRules,
) -> Float64[Array, "n column=5"]:
    """Twin of `ringpose.kernels.edges.edge_steps`."""
    height = value @ templates.step
    cost = (value**2) @ templates.weight - height**2 - (value @ templates.level) ** 2
    rows, best = np.arange(len(cost)), np.clip(np.argmin(cost, axis=1), 1, len(templates.place_px) - 2)
    left, least, right = (cost[rows, best + k] for k in (-1, 0, 1))
    bend = left - 2 * least + right
    found = (bend > rules.flat) & (least <= left) & (least <= right)
    bend = np.where(found, bend, 1.0)
    offset = templates.place_px[best] + np.where(found, (left - right) / (2 * bend), 0.0) * rules.spacing_px
    touched = np.any(saturated & (np.abs(templates.across_px - offset[:, None]) < rules.touched_px), axis=1)
    misfit = np.maximum(pooled(least / (value.shape[1] - 3), int(rules.pooled)), 1.0)
    size = np.abs(height[rows, best])
    return np.column_stack(
        [
            np.where(found & ~touched, offset, np.nan),
            rules.spacing_px * np.sqrt(2 * misfit / bend),
            size / np.sqrt(misfit),
            size * noise_dn / templates.unit[best],
            least,
        ]
    )


def pooled(values: Float64[Array, "n"], window: int) -> Float64[Array, "n"]:
    """Running mean over neighbours, fewer at the ends."""
    half = window // 2
    return np.array([values[max(i - half, 0) : i + half + 1].mean() for i in range(len(values))])


def fitted_arcs(
    arcs: RingArcs,
    plane: PlanePoints,
    sights: Sights,
    reference: Float64[Array, "3 xyz=3"],
    rules: FitRules,
) -> tuple[RingArcs, Float64[Array, "state=7 state=7"]]:
    """Twin of `ringpose.kernels.edges.fitted_arcs`."""
    information = np.eye(7)
    for _ in range(rules.rounds):
        beyond, rows = off_face_m(arcs, sights.ray, sights.side)
        residual = beyond / sights.sigma_m
        weight = (1 + (residual / rules.outlier_sigmas) ** 2) ** -2
        rows /= sights.sigma_m[:, None]
        weighted = rows * weight[:, None]
        fixed_rows, fixed_residual = _plane_and_priors(arcs, plane, reference, rules)
        information = weighted.T @ rows + fixed_rows.T @ fixed_rows
        step = -np.linalg.solve(information, weighted.T @ residual + fixed_rows.T @ fixed_residual)
        longest = np.array(rules.longest_step)
        arcs = moved(arcs, np.clip(step, -longest, longest))
    return arcs, np.linalg.inv(information)


def _plane_and_priors(
    arcs: RingArcs, plane: PlanePoints, reference: Float64[Array, "3 xyz=3"], rules: FitRules
) -> tuple[Float64[Array, "m state=7"], Float64[Array, "m"]]:
    """Rows and residuals of the stripes' lines and of the priors."""
    count = len(plane.point)
    rows, residual = np.zeros((count + 5, 7)), np.empty(count + 5)
    offset = (plane.point - arcs.origin) @ arcs.axes.T
    rows[:count, :2], rows[:count, 2] = offset[:, :2], -1.0
    rows[:count] /= plane.sigma_m[:, None]
    residual[:count] = offset[:, 2] / plane.sigma_m

    across, along, normal = arcs.axes
    rows[count : count + 2, :2] = reference[:2] @ arcs.axes[:2].T / rules.tilt_sigma_rad
    rows[count + 2, 4] = along @ reference[1] / rules.turn_sigma_rad
    rows[count + 3, 5], rows[count + 4, 6] = 1 / rules.curvature_sigma, 1 / rules.half_band_sigma_m
    residual[count : count + 2] = reference[:2] @ normal / rules.tilt_sigma_rad
    residual[count + 2] = across @ reference[1] / rules.turn_sigma_rad
    residual[count + 3] = arcs.curvature / rules.curvature_sigma
    residual[count + 4] = (arcs.half_band_m - rules.half_band_m) / rules.half_band_sigma_m
    return rows, residual
