"""Intersections of rays with a surface of revolution about the z axis, in closed form.

The profile is a polyline of (radius, height) corners; each piece is a flat annulus, a cylinder or a cone.
Points and directions are arrays (xyz, ray); all rays may have the same origin.
"""

from itertools import pairwise

import numpy as np

from ringpose.types.arrays import Array, Bool, Float64, Int8, Int64

MIN_DISTANCE = 1e-6
"""Minimum ray parameter of an intersection, which excludes the surface that the ray starts from."""


def first_hits(
    profile_m: Float64[Array, "point 2"],
    origin: Float64[Array, "xyz=3 #ray"],
    direction: Float64[Array, "xyz=3 ray"],
    max_parameter: float = np.inf,
) -> tuple[Float64[Array, "ray"], Int8[Array, "ray"]]:
    """Parameter t of the first point origin + t direction on the surface, and its piece; inf and -1 without one.

    Only intersections with MIN_DISTANCE < t < max_parameter count.
    """
    parameter = np.full(direction.shape[1], np.inf)
    piece = np.full(direction.shape[1], -1, dtype=np.int8)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        rays = _rays_near(profile_m, origin, direction)
        starts = origin if origin.shape[1] == 1 else origin[:, rays]
        best = np.full(len(rays), np.inf)
        which = np.full(len(rays), -1, dtype=np.int8)
        for number, (first, second) in enumerate(pairwise(profile_m)):
            is_flat = first[1] == second[1]
            found = (_annulus_hits if is_flat else _cone_hits)(first, second, starts, direction[:, rays])
            nearer = (found < best) & (found < max_parameter)
            best[nearer], which[nearer] = found[nearer], number
    parameter[rays], piece[rays] = best, which
    return parameter, piece


def normals(
    profile_m: Float64[Array, "point 2"], point: Float64[Array, "xyz=3 ray"], piece: Int8[Array, "ray"]
) -> Float64[Array, "xyz=3 ray"]:
    """Unit normals at points on the surface, of either sign."""
    along = np.diff(profile_m, axis=0)
    radial, axial = along[:, 1] / np.hypot(*along.T), -along[:, 0] / np.hypot(*along.T)
    radius = np.maximum(np.hypot(point[0], point[1]), np.finfo(float).tiny)
    return np.stack([radial[piece] * point[0] / radius, radial[piece] * point[1] / radius, axial[piece]])


def _rays_near(
    profile_m: Float64[Array, "point 2"], origin: Float64[Array, "xyz=3 #ray"], direction: Float64[Array, "xyz=3 ray"]
) -> Int64[Array, "near"]:
    """Indices of the rays that pass between the minimum and the maximum radius within the heights of the surface."""
    (x, y, z), (dx, dy, dz) = origin, direction
    first, second = ((height - z) / dz for height in (profile_m[:, 1].min(), profile_m[:, 1].max()))
    enter, leave = np.maximum(np.minimum(first, second), 0.0), np.maximum(first, second)
    enter, leave = np.nan_to_num(enter, nan=0.0), np.where(np.isfinite(leave), leave, 1e9)
    across, along = dx * dx + dy * dy, x * dx + y * dy
    start = x * x + y * y
    nearest = np.clip(-along / across, enter, leave)
    farthest = np.maximum(start + enter * (2 * along + enter * across), start + leave * (2 * along + leave * across))
    inside = farthest < profile_m[:, 0].min() ** 2 * (1 - 1e-12)
    outside = start + nearest * (2 * along + nearest * across) > profile_m[:, 0].max() ** 2 * (1 + 1e-12)
    return np.flatnonzero(~(inside | outside | (leave <= 0.0)))


def _annulus_hits(
    first: Float64[Array, "2"],
    second: Float64[Array, "2"],
    origin: Float64[Array, "xyz=3 #ray"],
    direction: Float64[Array, "xyz=3 ray"],
) -> Float64[Array, "ray"]:
    """Parameter of the hit on a flat piece of the profile, inf without one."""
    parameter = (first[1] - origin[2]) / direction[2]
    square = (origin[0] + parameter * direction[0]) ** 2 + (origin[1] + parameter * direction[1]) ** 2
    inner, outer = min(first[0], second[0]), max(first[0], second[0])
    hit = (parameter > MIN_DISTANCE) & (square >= inner**2) & (square <= outer**2)
    return np.where(hit, parameter, np.inf)


def _cone_hits(
    first: Float64[Array, "2"],
    second: Float64[Array, "2"],
    origin: Float64[Array, "xyz=3 #ray"],
    direction: Float64[Array, "xyz=3 ray"],
) -> Float64[Array, "ray"]:
    """Parameter of the nearest hit on a cylinder or cone, inf without one.

    The roots of |xy|^2 = radius(z)^2 with radius(z) linear in z, in the form without cancellation.
    """
    slope = (second[0] - first[0]) / (second[1] - first[1])
    (x, y, z), (dx, dy, dz) = origin, direction
    radius = first[0] + slope * (z - first[1])
    square = dx * dx + dy * dy - (slope * dz) ** 2
    half = x * dx + y * dy - slope * dz * radius
    rest = x * x + y * y - radius * radius
    root = -(half + np.copysign(np.sqrt(half * half - square * rest), half))
    lowest, highest = min(first[1], second[1]), max(first[1], second[1])
    best = np.full(direction.shape[1], np.inf)
    for parameter in (root / square, rest / root):
        height = z + parameter * dz
        hit = (parameter > MIN_DISTANCE) & (height >= lowest) & (height <= highest)
        hit &= radius + slope * parameter * dz >= 0
        best = np.where(hit & (parameter < best), parameter, best)
    return best


def blocked(
    profile_m: Float64[Array, "point 2"], origin: Float64[Array, "xyz=3 ray"], towards: Float64[Array, "xyz=3 ray"]
) -> Bool[Array, "ray"]:
    """Whether the surface intersects the segments between origin and origin + towards."""
    return first_hits(profile_m, origin, towards, max_parameter=1.0)[1] >= 0
