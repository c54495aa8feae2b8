"""What a pinhole camera's matrix can be."""

import numpy as np

from ringpose.files.fields import Fields
from ringpose.types.arrays import Array, Float64

MOST_PIXELS = 100_000
"""Columns or rows that no camera has."""

SHORTEST_FOCAL_LENGTH = 0.05
"""Of the image's width: a lens that sees 169 degrees, which no pinhole camera does."""


def checked_matrix(fields: Fields, matrix: Float64[Array, "3 3"]) -> Float64[Array, "3 3"]:
    """The camera matrix, if a pinhole camera can have it."""
    if np.any(matrix[[0, 1, 2, 2], [1, 0, 0, 1]] != 0) or matrix[2, 2] != 1:
        raise fields.problem("camera_matrix", "must have the form [fx, 0, cx, 0, fy, cy, 0, 0, 1]")
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise fields.problem("camera_matrix", "has a focal length that is not positive")
    size = np.array([fields.integer(key, least=1, most=MOST_PIXELS) for key in ("image_width", "image_height")])
    if np.any(np.diag(matrix)[:2] < SHORTEST_FOCAL_LENGTH * size):
        shortest = min(matrix[0, 0], matrix[1, 1])
        raise fields.problem(
            "camera_matrix", f"has a focal length of {shortest:g} pixels", "pixels belong here, not mm"
        )
    if np.any(np.abs(matrix[:2, 2] - size / 2) > 1.5 * size):
        center = f"({matrix[0, 2]:g}, {matrix[1, 2]:g})"
        raise fields.problem("camera_matrix", f"has its principal point at {center}, far outside the image")
    return matrix
