"""Arrays in records: nested lists of numbers, with the shape and the conditions that their definition states."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ringpose.files.schema import ROUNDED, Fields, checked_covariance
from ringpose.types.arrays import Array, Float64
from ringpose.types.detection import MAX_SIGMA_PX
from ringpose.types.record import Form, Key

Axes = dict[str, int]
"""Lengths of the named axes of the arrays of one object, as far as they have been read."""

MAX_INTEGER = 2**31

Numbers = Float64[Array, "..."]


def fixed_length(axis: str) -> int | None:
    """The length of an axis, such as 3 of `xyz=3`; None if it is not fixed."""
    number = axis.rpartition("=")[2]
    return int(number) if number.isdigit() else None


def checked_array(
    key: Key, element: str, axes: tuple[str, ...], fields: Fields, name: str, lengths: Axes, unchanged: str
) -> Array:
    """The array at a key; `lengths` of named axes must be those of the arrays before, and receives new ones."""
    if element == "Bool":
        return _truths(fields, name)
    shape = tuple(fixed_length(axis) or lengths.get(axis) for axis in axes)
    if key.null_points:
        fields = Fields(fields.file, {name: _with_nulls(fields.raw(name), len(axes) - 1)}, path=fields.path)
    array = fields.array(name, shape, allow_nan=key.gaps or key.null_points)
    for axis, length in zip(axes, array.shape, strict=True):
        if fixed_length(axis) is None and lengths.setdefault(axis, length) != length:
            given = " x ".join(map(str, array.shape))
            expected = " x ".join(str(fixed_length(each) or lengths[each]) for each in axes)
            raise fields.problem(name, f"has {given} numbers, must have {expected}")
    if key.form is not None:
        array = CHECKS[key.form](fields, name, array, key, unchanged)
    elif key.plausible is not None:
        fields.check(name, array, key.plausible)
    if key.positive and not (array > 0).all():
        raise fields.problem(name, "must be positive")
    return _whole(fields, name, array, key) if element == "Int64" else array


def _with_nulls(numbers: Any, depth: int) -> Any:
    """Nested lists of points with two nulls for a point that is null."""
    if depth == 0:
        return [None, None] if numbers is None else numbers
    return [_with_nulls(each, depth - 1) for each in numbers] if isinstance(numbers, list) else numbers


def _truths(fields: Fields, name: str) -> Array:
    values = fields.raw(name)
    if not isinstance(values, list) or not all(isinstance(each, bool) for each in values):
        raise fields.problem(name, "must be a list of true or false")
    return np.array(values, dtype=bool)


def _whole(fields: Fields, name: str, numbers: Numbers, key: Key) -> Array:
    if np.any(numbers != np.round(numbers)) or np.abs(numbers).max(initial=0.0) > MAX_INTEGER:
        raise fields.problem(name, "has a number that is not whole")
    if numbers.min(initial=0.0) < key.least:
        raise fields.problem(name, f"has a number below {key.least:g}")
    if numbers.max(initial=0.0) > key.most:
        raise fields.problem(name, f"has a number above {key.most:g}")
    return numbers.astype(np.int64)


def _unit_vector(fields: Fields, name: str, _: Numbers, key: Key, __: str) -> Numbers:
    return fields.unit_vector(name, key.remedy)


def _quaternion(fields: Fields, name: str, *_: object) -> Numbers:
    return fields.quaternion(name)


def _bounded_length(fields: Fields, name: str, _: Numbers, key: Key, __: str) -> Numbers:
    assert key.plausible is not None
    return fields.sized(name, key.plausible)


def _direction(fields: Fields, name: str, vector: Numbers, *_: object) -> Numbers:
    if not vector.any():
        raise fields.problem(name, "has length 0")
    return vector


def _directions(fields: Fields, name: str, vectors: Numbers, *_: object) -> Numbers:
    if not vectors.any(axis=1).all():
        raise fields.problem(name, "has a vector of length 0, must be 1")
    return vectors


def _orthonormal(fields: Fields, name: str, axes: Numbers, *_: object) -> Numbers:
    if np.abs(axes @ axes.T - np.eye(len(axes))).max() > ROUNDED:
        raise fields.problem(name, "must be three perpendicular unit vectors")
    return axes


def _covariance(fields: Fields, name: str, matrix: Numbers, key: Key, unchanged: str) -> Numbers:
    undetermined = np.isnan(np.diagonal(matrix))
    if (np.isnan(matrix) != (undetermined[:, None] | undetermined)).any():
        raise fields.problem(name, "has a null among numbers", unchanged)
    determined = np.ix_(~undetermined, ~undetermined)
    matrix[determined] = checked_covariance(fields, name, matrix[determined])
    return matrix


def _covariances(fields: Fields, name: str, matrices: Numbers, *_: object) -> Numbers:
    """Symmetric, positive semidefinite 2 x 2 matrices, up to rounding."""
    (first, mixed), (other, second) = np.moveaxis(matrices, (-2, -1), (0, 1))
    size = np.abs(first) + np.abs(second)
    uneven = np.abs(mixed - other) > ROUNDED * size
    if np.any(uneven | (np.minimum(first, second) < 0) | (mixed**2 > first * second + (ROUNDED * size) ** 2)):
        raise fields.problem(name, "has a matrix that is not a covariance")
    _sigmas(fields, name, np.sqrt(np.maximum(np.stack([first, second]), 0.0)))
    return matrices


def _sigmas(fields: Fields, name: str, sigmas: Numbers, *_: object) -> Numbers:
    if np.any(sigmas < 0):
        raise fields.problem(name, "has a standard deviation below 0")
    if np.any(sigmas > MAX_SIGMA_PX):
        raise fields.problem(name, f"has a standard deviation over {MAX_SIGMA_PX:g} px", "write null if it is unknown")
    return sigmas


def _upper_trapezoidal(fields: Fields, name: str, rows: Numbers, key: Key, unchanged: str) -> Numbers:
    if np.tril(rows, -1).any():
        raise fields.problem(name, "has a number below its diagonal, must be upper-trapezoidal", unchanged)
    return rows


def _points(fields: Fields, name: str, points: Numbers, *_: object) -> Numbers:
    missing = np.isnan(points)
    if np.any(missing.any(axis=-1) != missing.all(axis=-1)):
        raise fields.problem(name, "has a point of which one coordinate is null")
    return points


CHECKS: Mapping[Form, Callable[[Fields, str, Numbers, Key, str], Numbers]] = {
    Form.UNIT_VECTOR: _unit_vector,
    Form.QUATERNION: _quaternion,
    Form.BOUNDED_LENGTH: _bounded_length,
    Form.DIRECTION: _direction,
    Form.DIRECTIONS: _directions,
    Form.ORTHONORMAL: _orthonormal,
    Form.COVARIANCE: _covariance,
    Form.COVARIANCES: _covariances,
    Form.SIGMAS: _sigmas,
    Form.UPPER_TRAPEZOIDAL: _upper_trapezoidal,
    Form.POINTS: _points,
}
