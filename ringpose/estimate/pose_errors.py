"""Errors of an estimated ring pose relative to the truth, in the camera frame, metres and radians."""

import math
from dataclasses import replace

import numpy as np

from ringpose.errors import DataError
from ringpose.geometry.rays import intersect, project, rays
from ringpose.geometry.rotations import angle_between, tilt_basis
from ringpose.types.arrays import Array, Float64
from ringpose.types.rig import Camera
from ringpose.types.truth import Truth

MAX_BAND_DISTANCE_M = 0.005
"""A grasp point farther than this from the rim is wrong, whatever its covariance."""

MAX_PROPAGATION_S = 1.0
"""Longer than any shot; a larger difference of time stamps means that pose and truth used different clocks."""

MAX_TILT = 1e3
"""Upper limit of the tangent of a tilt error: that of 89.94 degrees."""


def truth_at(truth: Truth, stamp_s: float, shot_stamp_s: float = math.nan) -> Truth:
    """The truth at the instant at which a pose holds, in the camera frame.

    It is interpolated between its frames, else propagated with constant velocities from its own time stamp, by default
    that of the shot. A truth that does not move is returned as it is. Raises DataError if the pose is stamped more than
    `MAX_PROPAGATION_S` from the truth or its frames.
    """
    if math.isnan(stamp_s) or truth.center_m is None or truth.normal is None:
        return truth
    if truth.frames:
        return _between_frames(truth, stamp_s)
    moving = truth.velocity_m_s is not None or truth.angular_velocity_rad_s is not None
    elapsed_s = stamp_s - (shot_stamp_s if truth.stamp_s is None else truth.stamp_s)
    if math.isnan(elapsed_s) or not moving:
        return truth
    _check_clock(truth, elapsed_s)
    velocity_m_s = np.zeros(3) if truth.velocity_m_s is None else truth.velocity_m_s
    rates_rad_s = np.zeros(3) if truth.angular_velocity_rad_s is None else truth.angular_velocity_rad_s
    across_rad = elapsed_s * np.cross(rates_rad_s, truth.normal)  # rotation about the normal has no effect
    angle_rad = float(np.linalg.norm(across_rad))
    turned = math.cos(angle_rad) * truth.normal + np.sinc(angle_rad / math.pi) * across_rad
    return replace(truth, center_m=truth.center_m + elapsed_s * velocity_m_s, normal=turned)


def _check_clock(truth: Truth, elapsed_s: float) -> None:
    if abs(elapsed_s) > MAX_PROPAGATION_S:
        raise DataError(
            truth.shot,
            f"is stamped {elapsed_s:.6g} s after its truth, which moves",
            "give poses and truth that were stamped by one clock",
        )


def _between_frames(truth: Truth, stamp_s: float) -> Truth:
    """The truth between its frames: centre and angle of the normal are interpolated linearly.

    They are extrapolated before the first and after the last frame.
    """
    frames = truth.frames
    stamps_s = np.array([frame.stamp_s for frame in frames])
    _check_clock(truth, float(stamp_s - np.clip(stamp_s, stamps_s[0], stamps_s[-1])))
    if len(frames) == 1:
        return replace(truth, center_m=frames[0].center_m, normal=frames[0].normal)
    first = int(np.clip(np.searchsorted(stamps_s, stamp_s) - 1, 0, len(frames) - 2))
    start, end = frames[first], frames[first + 1]
    share = (stamp_s - start.stamp_s) / (end.stamp_s - start.stamp_s)
    angle_rad = float(angle_between(start.normal[None], end.normal[None])[0])
    normal = start.normal
    if angle_rad > 0:  # two equal normals have no great circle
        parts = np.sin(np.array([1.0 - share, share]) * angle_rad) / math.sin(angle_rad)
        normal = parts @ np.array([start.normal, end.normal])
    return replace(truth, center_m=(1.0 - share) * start.center_m + share * end.center_m, normal=normal)


def circle_error(
    point_m: Float64[Array, "3"], center_m: Float64[Array, "3"], normal: Float64[Array, "3"], radius_m: float
) -> tuple[Float64[Array, "2 xyz=3"], Float64[Array, "2"]]:
    """The normal and the radial direction at a point, and its signed distances from a circle along them."""
    from_center_m = point_m - center_m
    height_m = normal @ from_center_m
    outwards_m = from_center_m - height_m * normal
    from_axis_m = np.linalg.norm(outwards_m)
    radial = outwards_m / from_axis_m if from_axis_m > 0 else tilt_basis(normal)[0]
    return np.array([normal, radial]), np.array([height_m, from_axis_m - radius_m])


def mahalanobis_squared(error: Float64[Array, "n"], covariance: Float64[Array, "n n"]) -> float:
    """Squared Mahalanobis length of an error; variances are at least 1e-12 of the largest.

    Divided by n and averaged over many shots this is the NEES, which is 1 if the covariance is correct.
    """
    variance, axes = np.linalg.eigh(covariance)
    floor = max(float(variance[-1]) * 1e-12, 1e-30)
    return float(np.sum((axes.T @ error) ** 2 / np.maximum(variance, floor)))


def tilt_error_rad(normal: Float64[Array, "3"], true_normal: Float64[Array, "3"]) -> Float64[Array, "2"]:
    """The tilts t1, t2 that rotate the estimated normal into the true one, in the tilt basis of the estimate.

    The tilts are tangents of angles. They are limited to `MAX_TILT`, which also stands for angles of 90 degrees or
    more.
    """
    sine, cosine = tilt_basis(normal) @ true_normal, float(normal @ true_normal)
    length = float(np.linalg.norm(sine))
    if length < MAX_TILT * cosine:
        tilt: Float64[Array, "2"] = sine / cosine
        return tilt
    direction: Float64[Array, "2"] = sine / length if length > 0 else np.array([1.0, 0.0])
    return MAX_TILT * direction


def mid_radius_m(truth: Truth) -> float | None:
    """Mean of both radii, None unless the truth has both."""
    if truth.radius_inner_m is None or truth.radius_outer_m is None:
        return None
    return (truth.radius_inner_m + truth.radius_outer_m) / 2


def misses_band(grasp_m: Float64[Array, "3"], truth: Truth, camera: Camera | None) -> bool:
    """Whether a grasp point is off the rim, or outside the arc in which break points were visible."""
    if truth.center_m is None or truth.normal is None:
        return False
    if truth.radius_outer_m is not None and (radius_m := mid_radius_m(truth)) is not None:
        height_m, from_mid_m = circle_error(grasp_m, truth.center_m, truth.normal, radius_m)[1]
        beside_m = max(0.0, abs(from_mid_m) - (truth.radius_outer_m - radius_m))
        if math.hypot(height_m, beside_m) > MAX_BAND_DISTANCE_M:
            return True
    return camera is not None and outside_arc(grasp_m, truth, camera)


def outside_arc(grasp_m: Float64[Array, "3"], truth: Truth, camera: Camera) -> bool:
    """Whether a grasp point lies outside the arc between the outermost true break points, and the one opposite to it.

    An arc is extended by half the width of the rim at each end, because the arc of a single stripe is very short.
    """
    if truth.center_m is None or truth.normal is None or truth.break_points_px is None:
        return False
    points = _points_on_ring(truth.break_points_px, truth.center_m, truth.normal, camera)
    if not len(points):
        return False
    opposite = _in_image(_opposite_points(truth.break_points_px, truth.center_m, truth.normal, camera), camera)
    return _beside_arc(grasp_m, points, truth) and (not len(opposite) or _beside_arc(grasp_m, opposite, truth))


def _beside_arc(grasp_m: Float64[Array, "3"], points: Float64[Array, "point xyz=3"], truth: Truth) -> bool:
    """Whether a grasp point lies beside the arc between the outermost of some points on the ring."""
    if truth.center_m is None or truth.normal is None:
        return False
    middle = (points - truth.center_m).mean(axis=0)
    angles = _angles_rad(points - truth.center_m, middle, truth.normal)
    grasp = _angles_rad((grasp_m - truth.center_m)[None], middle, truth.normal)[0]
    margin_rad = _half_rim_width_rad(truth)
    return not angles.min() - margin_rad <= grasp <= angles.max() + margin_rad


def _opposite_points(
    break_points_px: Float64[Array, "laser edge=2 xy=2"],
    center_m: Float64[Array, "3"],
    normal: Float64[Array, "3"],
    camera: Camera,
) -> Float64[Array, "point xyz=3"]:
    """Where the lines of the stripes with two break points leave the ring on its opposite arc."""
    both = ~np.isnan(break_points_px[..., 0]).any(axis=1)
    ends = intersect(rays(break_points_px[both], camera).reshape(-1, 3), normal, np.asarray(normal @ center_m))
    inner, outer = ends.reshape(-1, 2, 3).swapaxes(0, 1)
    along = (outer - inner) / np.linalg.norm(outer - inner, axis=1, keepdims=True)
    from_foot_m = ((ends.reshape(-1, 2, 3) - center_m) * along[:, None]).sum(axis=-1)  # along the stripe
    opposite = ends.reshape(-1, 2, 3) - 2.0 * from_foot_m[..., None] * along[:, None]
    return opposite.reshape(-1, 3)


def _in_image(points_m: Float64[Array, "n xyz=3"], camera: Camera) -> Float64[Array, "shown xyz=3"]:
    """The points that project into the image."""
    size_px = np.array([camera.image_width, camera.image_height]) - 1.0
    position_px = project(points_m, camera)
    return points_m[((position_px >= 0.0) & (position_px <= size_px)).all(axis=1)]


def _points_on_ring(
    break_points_px: Float64[Array, "laser edge=2 xy=2"],
    center_m: Float64[Array, "3"],
    normal: Float64[Array, "3"],
    camera: Camera,
) -> Float64[Array, "point xyz=3"]:
    """Intersections of the rays through the visible break points with the plane of the ring."""
    seen = break_points_px[~np.isnan(break_points_px[..., 0])]
    points = intersect(rays(seen, camera), normal, np.asarray(normal @ center_m))
    return points[~np.isnan(points[:, 0])]


def _angles_rad(
    directions: Float64[Array, "n xyz=3"], reference: Float64[Array, "3"], normal: Float64[Array, "3"]
) -> Float64[Array, "n"]:
    """Angles about the axis of the ring from a reference direction, between -pi and pi."""
    across = np.vstack([directions, reference]) @ tilt_basis(normal).T
    angles = np.arctan2(across[:, 1], across[:, 0])
    turned: Float64[Array, "n"] = np.angle(np.exp(1j * (angles[:-1] - angles[-1])))
    return turned


def _half_rim_width_rad(truth: Truth) -> float:
    """Half the width of the rim as an angle at the mean radius."""
    inner_m, outer_m = truth.radius_inner_m or 0.0, truth.radius_outer_m or 0.0
    return (outer_m - inner_m) / (outer_m + inner_m) if outer_m > 0 else 0.0
