"""Square pieces of an image around a place.

Images made smaller, and places in them.

OpenCV's finder of chessboards looks in small images first: its time grows faster than they do. The corners are refined
in the image as it was taken, so nothing is lost but squares too small to be found. Stripes that are too broad for their
finder become as narrow as it wants them.
"""

import cv2
import numpy as np

from ringpose.types.arrays import Array, Float64, UInt, UInt8


def patch_around(
    image: UInt8[Array, "row column"], column: int, row: int, half: int
) -> UInt8[Array, "patch_row patch_column"] | None:
    """So many pixels to each side; None where that leaves the image."""
    inside = half <= row < image.shape[0] - half and half <= column < image.shape[1] - half
    return image[row - half : row + half + 1, column - half : column + half + 1] if inside else None


def grey_around(
    image: UInt8[Array, "row column"], middle: Float64[Array, "xy=2"], half: int
) -> tuple[Float64[Array, "patch_row patch_column"], Float64[Array, "patch_row patch_column xy=2"]] | None:
    """Grey values about a place, and how far each pixel lies from it; None where that leaves the image."""
    column, row = np.rint(middle).astype(np.int64).tolist()
    patch = patch_around(image, column, row, half)
    if patch is None:
        return None
    down, right = np.indices(patch.shape)
    return patch.astype(np.float64), np.stack([right + column - half - middle[0], down + row - half - middle[1]], -1)


LONGER_SIDE_PX = 2000
"""An image is made smaller by whole numbers until its longer side is below one and a half times this."""

FINEST_PX = 6000
"""If no board is found there, the image is halved less often, as long as it stays below this."""


def reductions(shape: tuple[int, ...]) -> list[int]:
    """By which whole numbers an image is made smaller, one after another."""
    longer = max(shape[:2])
    first = max(round(longer / LONGER_SIDE_PX), 1)
    halved = [first]
    while halved[-1] > 1 and longer / (halved[-1] // 2) <= FINEST_PX:
        halved.append(halved[-1] // 2)
    return halved


def reduced(image: UInt[Array, "row column"], reduction: int) -> UInt[Array, "small_row small_column"]:
    """Each pixel the mean of so many by so many; what is left over at the right and below is cut off."""
    if reduction == 1:
        return image
    rows, columns = (size // reduction for size in image.shape)
    whole = np.ascontiguousarray(image[: rows * reduction, : columns * reduction])
    small: UInt[Array, "small_row small_column"] = np.asarray(
        cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)
    )
    return small


def in_full_image(places_px: Float64[Array, "*shape xy=2"], reduction: int) -> Float64[Array, "*shape xy=2"]:
    """Places of a reduced image in the whole one; pixel centres have whole numbers in both."""
    return reduction * places_px + (reduction - 1) / 2
