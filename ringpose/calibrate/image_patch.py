"""Square pieces of an image around a place."""

import numpy as np

from ringpose.types.arrays import Array, Float64, UInt8


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
