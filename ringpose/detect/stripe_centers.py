"""Centres of the laser stripes, column by column (MATH.md section 3).

Stripes run roughly along the image rows. In each column a stripe is a ridge: the second derivative of the
Gaussian-smoothed grey values has a minimum there, and the zero of the first derivative next to it is the centre.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt

from ringpose.types.arrays import Array
from ringpose.types.stripes import UNLABELLED, Stripes


@dataclass(frozen=True, slots=True, kw_only=True)
class StripeParameters:
    """What counts as a stripe."""

    filter_sigma_px: float = 2.0
    """Smoothing along the column: a little over a focused stripe's own sigma, which speckle asks for."""
    threshold_sigmas: float = 6.0
    """A ridge must stand out of the local noise of the response by this factor."""
    minimum_peak_dn: float = 3.0
    """And be this bright above its surroundings."""
    gap_columns: int = 2
    """Columns that may be missing inside a piece."""
    minimum_columns: int = 8
    """Shorter pieces are dropped: noise links over a few columns by chance."""


NOISE_BLOCK_PX = 64
"""Side of the blocks in which the noise of the response is measured; three close stripes fill less than half of one."""

QUARTILE_OF_NOISE = 0.3186
"""First quartile of the absolute value of a normal variable, in its standard deviations."""

SPECKLE_LAG = 4
"""Columns over which the speckle of two centres has become independent (grains of about 3 px)."""

STRIPE_SIGMA_PX = 1.6
"""Typical stripe, for the cubic term of the sub-pixel step alone: an error of 50 % shifts a centre by 0.003 px."""


def find_stripes(
    image: UInt[Array, "row column"],
    dark: UInt[Array, "row column"] | None = None,
    parameters: StripeParameters = StripeParameters(),
) -> Stripes:
    """Sub-pixel stripe centres, linked along x into pieces without gap or jump; their lasers are not known.

    `dark` is the same view with the lasers off; its ambient light is subtracted (and its noise added).
    """
    signal = image.astype(np.float32)
    if dark is not None:
        signal -= dark
    slope, curvature = _derivatives(signal, parameters.filter_sigma_px)
    noise = response_noise(curvature)
    peak = -curvature * _peak_per_response(parameters.filter_sigma_px)
    ridge = _ridge(curvature) & (peak > parameters.minimum_peak_dn)
    ridge &= -curvature > parameters.threshold_sigmas * noise
    rows, columns, piece = _pieces(ridge, -curvature, parameters)

    center = rows + _newton_step(slope[rows, columns], curvature[rows, columns], parameters.filter_sigma_px)
    contrast = -curvature[rows, columns] / noise[rows, columns]
    return Stripes(
        position_px=np.stack([columns.astype(np.float64), center], axis=-1),
        sigma_px=np.maximum(_sigma(contrast, parameters.filter_sigma_px), _scatter(center, piece)),
        peak_dn=peak[rows, columns].astype(np.float64),
        piece=piece,
        laser=np.full(int(piece.max()) + 1 if len(piece) else 0, UNLABELLED, dtype=np.int64),
    )


def response_noise(response: Float32[Array, "row column"]) -> Float32[Array, "row column"]:
    """Standard deviation of a filter response around each pixel, from first quartiles: no stripe fills a block."""
    rows, columns = response.shape
    side = min(NOISE_BLOCK_PX, rows, columns)
    down, across = rows // side, columns // side
    blocks = np.abs(response[: down * side, : across * side]).reshape(down, side, across, side)
    flat = np.ascontiguousarray(blocks.transpose(0, 2, 1, 3)).reshape(down, across, -1)
    quarter = flat.shape[-1] // 4
    spread = np.partition(flat, quarter, axis=-1)[..., quarter] / QUARTILE_OF_NOISE
    floor = max(float(np.median(spread)) / 4, 1e-3)  # 8-bit frames hold blocks of one value
    spread = np.maximum(spread, floor).astype(np.float32)
    return np.asarray(cv2.resize(spread, (columns, rows), interpolation=cv2.INTER_LINEAR), dtype=np.float32)


def _derivatives(
    signal: Float32[Array, "row column"], sigma_px: float
) -> tuple[Float32[Array, "row column"], Float32[Array, "row column"]]:
    """First and second derivative along the columns of the smoothed signal."""
    reach = int(np.ceil(4 * sigma_px))
    y = np.arange(-reach, reach + 1, dtype=np.float64)
    gauss = np.exp(-0.5 * (y / sigma_px) ** 2)
    gauss /= gauss.sum()
    first = -y / sigma_px**2 * gauss
    second = (y**2 / sigma_px**4 - 1 / sigma_px**2) * gauss
    second -= second.mean()  # a flat background answers with exactly nothing
    identity = np.ones(1)
    slope = cv2.sepFilter2D(signal, cv2.CV_32F, identity, first[::-1].copy(), borderType=cv2.BORDER_REPLICATE)
    curvature = cv2.sepFilter2D(signal, cv2.CV_32F, identity, second, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(slope, dtype=np.float32), np.asarray(curvature, dtype=np.float32)


def _peak_per_response(sigma_px: float) -> float:
    """Peak of a typical stripe over its response: (s^2 + w^2)^(3/2) / w for stripe sigma w and filter sigma s."""
    return float((sigma_px**2 + STRIPE_SIGMA_PX**2) ** 1.5 / STRIPE_SIGMA_PX)


def _ridge(curvature: Float32[Array, "row column"]) -> Bool[Array, "row column"]:
    """Where the response is strongest within its column's neighbourhood of one pixel."""
    ridge = np.zeros(curvature.shape, dtype=bool)
    middle = curvature[1:-1]
    ridge[1:-1] = (middle < curvature[:-2]) & (middle <= curvature[2:])
    return ridge


def _newton_step(slope: Float32[Array, "n"], curvature: Float32[Array, "n"], sigma_px: float) -> Float64[Array, "n"]:
    """Offset of the zero of the first derivative, with the cubic term of a Gaussian ridge."""
    step = -slope.astype(np.float64) / curvature
    step *= 1 - step**2 / (sigma_px**2 + STRIPE_SIGMA_PX**2)
    clipped: Float64[Array, "n"] = np.clip(step, -1.0, 1.0)
    return clipped


def _sigma(contrast: Float32[Array, "n"], sigma_px: float) -> Float64[Array, "n"]:
    """Standard deviation of a centre from the response's ratio to its noise.

    White noise n answers the first derivative with n / (2 s^(3/2) pi^(1/4)) and the second with
    n sqrt(3) / (2 sqrt(2) s^(5/2) pi^(1/4)); the step is the quotient of the first response and the second.
    """
    first_over_second = np.sqrt(2 / 3) * sigma_px
    sigma: Float64[Array, "n"] = first_over_second / contrast.astype(np.float64)
    return sigma


def _scatter(center: Float64[Array, "n"], piece: Int64[Array, "n"]) -> Float64[Array, "n"]:
    """Standard deviation of the centres of each piece about its course: speckle, which no noise of the sensor shows.

    From differences over `SPECKLE_LAG` columns, beyond which speckle is uncorrelated and a course still straight.
    """
    scatter = np.zeros(len(center))
    for part in np.split(np.arange(len(center)), np.flatnonzero(np.diff(piece)) + 1):
        if len(part) > 2 * SPECKLE_LAG:
            step = center[part[SPECKLE_LAG:]] - center[part[:-SPECKLE_LAG]]
            scatter[part] = 1.4826 * np.median(np.abs(step - np.median(step))) / np.sqrt(2)
    return scatter


def _pieces(
    ridge: Bool[Array, "row column"], strength: Float32[Array, "row column"], parameters: StripeParameters
) -> tuple[Int64[Array, "n"], Int64[Array, "n"], Int64[Array, "n"]]:
    """Rows, columns and piece numbers of the ridge pixels that link into pieces, sorted by piece, then column."""
    link = np.ones((1, 2 * parameters.gap_columns + 1), np.uint8)
    closed = cv2.morphologyEx(ridge.astype(np.uint8), cv2.MORPH_CLOSE, link)
    _, labels = cv2.connectedComponents(closed, connectivity=8, ltype=cv2.CV_32S)
    rows, columns = (index.astype(np.int64) for index in np.nonzero(ridge))
    label = np.asarray(labels)[rows, columns].astype(np.int64)

    order = np.lexsort((-strength[rows, columns], columns, label))
    rows, columns, label = rows[order], columns[order], label[order]
    first = np.ones(len(label), dtype=bool)  # the strongest of a piece in each column
    first[1:] = (label[1:] != label[:-1]) | (columns[1:] != columns[:-1])
    rows, columns, label = rows[first], columns[first], label[first]

    _, numbers, counts = np.unique(label, return_inverse=True, return_counts=True)
    kept = counts[numbers] >= parameters.minimum_columns if len(label) else np.zeros(0, dtype=bool)
    _, piece = np.unique(label[kept], return_inverse=True)
    return rows[kept], columns[kept], piece.astype(np.int64)
