"""Where to look for stripes whose places are predicted: a window about each, instead of the whole frame."""

import math
from collections.abc import Sequence

import numpy as np

from ringpose.geometry.rays import project, undistorted_rays
from ringpose.types.arrays import Array, Int32
from ringpose.types.camera import Camera
from ringpose.types.detection import BreakPoints

BAND_PX = 24
"""Rows above and below a predicted stripe that are searched: 15 mm at 1 m in the time between two frames."""

BESIDE_PX = 60
"""Columns beyond a predicted stripe's ends that are searched: motion, and the ends' own surroundings."""


def predicted_bands(
    predicted: BreakPoints, lasers: Sequence[int], camera: Camera
) -> Int32[Array, "band side=4"] | None:
    """Windows about the predicted stripes of some lasers, as bands for `find_stripes`; None if none is predicted.

    Left and right column, top and bottom row; right and bottom are the first that are not searched.
    """
    starts, stops = predicted.face_start_px.tolist(), predicted.face_end_px.tolist()
    pairs = [[starts[laser], stops[laser]] for laser in lasers]
    ends = [pair for pair in pairs if math.isfinite(sum(map(sum, pair)))]
    if not ends:
        return None
    shown = project(undistorted_rays(np.array(ends), camera), camera).tolist()
    bands = []
    for (x, y), (other_x, other_y) in shown:
        left, right = _searched(x, other_x, BESIDE_PX, camera.image_width)
        top, bottom = _searched(y, other_y, BAND_PX, camera.image_height)
        bands.append((left, right, top, bottom))
    return np.array(bands, dtype=np.int32)


def _searched(one: float, other: float, beyond: int, size: int) -> tuple[int, int]:
    """The first and the one after the last of a row or a column of pixels, with some beyond both."""
    first, last = (one, other) if one < other else (other, one)
    return min(max(int(first) - beyond, 0), size), min(max(int(last) + beyond + 1, 0), size)
