"""True break points of the stripes on the rim.

A light plane intersects the plane of the rim in a line, which intersects the inner and the outer circle of the rim in
the break points (`ringpose.geometry.ring`); on a ring that is out of round or warped they are found from there by
Newton's method. A break point is part of the truth if it is visible to the camera and lit by the laser.
"""

import numpy as np

from ringpose.estimate.nuisance import FORM_ORDERS
from ringpose.geometry.rays import project
from ringpose.geometry.ring import predicted_break_points, ring_arcs
from ringpose.geometry.sheets import BEND_STEPS
from ringpose.kernels.render import blocked
from ringpose.simulate.light import IlluminatedTarget, bend_m, in_fan
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.rig import Camera
from ringpose.types.target import RingForm, RingShape

_INSIDE_M = 1e-6
"""Visibility is tested at a point this far inside the edge and above the rim, which the rim itself does not occlude."""


def true_break_points_px(
    illuminated: IlluminatedTarget, ring: RingShape, camera: Camera
) -> Float64[Array, "laser edge=2 xy=2"]:
    """Distorted pixels of the break points; NaN if outside the image, occluded, not lit or in a gap.

    A light plane intersects the ring on two sides; the break points of the side with more visible ones are returned.
    """
    sides = [break_points_px_at(illuminated, ring, camera, side) for side in (-1.0, 1.0)]
    seen = [int(np.isfinite(side).all(axis=-1).sum()) for side in sides]
    return sides[int(np.argmax(seen))]


def break_points_px_at(
    illuminated: IlluminatedTarget, ring: RingShape, camera: Camera, side: float
) -> Float64[Array, "laser edge=2 xy=2"]:
    """The break points on one side of the ring: +1 or -1, along the first laser's stripe."""
    radius_m = np.array([ring.radius_inner_m, ring.radius_outer_m])
    point_m = ring_crossings_m(illuminated, ring, radius_m, side)
    if ring.form is not None:
        axes, centers_m = illuminated.placement.rotation, _edge_centers_m(illuminated, ring)
        point_m += form_displacement(ring.form, point_m, centers_m, axes, illuminated.planes.normal)
    pixel = project(point_m, camera)
    shown = inside_image(pixel, -0.5, camera) & _visible_and_lit(illuminated, ring, point_m)
    return np.where(shown[..., None], pixel, np.nan)


def inside_image(position_px: Float64[Array, "*shape xy=2"], margin_px: float, camera: Camera) -> Bool[Array, "*shape"]:
    """Which positions are at least this far inside the outermost pixels' centres; false for NaN."""
    size_px = np.array([camera.image_width, camera.image_height])
    return np.asarray(((position_px >= margin_px) & (position_px <= size_px - 1 - margin_px)).all(axis=-1))


def ring_crossings_m(
    illuminated: IlluminatedTarget, ring: RingShape, radius_m: Float64[Array, "radius=2"], side: float
) -> Float64[Array, "laser radius=2 xyz=3"]:
    """Intersections of each sheet of light with two circles at the edges of the face of an ideal ring, camera frame.

    They are at the heights of the inner and the outer edge, or both midway if the radii are the same. A sheet meets
    each circle twice; the intersection on side +1 or -1, along the first laser's stripe, is returned, NaN if there is
    none.
    """
    placement, planes = illuminated.placement, illuminated.planes
    centers_m = _edge_centers_m(illuminated, ring)
    if radius_m[0] == radius_m[1]:
        centers_m = centers_m.mean(axis=0, keepdims=True).repeat(2, axis=0)
    normal = placement.rotation[:, 2]
    along = np.cross(planes.normal[0], normal)
    length = float(np.linalg.norm(along))
    if length < np.finfo(float).eps:
        along, length = placement.rotation[:, 0], 1.0
    arcs = [ring_arcs(center_m, normal, radius_m, center_m + side * along / length) for center_m in centers_m]
    distance_m = np.stack([planes.distance_m, planes.distance_m])
    bow_per_rad = illuminated.bow_per_rad
    for _ in range(BEND_STEPS if bow_per_rad.any() else 1):
        at_edges = [predicted_break_points(arcs[k], planes.normal, distance_m[k])[:, k] for k in (0, 1)]
        point_m = np.stack(at_edges, axis=1)
        distance_m = planes.distance_m + bend_m(planes, bow_per_rad, point_m).T
    return point_m


def _edge_centers_m(illuminated: IlluminatedTarget, ring: RingShape) -> Float64[Array, "edge=2 xyz=3"]:
    """Centres of the circles of the inner and the outer edge of the face, camera frame."""
    edges_m = np.zeros((2, 3))
    edges_m[:, 2] = ring.edge_heights_m
    return illuminated.placement.points_camera(edges_m)


FORM_STEPS = 4
"""Newton steps to the break points of a deviating ring; the third one is shorter than 1e-9 m."""


def form_displacement(
    form: RingForm,
    point_m: Float64[Array, "laser edge=2 xyz=3"],
    center_m: Float64[Array, "*edge xyz=3"],
    axes: Float64[Array, "3 3"],
    light_normal: Float64[Array, "laser xyz=3"],
) -> Float64[Array, "laser edge=2 xyz=3"]:
    """Displacement of break points on the inner and the outer edge by the ring's form, by Newton's method.

    The points stay on their light planes. The columns of `axes` are the x, y and z axes of the ring; `center_m` is the
    centre of both edges, or of each.
    """
    normal, in_plane = axes[:, 2], point_m - center_m
    radius_m = np.linalg.norm(in_plane, axis=-1)
    displacement = np.zeros_like(point_m)
    for _ in range(FORM_STEPS):
        place_m = in_plane + displacement
        height_m = place_m @ normal
        outward = place_m - height_m[..., None] * normal
        distance_m = np.linalg.norm(outward, axis=-1)
        radial_m, axial_m = form_deviations(form, place_m @ axes, np.array([0, 1]))
        rows = np.stack(np.broadcast_arrays(light_normal[:, None], normal, outward / distance_m[..., None]), axis=-2)
        values = np.stack([np.zeros_like(radius_m), axial_m - height_m, radius_m + radial_m - distance_m], axis=-1)
        displacement = displacement + np.linalg.solve(rows, values[..., None])[..., 0]
    return displacement


def form_deviations(
    form: RingForm, place_m: Float64[Array, "*shape n xyz=3"], edge: Int64[Array, "n"]
) -> tuple[Float64[Array, "*shape n"], Float64[Array, "*shape n"]]:
    """Radial deviations of an edge and axial deviations of the face, at places in the ring's own axes."""
    phase = np.arctan2(place_m[..., 1], place_m[..., 0])[..., None] * np.array(FORM_ORDERS)
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=-1)
    return (waves * form.radial_m[edge]).sum(axis=(-2, -1)), (waves * form.axial_m).sum(axis=(-2, -1))


def _visible_and_lit(
    illuminated: IlluminatedTarget, ring: RingShape, point_m: Float64[Array, "laser edge=2 xyz=3"]
) -> Bool[Array, "laser edge=2"]:
    """Whether points on the rim are visible to the camera and lit by their laser, and not in a gap of the ring."""
    placement, light = illuminated.placement, illuminated.sheets
    shown = np.zeros(point_m.shape[:2], dtype=np.bool_)
    for laser, points in enumerate(point_m):
        seen = np.flatnonzero(np.isfinite(points).all(axis=1))
        at = placement.points_target(points[seen].T)
        radial = at[:2] / np.linalg.norm(at[:2], axis=0)
        at = at + _INSIDE_M * np.vstack([np.where(seen == 0, 1.0, -1.0) * radial, np.ones(len(seen))])
        to_eye = placement.eye_m[:, None] - at
        to_projector = light.projector_m[laser][:, None] - at
        clear = ~blocked(illuminated.target, at, to_eye) & ~blocked(illuminated.target, at, to_projector)
        clear &= (to_eye[2] > 0) & (to_projector[2] > 0) & in_fan(light, laser, at)
        shown[laser, seen] = clear & ~in_gap(ring, at.T)
    return shown


def in_gap(ring: RingShape, point_m: Float64[Array, "*shape xyz=3"]) -> Bool[Array, "*shape"]:
    """Which points on the face, in the ring's own axes, are missing because a gap interrupts the ring there."""
    x, y = point_m[..., 0], point_m[..., 1]
    inside = np.zeros(x.shape, dtype=np.bool_)
    for gap in ring.gaps:
        cosine, sine = np.cos(gap.angle_rad), np.sin(gap.angle_rad)
        inside |= (np.abs(y * cosine - x * sine) <= gap.width_m / 2) & (x * cosine + y * sine >= 0)
    return inside
