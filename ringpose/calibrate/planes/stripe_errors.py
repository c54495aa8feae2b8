"""How far a stripe's line may err in the image.

How far a stripe's centres lie from a light plane, in pixels, and what moves them (ringpose-method(7), section 6).
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from ringpose.geometry.rotations import rotation_vector, tilt_basis
from ringpose.pose.measurements import pixels_wrt_ray_and_camera
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose
from ringpose.types.camera import Camera

REACH_PX = 16
"""Neighbours up to here may be alike; those nearer than half of it count in full. Speckle reaches a quarter."""

MIN_LENGTH = 96
"""Fewer centres tell nothing: the line through them takes what they have in common."""

ENOUGH = 480.0
"""So many centres tell their likeness to a quarter ..."""

USUAL_LENGTH = 3.0
"""... and what fewer leave open is taken from here: 1.2 to 4.1 on simulated boards of three kinds."""

_TERMS = 4
"""Of the smooth line that centres are held against."""


def stripe_bend(points_px: Float64[Array, "n xy=2"]) -> Float64[Array, "2 n xy=2"]:
    """Two independent ways in which a stripe's line may err: shifted, and turned about its middle, by one pixel rms."""
    middle = points_px - points_px.mean(axis=0)
    along = np.linalg.svd(middle, full_matrices=False)[2][0]
    across = np.array([-along[1], along[0]])
    run = middle @ along
    ways = np.stack([np.ones(len(run)), run / np.sqrt(np.mean(run**2))])
    bend: Float64[Array, "2 n xy=2"] = ways[..., None] * across
    return bend


def center_sigma_px(points_px: Float64[Array, "n xy=2"], length: float) -> float:
    """Standard deviation of a centre for which neighbours, so many of which count as one, may be taken as independent.

    The smooth line takes some of the scatter with it, the more the longer the neighbours are alike; two more are taken
    off because the scatter itself is known from so few only (Student's distribution).
    """
    left = max(len(points_px) - (_TERMS + 2) * length, 1.0)
    _, residual = _residual_px(points_px)
    return float(np.sqrt(length * (residual @ residual) / left))


def shared_length(stripes_px: Sequence[Float64[Array, "_ xy=2"]]) -> float:
    """Number of neighbours that count as one, from the products of neighbouring residuals of many stripes.

    Short stripes, and those that printed squares cut to pieces, hardly show theirs by themselves: taken from each
    alone, errors were three times as large as they were said to be. What the smooth lines take of the products and of
    the squares is given back.
    """
    products, centers = 0.0, 0.0
    for points_px in stripes_px:
        if len(points_px) < MIN_LENGTH:
            continue
        run, residual = _residual_px(points_px)
        share, taken = _likeness(run, residual)
        products += share * len(run)
        centers += len(run) - taken + _TERMS * share
    missing = max(ENOUGH - centers, 0.0)
    return max(products + missing * USUAL_LENGTH, 0.0) / (centers + missing)


def _likeness(run: Float64[Array, "n"], residual: Float64[Array, "n"]) -> tuple[float, float]:
    """Sum of the products of neighbours over that of the squares, and how many centres' products the line takes."""
    lag = np.arange(-REACH_PX, REACH_PX + 1)
    window = np.clip(2.0 - np.abs(lag) / (0.5 * REACH_PX), 0.0, 1.0)
    smooth = np.linalg.qr(np.polynomial.polynomial.polyvander(run / np.abs(run).max(), _TERMS - 1))[0]
    place = np.rint(run - run[0]).astype(np.int64)
    sums = []
    for values in (residual, *smooth.T):
        along = np.bincount(place, values)
        sums.append(float(along @ np.convolve(along, window, "same")))
    return sums[0] / max(float(residual @ residual), 1e-24), sum(sums[1:])


def _residual_px(points_px: Float64[Array, "n xy=2"]) -> tuple[Float64[Array, "n"], Float64[Array, "n"]]:
    """Places along a stripe in their order, and offsets there from the smooth line that a lens may bend it to."""
    middle = points_px - points_px.mean(axis=0)
    run, offset = (middle @ np.linalg.svd(middle, full_matrices=False)[2].T).T
    order = np.argsort(run)
    line = np.polynomial.polynomial.polyfit(run, offset, _TERMS - 1)
    residual: Float64[Array, "n"] = (offset - np.polynomial.polynomial.polyval(run, line))[order]
    return run[order], residual


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
    denominator = rays @ board_normal
    share = (rays @ normal) / denominator
    depth = float(board_normal @ pose.translation_m) / denominator
    points = depth[:, None] * rays
    by_ray = (depth[:, None] * (normal - share[:, None] * board_normal))[:, :2]
    pixel_by_ray, pixel_by_camera = pixels_wrt_ray_and_camera(rays[:, :2], camera)
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
