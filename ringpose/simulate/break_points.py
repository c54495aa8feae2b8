"""True break points of the stripes on the rim.

A light plane intersects the plane of the rim in a line, which intersects the inner and the outer circle of the rim in
the break points (`ringpose.geometry.ring`); on a ring that is out of round or warped they are found from there by
Newton's method. A break point is part of the truth if it is visible to the camera and lit by the laser.
"""

import numpy as np

from ringpose.geometry.rays import project
from ringpose.geometry.ring import predicted_break_points, ring_arcs
from ringpose.kernels.render import blocked
from ringpose.simulate.light import IlluminatedTarget, in_fan, sheets
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.rig import Camera
from ringpose.types.target import RingShape

_INSIDE_M = 1e-6
"""Visibility is tested at a point this far inside the edge and above the rim, which the rim itself does not occlude."""

_NEWTON_STEPS = 6

_FIRST_ORDER = 2
"""Lowest order of the deviations of a ring's form."""


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
    radius_m = np.array([ring.radius_inner_m, ring.radius_outer_m])
    point_m = ring_crossings_m(illuminated, ring, radius_m, side)
    if ring.form is not None:
        point_m = _on_form(illuminated, ring, point_m)
    pixel = project(point_m, camera)
    shown = in_image(pixel, camera) & _visible_and_lit(illuminated, ring, point_m)
    return np.where(shown[..., None], pixel, np.nan)


def in_image(pixel: Float64[Array, "*shape xy=2"], camera: Camera) -> Bool[Array, "*shape"]:
    """Whether pixels lie inside the image; False for NaN."""
    size = np.array([camera.image_width, camera.image_height])
    with np.errstate(invalid="ignore"):
        inside = (pixel > -0.5) & (pixel < size - 0.5)
    return np.logical_and(inside[..., 0], inside[..., 1])


def ring_crossings_m(
    illuminated: IlluminatedTarget, ring: RingShape, radius_m: Float64[Array, "radius=2"], side: float
) -> Float64[Array, "laser radius=2 xyz=3"]:
    """Points of each light plane on two circles in the plane of an ideal ring's face, camera frame; NaN without any.

    Of the two crossings with each circle, that on one side, +1 or -1 along the first laser's stripe.
    """
    placement, planes = illuminated.placement, illuminated.planes
    center_m = placement.points_camera(np.array([0.0, 0.0, ring.height_m]))
    normal = placement.rotation[:, 2]
    along = np.cross(planes.normal[0], normal)
    length = float(np.linalg.norm(along))
    if length < np.finfo(float).eps:
        along, length = placement.rotation[:, 0], 1.0
    arcs = ring_arcs(center_m, normal, radius_m, center_m + side * along / length)
    return predicted_break_points(arcs, planes.normal, planes.distance_m)


def _on_form(
    illuminated: IlluminatedTarget, ring: RingShape, point_m: Float64[Array, "laser edge=2 xyz=3"]
) -> Float64[Array, "laser edge=2 xyz=3"]:
    """The points moved along the edges of the real ring onto their light planes, by Newton's method in the angle."""
    form, light = ring.form, sheets(illuminated.planes, illuminated.laser_light, illuminated.placement)
    assert form is not None
    target = illuminated.placement.points_target(point_m.reshape(-1, 3).T).T.reshape(point_m.shape)
    angle = np.arctan2(target[..., 1], target[..., 0])
    order = _FIRST_ORDER + np.arange(form.axial_m.shape[0])
    radius_m = np.array([ring.radius_inner_m, ring.radius_outer_m])

    def edge(angle: Float64[Array, "laser edge=2"]) -> tuple[Array, Array]:
        """Points of the edges, and their derivatives by the angle."""
        phase = angle[..., None] * order
        waves = np.stack([np.cos(phase), np.sin(phase)], axis=-1)
        change = order[:, None] * np.stack([-np.sin(phase), np.cos(phase)], axis=-1)
        radial, radial_by = (radius_m + (waves * form.radial_m).sum((-1, -2))), (change * form.radial_m).sum((-1, -2))
        axial, axial_by = ring.height_m + (waves * form.axial_m).sum((-1, -2)), (change * form.axial_m).sum((-1, -2))
        cosine, sine = np.cos(angle), np.sin(angle)
        point = np.stack([radial * cosine, radial * sine, axial], axis=-1)
        by = np.stack([radial_by * cosine - radial * sine, radial_by * sine + radial * cosine, axial_by], axis=-1)
        return point, by

    for _ in range(_NEWTON_STEPS):
        point, by = edge(angle)
        off_m = (point * light.normal[:, None]).sum(axis=-1) - light.distance_m[:, None]
        angle = angle - off_m / (by * light.normal[:, None]).sum(axis=-1)
    return illuminated.placement.points_camera(edge(angle)[0])


def _visible_and_lit(
    illuminated: IlluminatedTarget, ring: RingShape, point_m: Float64[Array, "laser edge=2 xyz=3"]
) -> Bool[Array, "laser edge=2"]:
    """Whether points on the rim are visible to the camera and lit by their laser, and not in a gap of the ring."""
    placement, light = illuminated.placement, illuminated.sheets
    shown = np.zeros(point_m.shape[:2], dtype=np.bool_)
    for laser, points in enumerate(point_m):
        found = np.flatnonzero(np.isfinite(points).all(axis=1))
        at = placement.points_target(points[found].T)
        radial = at[:2] / np.linalg.norm(at[:2], axis=0)
        at = at + _INSIDE_M * np.vstack([np.where(found == 0, 1.0, -1.0) * radial, np.ones(len(found))])
        to_eye = placement.eye_m[:, None] - at
        to_projector = light.projector_m[laser][:, None] - at
        clear = ~blocked(illuminated.target, at, to_eye) & ~blocked(illuminated.target, at, to_projector)
        clear &= (to_eye[2] > 0) & (to_projector[2] > 0) & in_fan(light, laser, at)
        shown[laser, found] = clear & ~in_gap(ring, at.T)
    return shown


def in_gap(ring: RingShape, point_m: Float64[Array, "*shape xyz=3"]) -> Bool[Array, "*shape"]:
    """Which points on the face, in the ring's own axes, are missing because a gap interrupts the ring there."""
    x, y = point_m[..., 0], point_m[..., 1]
    inside = np.zeros(x.shape, dtype=np.bool_)
    for gap in ring.gaps:
        cosine, sine = np.cos(gap.angle_rad), np.sin(gap.angle_rad)
        inside |= (np.abs(y * cosine - x * sine) <= gap.width_m / 2) & (x * cosine + y * sine >= 0)
    return inside
