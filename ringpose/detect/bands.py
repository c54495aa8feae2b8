"""Where to look for stripes whose places are predicted: a window about each, instead of the whole frame."""

from collections.abc import Sequence

import numpy as np

from ringpose.geometry.rays import project, undistorted_rays
from ringpose.types.arrays import Array, Int32
from ringpose.types.break_points import BreakPoints
from ringpose.types.camera import Camera

BAND_PX = 24
"""Rows above and below a predicted stripe that are searched: 15 mm at 1 m in the time between two frames."""

BESIDE_PX = 60
"""Columns beyond a predicted stripe's ends that are searched: motion, and the ends' own surroundings."""


def predicted_bands(
    predicted: BreakPoints, lasers: Sequence[int], camera: Camera
) -> Int32[Array, "band column 2"] | None:
    """Windows about the predicted stripes of some lasers, as bands for `find_stripes`; None if none is predicted."""
    numbers = list(lasers)
    ends = np.stack([predicted.face_start_px[numbers], predicted.face_end_px[numbers]], axis=1)
    ends = ends[np.isfinite(ends).all(axis=(1, 2))]
    if not len(ends):
        return None
    shown = project(undistorted_rays(ends, camera), camera).tolist()
    bands = np.zeros((len(shown), camera.image_width, 2), dtype=np.int32)
    for band, ((x, y), (other_x, other_y)) in zip(bands, shown, strict=True):
        left, right = max(int(min(x, other_x)) - BESIDE_PX, 0), max(int(max(x, other_x)) + BESIDE_PX + 1, 0)
        top, bottom = int(min(y, other_y)) - BAND_PX, int(max(y, other_y)) + BAND_PX + 1
        band[left:right] = max(top, 0), min(bottom, camera.image_height)
    return bands
