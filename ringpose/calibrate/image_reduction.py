"""Large images made smaller, in which OpenCV's finder of chessboards looks first: its time grows faster than they do.

The corners are refined in the image as it was taken, so nothing is lost but squares too small to be found.
"""

import cv2
import numpy as np

from ringpose.types.arrays import Array, Float64, UInt8

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


def reduced(image: UInt8[Array, "row column"], reduction: int) -> UInt8[Array, "small_row small_column"]:
    """Each pixel the mean of so many by so many; what is left over at the right and below is cut off."""
    if reduction == 1:
        return image
    rows, columns = (size // reduction for size in image.shape)
    whole = image[: rows * reduction, : columns * reduction]
    return cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)


def in_full_image(places_px: Float64[Array, "*shape xy=2"], reduction: int) -> Float64[Array, "*shape xy=2"]:
    """Places of a reduced image in the whole one; pixel centres have whole numbers in both."""
    return (places_px + 0.5) * reduction - 0.5
