"""Segments of stripes on a plane that faces the camera, as the kernel that follows stripes gives them."""

import numpy as np

from ringpose.kernels.lines import (
    CENTERS,
    CORRELATION,
    LASER,
    MIDDLE_X,
    MIDDLE_Y,
    SCATTER,
    SEGMENT_COLUMNS,
    X_END,
    X_START,
)
from ringpose.types.rig import Rig


def height_m(rig: Rig, laser: int, z_m: float) -> float:
    """The place y of a laser's stripe on the plane at a depth; its light plane has no slope along x."""
    normal, distance_m = rig.lasers.normal[laser], rig.lasers.distance_m[laser]
    return (distance_m - normal[2] * z_m) / normal[1]


def segment_on_plane(rig: Rig, laser: int, ends_m, z_m: float = 0.5) -> np.ndarray:
    """A laser's stripe between two places x on the plane at a depth, as one segment."""
    (focal_x, _, center_x), (_, focal_y, center_y), _ = rig.camera.camera_matrix
    x, row = center_x + focal_x * np.array(ends_m) / z_m, np.zeros(len(SEGMENT_COLUMNS))
    row[[LASER, CENTERS, X_START, X_END, MIDDLE_X]] = laser, x[1] - x[0], *x, x.mean()
    row[[MIDDLE_Y, SCATTER, CORRELATION]] = center_y + focal_y * height_m(rig, laser, z_m) / z_m, 0.1, 2.0
    return row
