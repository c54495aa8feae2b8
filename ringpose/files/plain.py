"""What YAML and JSON can say: numbers, texts, lists, mappings; null where a number is not finite."""

import math
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """The value without arrays, NumPy scalars, tuples, paths; NaN and infinity become None."""
    if isinstance(value, np.ndarray | np.generic):
        return _finite(value.tolist()) if np.issubdtype(value.dtype, np.floating) else value.tolist()
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, Enum):
        return plain(value.value)
    return _finite(value) if isinstance(value, float) else str(value) if isinstance(value, Path) else value


def _finite(value: Any) -> Any:
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return value if math.isfinite(value) else None
