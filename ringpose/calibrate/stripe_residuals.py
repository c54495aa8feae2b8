"""How far a stripe's centres lie from a light plane, in pixels, and what moves them (ringpose-method(7), section 6)."""

from typing import NamedTuple

import cv2
import numpy as np

from ringpose.geometry.rotations import rotation_vector, tilt_basis
from ringpose.pose.measurements import pixels_by_ray_and_camera
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose
from ringpose.types.camera import Camera


class StripeRows(NamedTuple):
    """One row a centre."""

    residual_px: Float64[Array, "n"]
    """Distance in the image from the line that the light plane draws on the board, its sign that of the light plane."""
    by_pose: Float64[Array, "n pose=6"]
    """Derivatives, the scale of pixels held: by the board's rotation vector and translation ..."""
    by_plane: Float64[Array, "n plane=3"]
    """... by the light plane's two tilts and distance ..."""
    by_camera: Float64[Array, "n parameter"]
    """... and by the intrinsic parameters, the pixels held."""
    metres_per_pixel: Float64[Array, "n"]
    """Distance from the light plane that a pixel across the stripe makes."""


def stripe_rows(
    rays: Float64[Array, "n xyz=3"],
    pose: BoardPose,
    normal: Float64[Array, "xyz=3"],
    distance_m: float,
    camera: Camera,
) -> StripeRows:
    """Rows of centres seen along rays (x, y, 1) on a board, against the light plane `normal . P = distance_m`.

    The centre's place on the board is P = D r / (n_b . r), D = n_b . c_b, so that with q = (n . r) / (n_b . r)
    d(n . P) = q n_b . dc_b + q (c_b - P) . dn_b + D / (n_b . r) (n - q n_b) . dr.
    """
    board_normal = pose.rotation[:, 2]
    steepness = rays @ board_normal
    share = (rays @ normal) / steepness
    depth = float(board_normal @ pose.translation_m) / steepness
    points = depth[:, None] * rays
    by_ray = (depth[:, None] * (normal - share[:, None] * board_normal))[:, :2]
    pixel_by_ray, pixel_by_camera = pixels_by_ray_and_camera(rays[:, :2], camera)
    by_pixel = np.linalg.solve(pixel_by_ray.transpose(0, 2, 1), by_ray[:, :, None])[:, :, 0]
    metres_per_pixel = np.linalg.norm(by_pixel, axis=1)

    by_board_normal = share[:, None] * (pose.translation_m - points)
    by_pose = np.hstack([by_board_normal @ _normal_by_rotation(pose), share[:, None] * board_normal])
    by_plane = np.hstack([points @ tilt_basis(normal).T, np.full((len(rays), 1), -1.0)])
    by_camera = -np.einsum("ni,nip->np", by_pixel, pixel_by_camera)
    return StripeRows(
        residual_px=(points @ normal - distance_m) / metres_per_pixel,
        by_pose=by_pose / metres_per_pixel[:, None],
        by_plane=by_plane / metres_per_pixel[:, None],
        by_camera=by_camera / metres_per_pixel[:, None],
        metres_per_pixel=metres_per_pixel,
    )


def _normal_by_rotation(pose: BoardPose) -> Float64[Array, "xyz=3 rotation=3"]:
    """Derivative of the board's normal by its rotation vector."""
    by_vector = np.asarray(cv2.Rodrigues(rotation_vector(pose.rotation))[1], dtype=np.float64).reshape(3, 3, 3)
    return by_vector[:, :, 2].T
