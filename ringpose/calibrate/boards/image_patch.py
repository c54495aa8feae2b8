"""Square image patches, and images reduced by a whole factor.

OpenCV's chessboard detection is applied to reduced images first, because its time grows faster than the number of
pixels. Corners are then refined in the full image. Images with wide stripes are reduced before stripe extraction.
"""

import cv2
import numpy as np

from ringpose.types.arrays import Array, Float64, UInt, UInt8


def patch_around(
    image: UInt8[Array, "row column"], column: int, row: int, half: int
) -> UInt8[Array, "patch_row patch_column"] | None:
    """The patch with `half` pixels to each side of its centre; None if it exceeds the image."""
    inside = half <= row < image.shape[0] - half and half <= column < image.shape[1] - half
    return image[row - half : row + half + 1, column - half : column + half + 1] if inside else None


def grey_around(
    image: UInt8[Array, "row column"], middle: Float64[Array, "xy=2"], half: int
) -> tuple[Float64[Array, "patch_row patch_column"], Float64[Array, "patch_row patch_column xy=2"]] | None:
    """Grey values around a point, and each pixel's offset from it; None if the patch exceeds the image."""
    column, row = np.rint(middle).astype(np.int64).tolist()
    patch = patch_around(image, column, row, half)
    if patch is None:
        return None
    down, right = np.indices(patch.shape)
    return patch.astype(np.float64), np.stack([right + column - half - middle[0], down + row - half - middle[1]], -1)


LONGER_SIDE_PX = 2000
"""Images are reduced until their longer side is below one and a half times this."""

FINEST_PX = 6000
"""Longer side up to which less reduced images are tried if no board is found."""


def reductions(shape: tuple[int, ...]) -> list[int]:
    """Reduction factors to be tried in turn, the largest first."""
    longer = max(shape[:2])
    first = max(round(longer / LONGER_SIDE_PX), 1)
    halved = [first]
    while halved[-1] > 1 and longer / (halved[-1] // 2) <= FINEST_PX:
        halved.append(halved[-1] // 2)
    return halved


def reduced(image: UInt[Array, "row column"], reduction: int) -> UInt[Array, "small_row small_column"]:
    """The image with blocks of pixels averaged; incomplete blocks at the right and bottom are cut off."""
    if reduction == 1:
        return image
    rows, columns = (size // reduction for size in image.shape)
    whole = np.ascontiguousarray(image[: rows * reduction, : columns * reduction])
    small: UInt[Array, "small_row small_column"] = np.asarray(
        cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)
    )
    return small


def in_full_image(points_px: Float64[Array, "*shape xy=2"], reduction: int) -> Float64[Array, "*shape xy=2"]:
    """Points of a reduced image in the full image; pixel centres have integer coordinates in both."""
    return reduction * points_px + (reduction - 1) / 2
