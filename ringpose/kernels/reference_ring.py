"""Readable NumPy twin of the kernel that fits arcs to the ends of stripes: the oracle of its tests."""

import numpy as np

from ringpose.geometry.planes import nearest_plane
from ringpose.geometry.rays import intersect
from ringpose.kernels.reference_tracks import undistorted
from ringpose.kernels.ring import ArcFit, Lens
from ringpose.types.arrays import Array, Float64


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
    position_px: Float64[Array, "laser end=2 xy=2"],
    covariance_px2: Float64[Array, "laser end=2 xy=2 xy=2"],
    planes: Float64[Array, "laser normal_and_distance=4"],
    lens: Lens,
    circle_sigma_px: float,
    fitted_exactly: int,
) -> ArcFit:
    """Twin of `ringpose.kernels.ring.arc_fit`."""
    seen = ~np.isnan(position_px[..., 0])
    laser, arc = np.nonzero(seen)
    points, metres = flat_ends(position_px[seen], planes[laser], lens)
    along_px = np.sqrt(covariance_px2[..., 0, 0][seen])
    along = metres * (np.hypot(along_px, circle_sigma_px) if len(points) <= fitted_exactly else along_px)
    sigma = np.hypot(along, circle_sigma_px * metres)

    def cost(used: Array) -> float:
        return float(0.5 * np.sum((arcs(points[used], arc[used])[0] / sigma[used]) ** 2))

    number = np.arange(len(points))
    curvature = arcs(points, arc)[1]
    moved = [arcs(points + np.outer(number == each, [along[each], 0.0]), arc)[1] for each in number]
    without = np.full(seen.shape, np.inf)
    without[seen] = [cost(number != each) for each in number]
    left, right = seen.sum(axis=0).tolist()
    spread = float(np.linalg.norm(np.array(moved) - curvature))
    return ArcFit((left, right), cost(number >= 0), tuple(without.ravel().tolist()), curvature, spread)


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
