"""Errors of stripe centres and break points on synthetic images, their sigmas, and figures of many of them.

The least possible standard deviation of an unbiased estimate is the Cramer-Rao bound for the noise of `stripe_images`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np
from benchmarks.stripe_images import EDGE_SIGMA_PX, StripeImage, noise_variance, true_row

from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.detection import BreakPoints, Detection, Stripes

MAX_DISTANCE_PX = 2.0
"""A centre within this distance of a true row belongs to it: eight standard deviations with strong speckle."""

END_MARGIN_PX = 4.0
"""Columns left out at the ends of each piece, where the stripe fades."""

PROFILE_SIGMAS = 6
"""Half width of the pixels that the Cramer-Rao bounds take into account, in standard deviations of the stripe."""

WRONG_PX = 1.5
"""A break point with a larger error and without a flag is wrong."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CenterErrors:
    """Errors of the stripe centres on the true pieces."""

    error_px: Float64[Array, "center"]
    """Row minus the true row."""
    sigma_px: Float64[Array, "center"]
    """As reported."""
    bound_px: Float64[Array, "center"]
    """Cramer-Rao bound."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BreakPointErrors:
    """Errors of the break points of one or more images."""

    expected: int
    """Number of true break points."""
    along_px: Float64[Array, "point"]
    """Along the stripe, positive outside the rim."""
    across_px: Float64[Array, "point"]
    along_sigma_px: Float64[Array, "point"]
    """As reported."""
    across_sigma_px: Float64[Array, "point"]
    nees: Float64[Array, "point"]
    """Normalised estimation error squared, divided by the degrees of freedom (2)."""
    bound_px: Float64[Array, "point"]
    """Cramer-Rao bound along the stripe, without speckle and saturation."""
    flags: Int64[Array, "point"]


def center_errors(stripes: Stripes, image: StripeImage) -> CenterErrors:
    """Errors of all centres near the true row of a piece, without those of ridges that only cross it."""
    x, y = stripes.position_px.T
    errors, sigmas, bounds = [], [], []
    for piece, (start, end) in enumerate(image.pieces_px):
        error = y - true_row(image, piece, x)
        near = (np.abs(error) < MAX_DISTANCE_PX) & (x > start[0] + END_MARGIN_PX) & (x < end[0] - END_MARGIN_PX)
        own = near & _mostly(near, stripes.piece)
        errors.append(error[own])
        sigmas.append(stripes.sigma_px[own])
        peak_dn = float(image.peak_dn[piece // 3])
        bounds.append(np.full(int(own.sum()), column_bound_px(peak_dn, image.stripe_sigma_px)))
    return CenterErrors(
        error_px=np.concatenate(errors), sigma_px=np.concatenate(sigmas), bound_px=np.concatenate(bounds)
    )


def break_point_errors(detection: Detection, image: StripeImage) -> BreakPointErrors:
    """Errors of all break points that were found."""
    found = detection.break_points
    if not isinstance(found, BreakPoints):
        return _no_errors(image.break_points_px[..., 0].size)
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
    """Which centres belong to a detected piece of which more than half is near."""
    share = np.bincount(piece, near) / np.maximum(np.bincount(piece), 1)
    mostly: Bool[Array, "center"] = share[piece] > 0.5
    return mostly


def _no_errors(expected: int) -> BreakPointErrors:
    names = ("along_px", "across_px", "along_sigma_px", "across_sigma_px", "nees", "bound_px")
    return BreakPointErrors(expected=expected, flags=np.zeros(0, np.int64), **dict.fromkeys(names, np.zeros(0)))


def column_bound_px(peak_dn: float, sigma_px: float) -> float:
    """Cramer-Rao bound of the centre of a stripe in one column.

    Unknown height and background do not increase it, because their derivatives are even about the centre.
    """
    y = np.arange(-math.ceil(PROFILE_SIGMAS * sigma_px), math.ceil(PROFILE_SIGMAS * sigma_px) + 1)
    value = peak_dn * np.exp(-0.5 * (y / sigma_px) ** 2)
    slope = value * y / sigma_px**2
    return float(1 / np.sqrt(np.sum(slope**2 / noise_variance(value))))


def end_bound_px(peak_dn: float, sigma_px: float) -> float:
    """Cramer-Rao bound of the end of a stripe along the stripe, the height of which is known from its other columns."""
    y = np.arange(-math.ceil(PROFILE_SIGMAS * sigma_px), math.ceil(PROFILE_SIGMAS * sigma_px) + 1)
    x = np.arange(-PROFILE_SIGMAS, PROFILE_SIGMAS + 1) / EDGE_SIGMA_PX
    section = peak_dn * np.exp(-0.5 * (y[:, None] / sigma_px) ** 2)
    fade = np.array([0.5 * math.erfc(-step / math.sqrt(2)) for step in x])
    slope = section * np.exp(-0.5 * x**2) / (EDGE_SIGMA_PX * math.sqrt(2 * math.pi))
    return float(1 / np.sqrt(np.sum(slope**2 / noise_variance(section * fade))))


MAD_OF_NORMAL = 1.4826
"""Standard deviation of a normal variable over the median of its sizes about its median."""


_Errors = TypeVar("_Errors")


def joined(parts: Sequence[_Errors]) -> _Errors:
    """The errors in several images as one record: arrays end to end, counts added up."""
    values: dict[str, Any] = {}
    for name in (field.name for field in fields(parts[0])):  # type: ignore[arg-type]
        each = [getattr(part, name) for part in parts]
        values[name] = np.concatenate(each) if isinstance(each[0], np.ndarray) else sum(each)
    return type(parts[0])(**values)


def median(values: Float64[Array, "n"]) -> float:
    """NaN of nothing."""
    return float(np.median(values)) if len(values) else float("nan")


def robust_sd(values: Float64[Array, "n"]) -> float:
    """Standard deviation by the median absolute deviation; NaN of nothing."""
    return MAD_OF_NORMAL * median(np.abs(values - median(values)))


def rms(values: Float64[Array, "n"]) -> float:
    """Root mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def mean(values: Float64[Array, "n"]) -> float:
    """NaN of nothing."""
    return float(np.mean(values)) if len(values) else float("nan")
