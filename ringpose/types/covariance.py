"""Joint covariance of named parameters."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringpose.types.arrays import Array, Float64

CAMERA_PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""In the order of OpenCV's Jacobian; a camera with fewer distortion coefficients has the first of them."""

PLANE_PARAMETERS = ("tilt_1", "tilt_2", "distance")
"""Parameters of each light plane."""


def camera_parameters(coefficients: int) -> tuple[str, ...]:
    """Names of a camera's parameters, for so many distortion coefficients."""
    return CAMERA_PARAMETERS[: 4 + coefficients]


def laser_parameters(names: Sequence[str]) -> tuple[str, ...]:
    """Names of the light planes' parameters, those of each laser in turn."""
    return tuple(f"{name}.{what}" for name in names for what in PLANE_PARAMETERS)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterCovariance:
    """Joint covariance of named parameters; pixels, radians, metres.

    Names: `CAMERA_PARAMETERS`, and `<laser>.tilt_1 <laser>.tilt_2 <laser>.distance` of each light plane (tilt basis:
    `ringpose.geometry.rotations.tilt_basis`).
    """

    parameters: tuple[str, ...]
    data: Float64[Array, "parameter parameter"]

    def of(self, names: Sequence[str]) -> Float64[Array, "n n"]:
        """The covariance of these parameters in their order; zero rows and columns for those that it does not have."""
        known = [name for name in names if name in self.parameters]
        here = [names.index(name) for name in known]
        there = [self.parameters.index(name) for name in known]
        covariance = np.zeros((len(names), len(names)))
        covariance[np.ix_(here, here)] = self.data[np.ix_(there, there)]
        return covariance

    @property
    def standard_deviations(self) -> dict[str, float]:
        """Standard deviations by name."""
        return dict(zip(self.parameters, np.sqrt(np.diag(self.data)).tolist(), strict=True))
