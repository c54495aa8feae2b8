"""The array type of every signature, and the order of its named axes.

Axis names used throughout: `laser` in the order of the rig file and of the bits of a mask, `edge` in the
order of `EDGES`, `xy` and `xyz` of two and three, `frame`, `row`, `column`. NaN stands for "not seen".
"""

from typing import Any

import numpy as np

Array = np.ndarray[Any, np.dtype[Any]]
"""A NumPy array; jaxtyping adds element type and shape, as in `Float64[Array, "laser xyz=3"]`."""

EDGES = ("inner", "outer")
"""Order of the axis `edge`."""
