"""Whether the map of a lens from rays to pixels is one-to-one inside the image (ringpose-conventions(7))."""

import numpy as np

from ringpose.geometry.rays import pixels_wrt_ray_and_camera, project
from ringpose.types.arrays import Array, Float64
from ringpose.types.rig import Camera

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
