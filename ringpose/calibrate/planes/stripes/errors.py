"""Stripe centres on a board: residuals from a light plane, and their standard deviation (method(7), section 6)."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from ringpose.geometry.rays import pixels_wrt_ray_and_camera, rays
from ringpose.geometry.rotations import rotation_vector, tilt_basis
from ringpose.geometry.sheets import Bends
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose
from ringpose.types.rig import Camera

MAX_LAG_PX = 16
"""Largest lag at which the correlation of neighbouring centres is summed; it is tapered beyond half of it. Speckle is
correlated over a quarter."""

MIN_LENGTH = 96
"""Minimum number of centres of a stripe for the correlation length: the polynomial fitted to a shorter one removes most
of what neighbours have in common."""

ENOUGH_CENTERS = 480.0
"""Number of centres that determines the correlation length to a quarter of its value."""

DEFAULT_LENGTH = 3.0
"""Correlation length, in centres, that counts for centres missing from that number: 1.2 to 4.1 on simulated boards."""

_TERMS = 4
"""Number of coefficients of the polynomial that models a stripe."""


class StripeRays(NamedTuple):
    """Rays (x, y, 1) of a stripe's centres by a camera, and the derivatives of its projection there."""

    ray: Float64[Array, "n xyz=3"]
    ray_wrt_pixel: Float64[Array, "n ray=2 pixel=2"]
    pixel_wrt_camera: Float64[Array, "n pixel=2 parameter"]
    """Derivatives with respect to the intrinsic parameters, the ray held constant."""


def stripe_rays(points_px: Float64[Array, "n xy=2"], camera: Camera) -> StripeRays:
    """Rays of distorted pixels, with derivatives; they do not depend on boards and light planes."""
    ray = rays(points_px, camera)
    pixel_wrt_ray, pixel_wrt_camera = pixels_wrt_ray_and_camera(ray[:, :2], camera)
    return StripeRays(ray, np.linalg.inv(pixel_wrt_ray), pixel_wrt_camera)


class StripeResiduals(NamedTuple):
    """Residuals of a stripe's centres and their derivatives, the metres per pixel held constant."""

    residual_px: Float64[Array, "n"]
    """Distance in the image from the line that the light plane draws on the board, signed as the plane's normal."""
    wrt_pose: Float64[Array, "n pose=6"]
    """Derivatives with respect to the board's rotation vector and translation."""
    wrt_plane: Float64[Array, "n parameter"]
    """Derivatives with respect to the light plane's two tilts and distance, then by `BOW_PARAMETERS` if it is bent."""
    wrt_camera: Float64[Array, "n parameter"]
    """Derivatives with respect to the intrinsic parameters, the pixels held constant."""
    metres_per_pixel: Float64[Array, "n"]
    """Distance from the light plane for one pixel across the stripe."""


def stripe_residuals(
    own: StripeRays, pose: BoardPose, normal: Float64[Array, "xyz=3"], distance_m: float, bend: Bends | None = None
) -> StripeResiduals:
    """Residuals of centres seen along rays r = (x, y, 1) on a board, from the light plane `normal . P = distance_m`.

    With the board's normal n_b and origin c_b, D = n_b . c_b and q = (n . r) / (n_b . r):

        (1) P = D r / (n_b . r)
        (2) d(n . P) = q n_b . dc_b + q (c_b - P) . dn_b + D / (n_b . r) (n - q n_b) . dr

    Of a bent sheet n is the normal of its tangent plane at P.
    """
    board_normal = pose.rotation[:, 2]
    denominator = own.ray @ board_normal
    depth = float(board_normal @ pose.translation_m) / denominator
    points = depth[:, None] * own.ray  # Eq. (1)
    height_m, tangent, cosine = np.zeros(len(points)), normal, own.ray @ normal
    if bend is not None:
        height_m, tangent = bend.height_m(points), normal - bend.gradient(points)
        cosine = (own.ray * tangent).sum(axis=1)
    q = cosine / denominator

    # The last term of Eq. (2), then by pixels: the gradient's length is the scale of the image on the light plane.
    wrt_ray = (depth[:, None] * (tangent - q[:, None] * board_normal))[:, :2]
    wrt_pixel = np.einsum("nr,nrp->np", wrt_ray, own.ray_wrt_pixel)
    metres_per_pixel = np.linalg.norm(wrt_pixel, axis=1)

    wrt_board_normal = q[:, None] * (pose.translation_m - points)
    rotation_wrt_vector = np.asarray(cv2.Rodrigues(rotation_vector(pose.rotation))[1], dtype=np.float64)
    normal_wrt_vector = rotation_wrt_vector.reshape(3, 3, 3)[:, :, 2].T  # third column of the rotation
    wrt_pose = np.hstack([wrt_board_normal @ normal_wrt_vector, q[:, None] * board_normal])
    wrt_plane = np.hstack([points @ tilt_basis(normal).T, np.full((len(points), 1), -1.0)])
    if bend is not None:
        wrt_plane = np.hstack([wrt_plane, -bend.wrt_parameters(points)])
    wrt_camera = -np.einsum("ni,nip->np", wrt_pixel, own.pixel_wrt_camera)
    return StripeResiduals(
        residual_px=(points @ normal - distance_m - height_m) / metres_per_pixel,
        wrt_pose=wrt_pose / metres_per_pixel[:, None],
        wrt_plane=wrt_plane / metres_per_pixel[:, None],
        wrt_camera=wrt_camera / metres_per_pixel[:, None],
        metres_per_pixel=metres_per_pixel,
    )


def line_modes(points_px: Float64[Array, "n xy=2"]) -> Float64[Array, "mode=2 n"]:
    """Displacements across a stripe of its centres when its line is shifted, and rotated about its centre.

    Both modes are one pixel rms, and orthogonal; the sign of the rotation is arbitrary.
    """
    centered = points_px - points_px.mean(axis=0)
    along = centered @ np.linalg.svd(centered, full_matrices=False)[2][0]
    return np.stack([np.ones(len(along)), along / np.sqrt(np.mean(along**2))])


def center_sigma_px(points_px: Float64[Array, "n xy=2"], length: float) -> float:
    """Standard deviation of a stripe centre, inflated by the correlation length (in centres) of its neighbours.

    With the inflated value, centres may be treated as independent. The polynomial takes up more degrees of freedom the
    longer neighbours are correlated; two more are subtracted for the small number of effective samples (Student's
    distribution).
    """
    degrees_of_freedom = max(len(points_px) - (_TERMS + 2) * length, 1.0)
    _, residual = _detrended_px(points_px)
    return float(np.sqrt(length * (residual @ residual) / degrees_of_freedom))


def shared_length(stripes_px: Sequence[Float64[Array, "_ xy=2"]]) -> float:
    """Correlation length of neighbouring centres, in centres, from the autocovariance of all stripes.

    It is pooled because short stripes, and those interrupted by printed squares, hardly determine their own: with a
    length for each stripe the errors were three times the estimated standard deviations. The bias by the polynomials
    is corrected.
    """
    covariance, centers = 0.0, 0.0
    for points_px in stripes_px:
        if len(points_px) < MIN_LENGTH:
            continue
        along, residual = _detrended_px(points_px)
        ratio, removed = _autocorrelation_sum(along, residual)
        covariance += ratio * len(along)
        centers += len(along) - removed + _TERMS * ratio
    missing = max(ENOUGH_CENTERS - centers, 0.0)
    return max(covariance + missing * DEFAULT_LENGTH, 0.0) / (centers + missing)


def _autocorrelation_sum(along: Float64[Array, "n"], residual: Float64[Array, "n"]) -> tuple[float, float]:
    """Tapered sum of the residuals' autocorrelation, and the number of centres that the polynomial removes from it."""
    lag = np.arange(-MAX_LAG_PX, MAX_LAG_PX + 1)
    window = np.clip(2.0 - np.abs(lag) / (0.5 * MAX_LAG_PX), 0.0, 1.0)
    basis = np.linalg.qr(np.polynomial.polynomial.polyvander(along / np.abs(along).max(), _TERMS - 1))[0]
    pixel = np.rint(along - along[0]).astype(np.int64)
    series = [np.bincount(pixel, values) for values in (residual, *basis.T)]
    squares = [float(each @ np.convolve(each, window, "same")) for each in series]
    return squares[0] / max(float(residual @ residual), 1e-24), sum(squares[1:])


def _detrended_px(points_px: Float64[Array, "n xy=2"]) -> tuple[Float64[Array, "n"], Float64[Array, "n"]]:
    """Positions along a stripe, ascending, and residuals there from a polynomial that follows the lens distortion."""
    centered = points_px - points_px.mean(axis=0)
    along, across = (centered @ np.linalg.svd(centered, full_matrices=False)[2].T).T
    order = np.argsort(along)
    coefficients = np.polynomial.polynomial.polyfit(along, across, _TERMS - 1)
    residual: Float64[Array, "n"] = (across - np.polynomial.polynomial.polyval(along, coefficients))[order]
    return along[order], residual
