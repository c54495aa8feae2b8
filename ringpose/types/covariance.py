"""Joint covariance of named parameters."""

from dataclasses import dataclass

import numpy as np

from ringpose.types.arrays import Array, Float64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterCovariance:
    """Joint covariance of named parameters; pixels, radians, metres.

    Names: `fx fy cx cy k1 k2 p1 p2 k3 ...` of the camera, `<laser>.tilt_1 <laser>.tilt_2 <laser>.distance`
    of each light plane (tilt basis: `ringpose.geometry.rotations.tilt_basis`).
    """

    parameters: tuple[str, ...]
    data: Float64[Array, "parameter parameter"]

    @property
    def standard_deviations(self) -> dict[str, float]:
        """By name."""
        return dict(zip(self.parameters, np.sqrt(np.diag(self.data)).tolist(), strict=True))
