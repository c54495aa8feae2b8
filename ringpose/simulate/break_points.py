"""True break points of the stripes on the rim, in closed form.

A light plane intersects the plane of the rim in a line, which intersects the inner and the outer circle of the rim in
the break points. A break point is part of the truth if it is visible to the camera and lit by the laser.
"""

import numpy as np

from ringpose.geometry.rays import project
from ringpose.simulate.laser_planes import in_fan
from ringpose.simulate.lighting import IlluminatedTarget
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.camera import Camera
from ringpose.types.scene import RingShape

_INSIDE_M = 1e-6
"""Visibility is tested at a point this far inside the edge and above the rim, which the rim itself does not occlude."""


def true_break_points_px(
    illuminated: IlluminatedTarget, ring: RingShape, camera: Camera
) -> Float64[Array, "laser edge=2 xy=2"]:
    """Distorted pixels of the break points, NaN if outside the image, occluded or not lit.

    The lines intersect the ring on two sides; those of the side with more visible break points are returned.
    """
    sides = [break_points_px_at(illuminated, ring, camera, side) for side in (-1.0, 1.0)]
    seen = [int(np.isfinite(side).all(axis=-1).sum()) for side in sides]
    return sides[int(np.argmax(seen))]


def break_points_px_at(
    illuminated: IlluminatedTarget, ring: RingShape, camera: Camera, side: float
) -> Float64[Array, "laser edge=2 xy=2"]:
    """The break points on one side, +1 or -1 along the direction of the lines."""
    radii_m = np.array([ring.radius_inner_m, ring.radius_outer_m])
    point = crossings(illuminated, ring.height_m, radii_m, side)
    inward = np.array([_INSIDE_M, -_INSIDE_M])[:, None] * np.array([1.0, 1.0, 0.0])
    radial = point / np.linalg.norm(point[..., :2], axis=-1, keepdims=True)
    inside = point + inward * radial + [0.0, 0.0, _INSIDE_M]
    pixel = project(illuminated.placement.points_camera(point), camera)
    shown = in_image(pixel, camera) & _visible_and_lit(illuminated, inside)
    return np.where(shown[..., None], pixel, np.nan)


def in_image(pixel: Float64[Array, "*shape xy=2"], camera: Camera) -> Bool[Array, "*shape"]:
    """Whether pixels lie inside the image; False for NaN."""
    size = np.array([camera.image_width, camera.image_height])
    with np.errstate(invalid="ignore"):
        inside = (pixel > -0.5) & (pixel < size - 0.5)
    return np.logical_and(inside[..., 0], inside[..., 1])


def crossings(
    illuminated: IlluminatedTarget, height_m: float, radii_m: Float64[Array, "radius"], side: float
) -> Float64[Array, "laser radius xyz=3"]:
    """Points of each light plane on circles about the ring's axis, target frame; NaN without intersection."""
    across, distance_m = (
        illuminated.sheets.normal[:, :2],
        illuminated.sheets.distance_m - illuminated.sheets.normal[:, 2] * height_m,
    )
    square = (across**2).sum(axis=1, keepdims=True)
    foot = across * distance_m[:, None] / square
    along = np.stack([across[:, 1], -across[:, 0]], axis=1) / np.sqrt(square)
    along *= np.where(along @ along[0] < 0, -1.0, 1.0)[:, None]
    rest = radii_m**2 - (foot**2).sum(axis=1, keepdims=True)
    half_chord = np.sqrt(np.where(rest > 0, rest, np.nan))
    flat = foot[:, None] + side * half_chord[..., None] * along[:, None]
    return np.concatenate([flat, np.full((*flat.shape[:2], 1), height_m)], axis=-1)


def _visible_and_lit(
    illuminated: IlluminatedTarget, point: Float64[Array, "laser edge xyz=3"]
) -> Bool[Array, "laser edge"]:
    """Whether points on the rim are visible to the camera and lit by their laser."""
    shown = np.zeros(point.shape[:2], dtype=np.bool_)
    for laser, points in enumerate(point):
        found = np.flatnonzero(np.isfinite(points).all(axis=1))
        at = points[found].T
        to_eye = illuminated.placement.eye_m[:, None] - at
        to_projector = illuminated.sheets.projector_m[laser][:, None] - at
        clear = ~illuminated.target.blocked(at, to_eye) & ~illuminated.target.blocked(at, to_projector)
        shown[laser, found] = clear & (to_eye[2] > 0) & (to_projector[2] > 0) & in_fan(illuminated.sheets, laser, at)
    return shown
