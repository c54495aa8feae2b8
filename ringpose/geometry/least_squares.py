"""Linear least squares near singularity, for batches of small systems."""

import numpy as np

from ringpose.types.arrays import Array, Float64


def inverse_condition(matrix: Float64[Array, "batch row column"]) -> Float64[Array, "batch"]:
    """Ratio of the smallest to the largest singular value of each matrix, after scaling its rows to unit length.

    The scaling makes the result independent of the units of the rows; a row of zeros remains zero.
    """
    length = np.linalg.norm(matrix, axis=-1, keepdims=True)
    scaled = matrix / np.where(length > 0, length, 1.0)
    singular = np.linalg.svd(scaled, compute_uv=False)
    quotient: Float64[Array, "batch"] = singular[:, -1] / np.where(singular[:, 0] > 0, singular[:, 0], 1.0)
    return quotient


def damped_solution(
    matrix: Float64[Array, "batch row column"],
    target: Float64[Array, "batch row"],
    damping: Float64[Array, "batch"],
) -> Float64[Array, "batch column"]:
    """Damped least squares (A^T A + lambda^2 I)^-1 A^T b, with lambda = damping * largest singular value of A.

    Computed from the singular value decomposition: A^T A is not formed, and zero damping gives the pseudo-inverse.
    """
    left, singular, right = np.linalg.svd(matrix, full_matrices=False)
    square = singular**2 + (damping[:, None] * singular[:, :1]) ** 2
    gain = np.divide(singular, square, out=np.zeros_like(singular), where=square > 0)
    along_axes = (target[:, None] @ left)[:, 0] * gain
    solution: Float64[Array, "batch column"] = (along_axes[:, None] @ right)[:, 0]
    return solution
