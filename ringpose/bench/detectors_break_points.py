"""Stripe centres and break points against the truth of synthetic images: size of the errors, honesty of the sigmas."""

from dataclasses import dataclass

import numpy as np

from ringpose.bench.detectors_bounds import column_bound_px, end_bound_px
from ringpose.bench.stripe_images import StripeImage, true_row
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.detection import BreakPoints, Detection, Stripes

NEAR_PX = 2.0
"""A centre nearer to a true row than this belongs to it; it is eight sigmas of strong speckle."""

INSIDE_PX = 4.0
"""Columns left out at the ends of each piece, where the stripe fades."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CenterErrors:
    """Stripe centres on the true pieces."""

    error_px: Float64[Array, "center"]
    """Row less the true row."""
    sigma_px: Float64[Array, "center"]
    """As reported."""
    bound_px: Float64[Array, "center"]
    """Least standard deviation possible."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BreakPointErrors:
    """Break points of one or more images; those that were not found are counted only."""

    expected: int
    along_px: Float64[Array, "point"]
    """Along the stripe, positive beyond the end of the face."""
    across_px: Float64[Array, "point"]
    along_sigma_px: Float64[Array, "point"]
    """As reported."""
    across_sigma_px: Float64[Array, "point"]
    nees: Float64[Array, "point"]
    """Squared error in the reported covariance, by degree of freedom (2)."""
    bound_px: Float64[Array, "point"]
    """Least standard deviation possible along the stripe, without speckle and saturation."""
    flags: Int64[Array, "point"]


def center_errors(stripes: Stripes, image: StripeImage) -> CenterErrors:
    """Of all centres near a piece's true row, but for pieces of ridges that do no more than cross it."""
    x, y = stripes.position_px.T
    errors, sigmas, bounds = [], [], []
    for piece, (start, end) in enumerate(image.pieces_px):
        error = y - true_row(image, piece, x)
        near = (np.abs(error) < NEAR_PX) & (x > start[0] + INSIDE_PX) & (x < end[0] - INSIDE_PX)
        own = near & _mostly(near, stripes.piece)
        errors.append(error[own])
        sigmas.append(stripes.sigma_px[own])
        peak_dn = float(image.peak_dn[piece // 3])
        bounds.append(np.full(int(own.sum()), column_bound_px(peak_dn, image.stripe_sigma_px)))
    return CenterErrors(
        error_px=np.concatenate(errors), sigma_px=np.concatenate(sigmas), bound_px=np.concatenate(bounds)
    )


def break_point_errors(detection: Detection, image: StripeImage) -> BreakPointErrors:
    """Of all break points that were found."""
    found = detection.break_points
    if not isinstance(found, BreakPoints):
        return _none_of(image.break_points_px[..., 0].size)
    inner, outer = image.break_points_px[:, 0], image.break_points_px[:, 1]
    inwards = (inner - outer) / np.linalg.norm(inner - outer, axis=-1, keepdims=True)
    outwards = np.stack([inwards, -inwards], axis=1)
    sideways = np.stack([-outwards[..., 1], outwards[..., 0]], axis=-1)
    axes = np.stack([outwards, sideways], axis=-2)[found.seen]
    error = (found.position_px - image.break_points_px)[found.seen]
    covariance = axes @ found.covariance_px2[found.seen] @ np.swapaxes(axes, -1, -2)
    off = (axes @ error[..., None])[..., 0]
    laser = np.nonzero(found.seen)[0]
    bounds = np.array([end_bound_px(float(peak), image.stripe_sigma_px) for peak in image.peak_dn])
    return BreakPointErrors(
        expected=image.break_points_px[..., 0].size,
        along_px=off[:, 0],
        across_px=off[:, 1],
        along_sigma_px=np.sqrt(covariance[:, 0, 0]),
        across_sigma_px=np.sqrt(covariance[:, 1, 1]),
        nees=(off[:, None] @ np.linalg.solve(covariance, off[..., None]))[:, 0, 0] / 2,
        bound_px=bounds[laser],
        flags=found.flags[found.seen],
    )


def _mostly(near: Bool[Array, "center"], piece: Int64[Array, "center"]) -> Bool[Array, "center"]:
    """Which centres are of a piece that is near by more than half."""
    share = np.bincount(piece, near) / np.maximum(np.bincount(piece), 1)
    mostly: Bool[Array, "center"] = share[piece] > 0.5
    return mostly


def _none_of(expected: int) -> BreakPointErrors:
    nothing = np.zeros(0)
    return BreakPointErrors(
        expected=expected,
        along_px=nothing,
        across_px=nothing,
        along_sigma_px=nothing,
        across_sigma_px=nothing,
        nees=nothing,
        bound_px=nothing,
        flags=np.zeros(0, np.int64),
    )
