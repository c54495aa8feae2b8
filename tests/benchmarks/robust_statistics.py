"""Figures of many errors, some of them wild."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

from ringpose.types.arrays import Array, Float64

MAD_OF_NORMAL = 1.4826
"""Standard deviation of a normal variable over the median of its sizes about its median."""


_Errors = TypeVar("_Errors")


def joined(parts: Sequence[_Errors]) -> _Errors:
    """The errors in several images as one record: arrays end to end, counts added up."""
    values: dict[str, Any] = {}
    for name in (field.name for field in fields(parts[0])):  # type: ignore[arg-type]
        each = [getattr(part, name) for part in parts]
        values[name] = np.concatenate(each) if isinstance(each[0], np.ndarray) else sum(each)
    return type(parts[0])(**values)


def median(values: Float64[Array, "n"]) -> float:
    """NaN of nothing."""
    return float(np.median(values)) if len(values) else float("nan")


def robust_sd(values: Float64[Array, "n"]) -> float:
    """Standard deviation by the median absolute deviation; NaN of nothing."""
    return MAD_OF_NORMAL * median(np.abs(values - median(values)))


def rms(values: Float64[Array, "n"]) -> float:
    """Root mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def mean(values: Float64[Array, "n"]) -> float:
    """NaN of nothing."""
    return float(np.mean(values)) if len(values) else float("nan")
