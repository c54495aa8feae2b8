"""The part of the ring that the stripes span: outside it nothing was measured."""

import numpy as np

from ringpose.geometry.rays import intersect, rays
from ringpose.geometry.rotations import tilt_basis
from ringpose.types.arrays import Array, Float64
from ringpose.types.camera import Camera
from ringpose.types.truth import Truth


def outside_arc(grasp_m: Float64[Array, "3"], truth: Truth, camera: Camera) -> bool:
    """Whether a grasp point lies outside the arc between the outermost true break points.

    Half the width of the band is granted at each end: a lone stripe across the ring spans next to nothing.
    """
    if truth.center_m is None or truth.normal is None or truth.break_points_px is None:
        return False
    points = _points_on_ring(truth.break_points_px, truth.center_m, truth.normal, camera)
    if not len(points):
        return False
    middle = (points - truth.center_m).mean(axis=0)
    angles = _angles_rad(points - truth.center_m, middle, truth.normal)
    grasp = _angles_rad((grasp_m - truth.center_m)[None], middle, truth.normal)[0]
    granted_rad = _half_band_rad(truth)
    return not angles.min() - granted_rad <= grasp <= angles.max() + granted_rad


def _points_on_ring(
    break_points_px: Float64[Array, "laser edge=2 xy=2"],
    center_m: Float64[Array, "3"],
    normal: Float64[Array, "3"],
    camera: Camera,
) -> Float64[Array, "point xyz=3"]:
    """Where the rays through the break points that are seen meet the ring's plane."""
    seen = break_points_px[~np.isnan(break_points_px[..., 0])]
    points = intersect(rays(seen, camera), normal, np.asarray(normal @ center_m))
    return points[~np.isnan(points[:, 0])]


def _angles_rad(
    directions: Float64[Array, "n xyz=3"], reference: Float64[Array, "3"], normal: Float64[Array, "3"]
) -> Float64[Array, "n"]:
    """Angles about the ring's axis from a reference direction, between -pi and pi."""
    across = np.vstack([directions, reference]) @ tilt_basis(normal).T
    angles = np.arctan2(across[:, 1], across[:, 0])
    turned: Float64[Array, "n"] = np.angle(np.exp(1j * (angles[:-1] - angles[-1])))
    return turned


def _half_band_rad(truth: Truth) -> float:
    inner_m, outer_m = truth.radius_inner_m or 0.0, truth.radius_outer_m or 0.0
    return (outer_m - inner_m) / (outer_m + inner_m) if outer_m > 0 else 0.0
