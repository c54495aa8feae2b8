"""Where the stripes on the ring's face end: the truth, in closed form.

The face's plane and a light plane meet in a line; the line meets the circles of the face's edges in the break
points. A break point is true only if the camera sees it and the laser reaches it.
"""

import numpy as np

from ringpose.geometry.rays import project
from ringpose.simulate.laser_planes import in_fan
from ringpose.simulate.lighting import Stand
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.camera import Camera
from ringpose.types.scene import RingShape

_INSIDE_M = 1e-6
"""An edge is judged this far inside the face and above it, so that it does not hide itself."""


def true_break_points_px(stand: Stand, ring: RingShape, camera: Camera) -> Float64[Array, "laser edge=2 xy=2"]:
    """Distorted pixels of the break points, NaN where one is out of the picture, hidden or in the dark.

    The lines cross the ring on two sides; the side that shows more break points is taken.
    """
    sides = [break_points_px_at(stand, ring, camera, side) for side in (-1.0, 1.0)]
    seen = [int(np.isfinite(side).all(axis=-1).sum()) for side in sides]
    return sides[int(np.argmax(seen))]


def break_points_px_at(
    stand: Stand, ring: RingShape, camera: Camera, side: float
) -> Float64[Array, "laser edge=2 xy=2"]:
    """The break points on one side, +1 or -1 along the lines' direction."""
    radii_m = np.array([ring.radius_inner_m, ring.radius_outer_m])
    point = crossings(stand, ring.height_m, radii_m, side)
    inward = np.array([_INSIDE_M, -_INSIDE_M])[:, None] * np.array([1.0, 1.0, 0.0])
    radial = point / np.linalg.norm(point[..., :2], axis=-1, keepdims=True)
    inside = point + inward * radial + [0.0, 0.0, _INSIDE_M]
    pixel = project(stand.placement.points_camera(point), camera)
    shown = in_picture(pixel, camera) & _seen_and_lit(stand, inside)
    return np.where(shown[..., None], pixel, np.nan)


def in_picture(pixel: Float64[Array, "*shape xy=2"], camera: Camera) -> Bool[Array, "*shape"]:
    """Whether pixels lie within the picture; NaN does not."""
    size = np.array([camera.image_width, camera.image_height])
    with np.errstate(invalid="ignore"):
        inside = (pixel > -0.5) & (pixel < size - 0.5)
    return np.logical_and(inside[..., 0], inside[..., 1])


def crossings(
    stand: Stand, height_m: float, radii_m: Float64[Array, "radius"], side: float
) -> Float64[Array, "laser radius xyz=3"]:
    """Points of each light plane on circles about the ring's axis, target frame; NaN where plane and circle miss."""
    across, distance_m = stand.sheets.normal[:, :2], stand.sheets.distance_m - stand.sheets.normal[:, 2] * height_m
    square = (across**2).sum(axis=1, keepdims=True)
    foot = across * distance_m[:, None] / square
    along = np.stack([across[:, 1], -across[:, 0]], axis=1) / np.sqrt(square)
    along *= np.where(along @ along[0] < 0, -1.0, 1.0)[:, None]
    rest = radii_m**2 - (foot**2).sum(axis=1, keepdims=True)
    half_chord = np.sqrt(np.where(rest > 0, rest, np.nan))
    flat = foot[:, None] + side * half_chord[..., None] * along[:, None]
    return np.concatenate([flat, np.full((*flat.shape[:2], 1), height_m)], axis=-1)


def _seen_and_lit(stand: Stand, point: Float64[Array, "laser edge xyz=3"]) -> Bool[Array, "laser edge"]:
    """Whether the camera sees points on the face and each one's laser reaches it."""
    shown = np.zeros(point.shape[:2], dtype=np.bool_)
    for laser, points in enumerate(point):
        found = np.flatnonzero(np.isfinite(points).all(axis=1))
        at = points[found].T
        to_eye = stand.placement.eye_m[:, None] - at
        to_projector = stand.sheets.projector_m[laser][:, None] - at
        clear = ~stand.target.blocked(at, to_eye) & ~stand.target.blocked(at, to_projector)
        shown[laser, found] = clear & (to_eye[2] > 0) & (to_projector[2] > 0) & in_fan(stand.sheets, laser, at)
    return shown
