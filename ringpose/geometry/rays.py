"""Rays, their projection and undistortion, and planes `normal . point = distance` (ringpose-method(7), section 1)."""

from typing import Any

import cv2
import numpy as np

from ringpose.types.arrays import Array, Float64
from ringpose.types.rig import Camera

_EXACT = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
"""Termination of the iterative undistortion: iterations, and the error in pixels at which a point is done.

OpenCV's default of five iterations leaves errors of up to 0.01 px. An error below the spacing of doubles, 2e-13 at 1600
pixels, is never reached: each point would take all iterations, five times as long.
"""

GRAZING = 1e-9
"""Cosine between a ray and a plane's normal below which the ray is treated as parallel to the plane."""

POINTS_OF_A_PLANE = 3
"""Points that determine a plane."""


def undistort(points_px: Float64[Array, "*shape xy=2"], camera: Camera) -> Float64[Array, "*shape xy=2"]:
    """Normalised image coordinates x/z, y/z of distorted pixels; NaN is propagated."""
    flat = np.ascontiguousarray(points_px, dtype=np.float64).reshape(-1, 1, 2)
    if not len(flat):
        return np.empty_like(points_px)
    matrix, coefficients = camera.camera_matrix, camera.distortion_coefficients
    iterative: Any = getattr(cv2, "undistortPointsIter", None)
    if iterative is not None:  # OpenCV 4; in OpenCV 5 undistortPoints itself takes the criteria
        normalised = iterative(flat, matrix, coefficients, None, None, _EXACT)
    else:
        normalised = cv2.undistortPoints(flat, matrix, coefficients, criteria=_EXACT)
    return np.asarray(normalised, dtype=np.float64).reshape(points_px.shape)


def rays(points_px: Float64[Array, "*shape xy=2"], camera: Camera) -> Float64[Array, "*shape xyz=3"]:
    """Rays (x, y, 1) through distorted pixels, in the camera frame; NaN is propagated."""
    normalised = undistort(points_px, camera)
    return np.concatenate([normalised, np.ones_like(normalised[..., :1])], axis=-1)


def undistorted_pixels(points_px: Float64[Array, "*shape xy=2"], camera: Camera) -> Float64[Array, "*shape xy=2"]:
    """Undistorted pixels: the projections by the same camera matrix without distortion."""
    focal, principal = _focal_and_principal(camera)
    return undistort(points_px, camera) * focal + principal


def undistorted_rays(points_px: Float64[Array, "*shape xy=2"], camera: Camera) -> Float64[Array, "*shape xyz=3"]:
    """Rays (x, y, 1) through undistorted pixels."""
    focal, principal = _focal_and_principal(camera)
    normalised = (points_px - principal) / focal
    return np.concatenate([normalised, np.ones_like(normalised[..., :1])], axis=-1)


def project(points: Float64[Array, "*shape xyz=3"], camera: Camera) -> Float64[Array, "*shape xy=2"]:
    """Distorted pixels of points in the camera frame; NaN for points at or behind the camera."""
    flat = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
    flat = np.where(flat[:, 2:] > 0, flat, np.nan)
    if not len(flat):
        return np.empty((*points.shape[:-1], 2))
    origin = np.zeros(3)
    pixels, _ = cv2.projectPoints(flat, origin, origin, camera.camera_matrix, camera.distortion_coefficients)
    return np.asarray(pixels, dtype=np.float64).reshape(*points.shape[:-1], 2)


def intersect(
    directions: Float64[Array, "*shape xyz=3"],
    normal: Float64[Array, "*#shape xyz=3"],
    distance_m: Float64[Array, "*#shape"],
) -> Float64[Array, "*shape xyz=3"]:
    """Intersections of rays r from the camera's centre with planes m . P = d: P = t r with t = d / (m . r).

    NaN where a ray is parallel to its plane, or meets it behind the camera.
    """
    cosine = (directions * normal).sum(axis=-1)
    length = np.sqrt((directions * directions).sum(axis=-1))
    along = np.abs(cosine) < GRAZING * length
    parameter = distance_m / np.where(along, np.nan, cosine)
    points: Float64[Array, "*shape xyz=3"] = np.where(parameter > 0, parameter, np.nan)[..., None] * directions
    return points


def _focal_and_principal(camera: Camera) -> tuple[Float64[Array, "2"], Float64[Array, "2"]]:
    matrix = camera.camera_matrix
    return np.array([matrix[0, 0], matrix[1, 1]]), np.array([matrix[0, 2], matrix[1, 2]])


def rays_wrt_pixel_and_camera(
    xy: Float64[Array, "n xy=2"], camera: Camera
) -> tuple[Float64[Array, "n 2 2"], Float64[Array, "n 2 parameter"]]:
    """Derivatives of the normalised coordinates by the distorted pixel and, for fixed pixels, by the camera."""
    pixel_wrt_ray, pixel_wrt_camera = pixels_wrt_ray_and_camera(xy, camera)
    inverse: Float64[Array, "n 2 2"] = np.linalg.inv(pixel_wrt_ray)
    return inverse, -inverse @ pixel_wrt_camera


def pixels_wrt_ray_and_camera(
    xy: Float64[Array, "n xy=2"], camera: Camera
) -> tuple[Float64[Array, "n 2 2"], Float64[Array, "n 2 parameter"]]:
    """Derivatives of the distorted pixel with respect to the ray (x, y, 1), and to fx, fy, cx, cy, k1, k2, ..."""
    if not len(xy):
        return np.empty((0, 2, 2)), np.empty((0, 2, 4 + len(camera.distortion_coefficients)))
    rays = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
    zero = np.zeros(3)
    _, jacobian = cv2.projectPoints(rays, zero, zero, camera.camera_matrix, camera.distortion_coefficients)
    columns = np.asarray(jacobian, dtype=np.float64).reshape(len(xy), 2, -1)
    return columns[:, :, 3:5], columns[:, :, 6:]  # 0 to 2 rotation, 3 and 4 translation in x and y, from 6 the camera


def nearest_plane(
    points: Float64[Array, "n xyz=3"], weights: Float64[Array, "n"] | None = None
) -> tuple[Float64[Array, "3"], float, Float64[Array, "3"]]:
    """Total-least-squares plane through the points, with their singular values.

    Returns the unit normal (either sign), the distance with `normal . point = distance`, and the singular
    values of the centred weighted points, descending; the second is zero for collinear points.
    """
    weight = np.ones(len(points)) if weights is None else weights
    middle = weight @ points / weight.sum()
    _, singular_values, axes = np.linalg.svd(np.sqrt(weight)[:, None] * (points - middle), full_matrices=False)
    normal: Float64[Array, "3"] = axes[-1]
    return normal, float(normal @ middle), singular_values


def towards_camera(normal: Float64[Array, "3"], point: Float64[Array, "3"]) -> Float64[Array, "3"]:
    """The normal or its opposite, whichever points from `point` towards the camera's centre."""
    return -normal if normal @ point > 0 else normal


# Whether the map of a lens from rays to pixels is one-to-one inside the image (ringpose-conventions(7))

_PER_SIDE = 8
"""Directions from the principal point that are examined: to each corner, and evenly along each side of the image."""

_SAMPLES = 128
"""Rays in each direction; half of them lie where a lens without distortion has the image, the others beyond."""

_WIDEST = 0.99
"""The last ray of a direction, on a scale of which 0.5 is the image's border and 1 a right angle to the axis."""

_NEAR_AXIS = 0.5
"""Largest distortion of the ray next to the axis, relative to its distance from it: a lens is nearly linear there."""


def fold_px(camera: Camera) -> Float64[Array, "xy=2"] | None:
    """The pixel of the image, nearest to the principal point, beyond which pixels have no ray; None if all have one.

    Rays are followed outward from the optical axis until their pixels leave the image. Where the determinant of the
    Jacobian becomes zero on this way, the map turns back: two rays share each pixel before it. Undistorting the pixels
    instead would not show it, as the iteration ends at some ray, or diverges, without a sign of either.
    """
    rays, pixels, determinant = _followed(camera)
    size, principal = np.array([camera.image_width, camera.image_height]), camera.camera_matrix[:2, 2]
    inside = np.all((pixels >= -0.5) & (pixels <= size - 0.5), axis=-1)
    entered = np.logical_or.accumulate(inside, axis=1)
    left = np.logical_or.accumulate(entered & ~inside, axis=1)
    folded = ~(determinant > 0) & ~left
    folded[:, -1] |= inside[:, -1] & ~left[:, -1]  # the image is not left by any ray
    undistorted = np.diag(camera.camera_matrix)[:2] * rays[:, 1]
    distortion = np.linalg.norm(pixels[:, 1] - principal - undistorted, axis=-1)
    folded[:, 1] |= ~(distortion < _NEAR_AXIS * np.linalg.norm(undistorted, axis=-1))
    if not folded.any():
        return None
    first = np.where(folded.any(axis=1), folded.argmax(axis=1), _SAMPLES)
    row = int(first.argmin())
    return pixels[row, max(int(first[row]) - 1, 0)]


def _followed(
    camera: Camera,
) -> tuple[Float64[Array, "direction ray xy=2"], Float64[Array, "direction ray xy=2"], Float64[Array, "direction ray"]]:
    """Rays by direction and distance from the axis, their pixels, and the determinants of the map there."""
    size, matrix = np.array([camera.image_width, camera.image_height], dtype=np.float64), camera.camera_matrix
    toward = (_border(size) - matrix[:2, 2]) / np.diag(matrix)[:2]
    length = np.linalg.norm(toward, axis=1, keepdims=True)
    toward, length = toward[length[:, 0] > 0], length[length[:, 0] > 0]
    reach = np.maximum(length, length.max() / 4)  # a principal point near the border
    steps = np.tan(np.linspace(0.0, _WIDEST, _SAMPLES) * np.pi / 2)
    rays = (toward / length * reach)[:, None] * steps[:, None]
    flat = rays.reshape(-1, 2)
    pixels = project(np.column_stack([flat, np.ones(len(flat))]), camera)
    jacobian, _ = pixels_wrt_ray_and_camera(flat, camera)
    with np.errstate(invalid="ignore", over="ignore"):
        determinant = jacobian[:, 0, 0] * jacobian[:, 1, 1] - jacobian[:, 0, 1] * jacobian[:, 1, 0]
    return rays, pixels.reshape(rays.shape), determinant.reshape(rays.shape[:2])


def _border(size: Float64[Array, "xy=2"]) -> Float64[Array, "n xy=2"]:
    """Points on the image's border, its corners included."""
    along = np.linspace(-0.5, size - 0.5, _PER_SIDE, endpoint=False)
    back = size - 1 - along
    top = np.column_stack([along[:, 0], np.full(_PER_SIDE, -0.5)])
    right = np.column_stack([np.full(_PER_SIDE, size[0] - 0.5), along[:, 1]])
    bottom = np.column_stack([back[:, 0], np.full(_PER_SIDE, size[1] - 0.5)])
    left = np.column_stack([np.full(_PER_SIDE, -0.5), back[:, 1]])
    return np.concatenate([top, right, bottom, left])
