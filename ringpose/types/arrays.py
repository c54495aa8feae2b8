"""The array types of every signature, and the order of their named axes.

Axis names used throughout: `laser` in the order of the rig file and of the bits of a mask, `edge` in the
order of `EDGES`, `xy` and `xyz` of length two and three, `frame`, `row`, `column`. NaN means "not measured".
"""

import sys
from types import GenericAlias
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool as Bool
    from jaxtyping import Float32 as Float32
    from jaxtyping import Float64 as Float64
    from jaxtyping import Int16 as Int16
    from jaxtyping import Int32 as Int32
    from jaxtyping import Int64 as Int64
    from jaxtyping import UInt as UInt
    from jaxtyping import UInt8 as UInt8
    from jaxtyping import UInt16 as UInt16
else:

    class _Unchecked:
        """Replaces jaxtyping's element types unless shapes are checked: importing jaxtyping takes as long as NumPy."""

        def __class_getitem__(cls, array_and_shape: tuple[Any, str]) -> Any:
            return GenericAlias(np.ndarray, ((cls.__name__, array_and_shape[1]),))

    Bool, Float64, Int64 = (type(name, (_Unchecked,), {}) for name in ("Bool", "Float64", "Int64"))

    Float32 = Int16 = Int32 = UInt = UInt8 = UInt16 = _Unchecked

Array = np.ndarray[Any, np.dtype[Any]]
"""A NumPy array; element type and shape are added as in `Float64[Array, "laser xyz=3"]` (jaxtyping's notation)."""


def element_and_axes(annotation: Any) -> tuple[str, tuple[str, ...]] | None:
    """Element type and axes of an array's annotation: `("Float64", ("laser", "xyz=3"))`; None if it is not one."""
    if hasattr(annotation, "dim_str"):  # a type of jaxtyping
        return annotation.__name__.partition("[")[0], tuple(annotation.dim_str.split())
    if isinstance(annotation, GenericAlias) and annotation.__origin__ is np.ndarray:
        (element_and_shape,) = annotation.__args__
        return element_and_shape[0], tuple(element_and_shape[1].split())
    return None


EDGES = ("inner", "outer")
"""Order of the axis `edge`."""
