"""Grey images in 8 bits, square patches of them, and images reduced by a whole factor.

OpenCV's chessboard detection is applied to reduced images first, because its time grows faster than the number of
pixels. Corners are then refined in the full image. Images with wide stripes are reduced before stripe extraction.
"""

import cv2
import numpy as np

from ringpose.types.arrays import Array, Bool, Float64, UInt, UInt8

GreyImage = UInt8[Array, "row column"]
"""A grey image in 8 bits."""

Patch = Float64[Array, "patch_row patch_column"]
"""One value for each pixel of a square patch."""

Offsets = Float64[Array, "patch_row patch_column xy=2"]
"""Position of each pixel of a patch relative to a point near the patch's centre, in pixels."""

LONGER_SIDE_PX = 2000
"""Images are reduced until their longer side is below one and a half times this."""

FINEST_PX = 6000
"""Longer side up to which less reduced images are tried if no board is found."""

MIN_BLUR_PX = 0.4
"""Standard deviation of the sharpest edges: pixels blur by 0.29 px, lenses by as much."""


def grey_8_bit(image: UInt[Array, "row column"]) -> GreyImage:
    """The image in 8 bits for OpenCV's detectors; deeper images are scaled so that their brightest pixel is white."""
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image)
    scale = 255.0 / max(int(image.max(initial=0)), 1)
    return np.rint(image * scale).astype(np.uint8)


def patch_around(image: GreyImage, column: int, row: int, half: int) -> UInt8[Array, "patch_row patch_column"] | None:
    """The patch with `half` pixels to each side of its centre; None if it exceeds the image."""
    inside = half <= row < image.shape[0] - half and half <= column < image.shape[1] - half
    return image[row - half : row + half + 1, column - half : column + half + 1] if inside else None


def grey_around(image: GreyImage, point: Float64[Array, "xy=2"], half: int) -> tuple[Patch, Offsets] | None:
    """Grey values of the patch around a point, and its pixels' offsets from it; None if the patch exceeds the image."""
    column, row = np.rint(point).astype(np.int64).tolist()
    patch = patch_around(image, column, row, half)
    if patch is None:
        return None
    down, right = np.indices(patch.shape)
    return patch.astype(np.float64), np.stack([right + column - half - point[0], down + row - half - point[1]], -1)


def brightness_plane(patch: Patch, offset: Offsets, used: Bool[Array, "patch_row patch_column"]) -> Patch:
    """Grey values of the plane fitted to the used pixels by least squares, at all pixels of the patch."""
    design = np.concatenate([np.ones((*patch.shape, 1)), offset], axis=-1)
    rows = design[used]
    return design @ np.linalg.lstsq(rows.T @ rows, rows.T @ patch[used])[0]


def reductions(shape: tuple[int, ...]) -> list[int]:
    """Factors by which an image of this shape is reduced in turn until a board is found, the largest first."""
    longer = max(shape[:2])
    factors = [max(round(longer / LONGER_SIDE_PX), 1)]
    while factors[-1] > 1 and longer / (factors[-1] // 2) <= FINEST_PX:
        factors.append(factors[-1] // 2)
    return factors


def reduced(image: UInt[Array, "row column"], reduction: int) -> UInt[Array, "small_row small_column"]:
    """The image with blocks of pixels averaged; incomplete blocks at the right and bottom are cut off."""
    if reduction == 1:
        return image
    rows, columns = (size // reduction for size in image.shape)
    whole = np.ascontiguousarray(image[: rows * reduction, : columns * reduction])
    return np.asarray(cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA), dtype=image.dtype)


def in_full_image(points_px: Float64[Array, "*shape xy=2"], reduction: int) -> Float64[Array, "*shape xy=2"]:
    """Positions in the full image of points of a reduced one; pixel centres have integer coordinates in both."""
    return reduction * points_px + (reduction - 1) / 2
