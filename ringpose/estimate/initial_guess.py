"""Initial guess of the ring, from the stripes' lines (ringpose-method(7), section 5).

The paper's closed form is not needed as a start: on the plane the inverse depth is linear in the image, so the lines
give the plane at once, and every ring is then within a few steps of its estimate.
"""

import numpy as np

from ringpose.estimate.measurements import Measurements, Observations
from ringpose.estimate.residuals import EXPECTED_CURVATURE, EXPECTED_HALF_BAND_M, Prior
from ringpose.geometry.ring import RingArcs
from ringpose.geometry.rotations import cross
from ringpose.types.arrays import Array, Float64

MIN_LENGTH_M = 1e-9
"""A shorter vector has no direction."""


def initial_guess(measured: Measurements, observations: Observations, prior: Prior) -> RingArcs | None:
    """The plane of the stripes, and a ring of typical size on it; None if the plane is not in front of the camera.

    The origin lies on the middle of the face, on the mean ray of the break points.
    """
    if not len(measured.points.x):
        return None
    view = observations.view
    try:
        plane = _plane_of_stripes(measured, observations)
    except np.linalg.LinAlgError:
        return None
    # the stripes on that plane, and the break points on them
    image_line = view.light_normal - view.light_distance_m[:, None] * plane
    slope = image_line[:, 0] / -image_line[:, 1]
    rays = view.rays.copy()
    rays[:, 1] = slope * rays[:, 0] - image_line[:, 2] / image_line[:, 1]
    inverse_depth = rays @ plane
    if not bool((inverse_depth > 0).all()):
        return None
    ends = view.ends
    rays, slope, depth_m = rays[ends:], slope[ends:], 1.0 / inverse_depth[ends:]
    points_m = depth_m[:, None] * rays
    # dP/dx of the break points along their stripes, for P = depth r
    points_wrt_x = depth_m[:, None] * np.column_stack([np.ones_like(slope), slope, np.zeros_like(slope)])
    points_wrt_x -= (depth_m * (plane[0] + slope * plane[1]))[:, None] * points_m

    normal = -plane / float(np.sqrt(plane @ plane))
    outward = _outward_direction(normal, measured, points_m, points_wrt_x)
    mean_ray = rays.mean(axis=0)
    curvature, half_band_m = _expected_size(measured, points_m @ outward, prior)
    return RingArcs(
        origin=mean_ray / float(mean_ray @ plane),
        axes=np.array([-outward, cross(normal, -outward), normal]),
        curvature=curvature,
        half_band_m=half_band_m,
    )


def _plane_of_stripes(measured: Measurements, observations: Observations) -> Float64[Array, "3"]:
    """The plane q that fits the stripes: (m . r - d q . r) / (m - d q)_y = 0, linear in q for a fixed denominator."""
    view = observations.view
    ends, count = view.ends, len(view.rays)
    whitening = np.zeros((count, count))
    whitening[:ends, :ends] = observations.whitening
    isolated = ends + np.flatnonzero(measured.points.isolated)
    whitening[isolated, isolated] = 1.0 / np.sqrt(measured.points.covariance[isolated - ends, 1, 1])
    distance_m = view.light_distance_m
    cosine = (view.light_normal * view.rays).sum(axis=1)  # m . r
    plane = np.array([0.0, 0.0, float((cosine / distance_m).sum()) / count])
    for _ in range(2):
        denominator = view.light_normal[:, 1] - distance_m * plane[1]
        rows = whitening @ ((distance_m / denominator)[:, None] * view.rays)
        matrix = rows.T @ rows
        matrix[[0, 1], [0, 1]] += 1.0 / plane[2] ** 2  # with a single stripe: a plane that faces the camera
        plane = np.linalg.solve(matrix, rows.T @ (whitening @ (cosine / denominator)))
    return plane


def _outward_direction(
    normal: Float64[Array, "3"],
    measured: Measurements,
    points_m: Float64[Array, "point 3"],
    points_wrt_x: Float64[Array, "point 3"],
) -> Float64[Array, "3"]:
    """Mean direction from inner towards outer ends, seen from the middles of their stripes."""
    points = measured.points
    direction = ((2.0 * points.edge - 1.0) * (points.x - points.middle_x)) @ points_wrt_x
    if float(direction @ direction) < MIN_LENGTH_M**2:  # no stripe has a length: across the row of break points
        direction = cross(normal, points_m[-1] - points_m[0])
    if float(direction @ direction) < MIN_LENGTH_M**2:  # a single point: along its stripe
        direction = points_wrt_x[0]
    direction = direction - (direction @ normal) * normal
    unit: Float64[Array, "3"] = direction / np.sqrt(direction @ direction)
    return unit


def _expected_size(measured: Measurements, outward_m: Float64[Array, "point"], prior: Prior) -> tuple[float, float]:
    """Curvature (1/m) of the ring and half the width (m) of its face.

    Both follow from the prior of the radii where it gives them. Otherwise the curvature is that of a typical ring, and
    the width is the mean distance between the inner and the outer break points, at `outward_m` in radial direction.
    """
    inner, outer = (outward_m[measured.points.edge == edge].tolist() for edge in range(2))
    half_band_m = 0.5 * (sum(outer) / len(outer) - sum(inner) / len(inner)) if inner and outer else EXPECTED_HALF_BAND_M
    if prior.radii is None or not np.isfinite(prior.radii.radius_m).any():
        return EXPECTED_CURVATURE, half_band_m
    inner_m, outer_m = prior.radii.radius_m.tolist()
    both_known = np.isfinite(outer_m - inner_m)
    return 1.0 / float(np.nanmean(prior.radii.radius_m)), 0.5 * (outer_m - inner_m) if both_known else half_band_m
