"""How robots state a pose: unit of length, form of the rotation, order and unit of its angles.

Orders of angles are written as in scipy: capital letters are turns about the axes as they have been turned so far,
small letters about the fixed axes, both in the order of the turns. `ZYX` is R = Rz(1st) Ry(2nd) Rx(3rd), `xyz` is
R = Rz(3rd) Ry(2nd) Rx(1st).
"""

from dataclasses import dataclass
from itertools import permutations
from math import pi
from typing import Literal

import numpy as np

from ringpose.errors import UsageError
from ringpose.geometry.ring import rotation_by
from ringpose.geometry.rotations import rotation_of
from ringpose.types.arrays import Array, Float64

RotationForm = Literal["quaternion", "angles", "rotation_vector", "matrix"]

DEGREE = pi / 180


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseConvention:
    """The numbers that state a pose: first x, y, z, then the rotation; a matrix contains both."""

    length_m: float
    """Unit of the position in metres."""
    rotation: RotationForm
    order: str = ""
    """Order of a quaternion (`xyzw`, `wxyz`) or of angles (`ZYX`); `columns` of a matrix that is given by columns."""
    angle_rad: float = 1.0
    """Unit of angles or of a rotation vector in radians."""
    columns: tuple[str, ...] = ()
    """Names of the numbers of the rotation, as the robot's maker writes them, in small letters."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all the numbers; of a matrix row by row."""
        if self.rotation == "matrix":
            return tuple(f"m{row}{column}" for row in range(1, 5) for column in range(1, 5))
        usual = {"quaternion": tuple(f"q{axis}" for axis in self.order), "angles": ("a1", "a2", "a3")}
        return ("x", "y", "z", *(self.columns or usual.get(self.rotation, ("rx", "ry", "rz"))))

    @property
    def text(self) -> str:
        """The convention in words for `convention_named`, as `mm,ZYX,deg`."""
        form = {"rotation_vector": "rotation_vector", "matrix": f"matrix{'_by_columns' if self.order else ''}"}
        words = ["m" if self.length_m == 1.0 else "mm", form.get(self.rotation, self.order)]
        if self.rotation in ("angles", "rotation_vector"):
            words.append("rad" if self.angle_rad == 1.0 else "deg")
        return ",".join(words)

    def rotation_of(self, numbers: Float64[Array, "n"]) -> Float64[Array, "3 3"]:
        """The rotation from tool to base that these numbers state; a quaternion may have any length."""
        if self.rotation == "quaternion":
            return rotation_of(numbers if self.order == "xyzw" else np.roll(numbers, -1))
        if self.rotation == "rotation_vector":
            return rotation_by(self.angle_rad * numbers)
        if self.rotation == "angles":
            return _product(self.order, self.angle_rad * numbers)
        raise ValueError(self.rotation)


def _product(order: str, angles_rad: Float64[Array, "3"]) -> Float64[Array, "3 3"]:
    """Product of turns about axes; turns about fixed axes are those about turned axes in the other order."""
    axes = [np.eye(3)["xyz".index(axis)] for axis in order.lower()]
    turns = [rotation_by(angle * axis) for angle, axis in zip(angles_rad, axes, strict=True)]
    first, second, third = turns if order.isupper() else turns[::-1]
    product: Float64[Array, "3 3"] = first @ second @ third
    return product


def _angles(order: str, *columns: str) -> PoseConvention:
    """Millimetres and degrees, as most controllers have them."""
    return PoseConvention(length_m=1e-3, rotation="angles", order=order, angle_rad=DEGREE, columns=columns)


_XYZW = PoseConvention(length_m=1.0, rotation="quaternion", order="xyzw", columns=("qx", "qy", "qz", "qw"))

CONVENTIONS = {
    "abb": PoseConvention(length_m=1e-3, rotation="quaternion", order="wxyz", columns=("q1", "q2", "q3", "q4")),
    "denso": _angles("xyz", "rx", "ry", "rz"),
    "doosan": _angles("ZYZ", "a", "b", "c"),
    "fanuc": _angles("xyz", "w", "p", "r"),
    "franka": PoseConvention(length_m=1.0, rotation="matrix", order="columns"),
    "kawasaki": _angles("ZYZ", "o", "a", "t"),
    "kuka": _angles("ZYX", "a", "b", "c"),
    "mecademic": _angles("XYZ", "alpha", "beta", "gamma"),
    "mitsubishi": _angles("xyz", "a", "b", "c"),
    "nachi": _angles("ZYX", "roll", "pitch", "yaw"),
    "ros": _XYZW,
    "staubli": _angles("XYZ", "rx", "ry", "rz"),
    "techman": _angles("xyz", "rx", "ry", "rz"),
    "tum": _XYZW,
    "ur": PoseConvention(length_m=1.0, rotation="rotation_vector", columns=("rx", "ry", "rz")),
    "yaskawa": _angles("xyz", "rx", "ry", "rz"),
}
"""By the names of makers and formats; ringpose-robot(7) has the matrix and an example of each.

Sources. Orders of angles of denso, doosan, fanuc, kawasaki, kuka, mitsubishi, nachi, staubli, techman and yaskawa: the
table "Euler angles: definition and convention" in the manual of Mech-Mind's software, docs.mech-mind.net, where sxyz is
`xyz` and rzyx is `ZYX`; yaskawa also in Motoman's DX100 manual, 4.3.1.1, and Basler's rc_cube, "Yaskawa pose format".
mecademic: "Space orientation and Euler angles" on mecademic.com and the Meca500's programming manual (mobile XYZ).
franka: libfranka, robot_state.h, `O_T_EE` ("4x4 matrix in column-major format"). abb: RAPID, data type `orient`.
ur: URScript, "pose". ros: geometry_msgs/Quaternion. tum: the file formats of TUM's RGB-D benchmark.
"""

_PAIRS = [a + b + a for a, b in permutations("XYZ", 2)]
ANGLE_ORDERS = tuple(word for upper in (*map("".join, permutations("XYZ")), *_PAIRS) for word in (upper, upper.lower()))
"""The 24 orders of three angles."""

_FORMS: dict[str, tuple[RotationForm, str]] = {
    "xyzw": ("quaternion", "xyzw"),
    "wxyz": ("quaternion", "wxyz"),
    "rotation_vector": ("rotation_vector", ""),
    "matrix": ("matrix", ""),
    "matrix_by_columns": ("matrix", "columns"),
    **{order: ("angles", order) for order in ANGLE_ORDERS},
}


def convention_named(text: str, option: str = "--robot-convention") -> PoseConvention:
    """The convention of this name, or in words: unit of length, form of the rotation, unit of angles."""
    if text.lower() in CONVENTIONS:
        return CONVENTIONS[text.lower()]
    words = [word.strip() for word in text.split(",")]
    lengths = [word for word in words if word in ("m", "mm")]
    units = [word for word in words if word in ("deg", "rad")]
    forms = [word for word in words if word in _FORMS]
    if len(words) == 1 and not (lengths or units or forms):
        finding = f"is {text!r}, must be one of {', '.join(CONVENTIONS)}, or words as mm,ZYX,deg"
        raise UsageError(option, finding, "see ringpose-robot(7)")
    if len(lengths) != 1 or len(forms) != 1 or len(words) != len(lengths) + len(units) + len(forms):
        finding = f"is {text!r}, must have m or mm, and xyzw, wxyz, rotation_vector, matrix, or an order as ZYX or xyz"
        raise UsageError(option, finding, "as mm,ZYX,deg or m,xyzw; see ringpose-robot(7)")
    rotation, order = _FORMS[forms[0]]
    if len(units) != (rotation in ("angles", "rotation_vector")):
        finding = f"is {text!r}: angles need deg or rad, quaternions and matrices have no such unit"
        raise UsageError(option, finding, "as mm,ZYX,deg or m,xyzw")
    length_m, angle_rad = 1.0 if lengths[0] == "m" else 1e-3, DEGREE if units == ["deg"] else 1.0
    return PoseConvention(length_m=length_m, rotation=rotation, order=order, angle_rad=angle_rad)
