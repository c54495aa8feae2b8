"""What a pinhole camera's matrix can be."""

import numpy as np

from ringpose.files.fields import Fields
from ringpose.types.arrays import Array, Float64


def checked_matrix(fields: Fields, matrix: Float64[Array, "3 3"]) -> Float64[Array, "3 3"]:
    """The camera matrix, if a pinhole camera can have it."""
    if np.any(matrix[[0, 1, 2, 2], [1, 0, 0, 1]] != 0) or matrix[2, 2] != 1:
        raise fields.problem("camera_matrix", "must have the form [fx, 0, cx, 0, fy, cy, 0, 0, 1]")
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise fields.problem("camera_matrix", "has a focal length that is not positive")
    size = np.array([fields.integer("image_width", least=1), fields.integer("image_height", least=1)])
    if np.any(np.abs(matrix[:2, 2] - size / 2) > 1.5 * size):
        center = f"({matrix[0, 2]:g}, {matrix[1, 2]:g})"
        raise fields.problem("camera_matrix", f"has its principal point at {center}, far outside the image")
    return matrix
