"""Which of a camera's parameters are estimated."""

from dataclasses import dataclass

import cv2
import numpy as np

from ringpose.calibrate.intrinsics import parameter_names
from ringpose.types.arrays import Array, Float64


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraModel:
    """Distortion model and what is held."""

    distortion_model: str = "plumb_bob"
    fix_k3: bool = False
    """Hold k3 at zero: few views, or little distortion, do not determine it."""
    zero_tangential: bool = False
    """Hold p1 and p2 at zero."""
    keep_all: bool = False
    """Leave out no view and no corner, however bad, and take all for equally exact."""

    @property
    def flags(self) -> int:
        """OpenCV's."""
        flags = cv2.CALIB_RATIONAL_MODEL if self.distortion_model == "rational_polynomial" else 0
        flags |= cv2.CALIB_FIX_K3 if self.fix_k3 else 0
        flags |= cv2.CALIB_ZERO_TANGENT_DIST if self.zero_tangential else 0
        return int(flags)

    @property
    def free(self) -> Float64[Array, "parameter"]:
        """1 for each parameter that is estimated, 0 for each that is held."""
        held = {"k3"} if self.fix_k3 else set()
        held |= {"p1", "p2"} if self.zero_tangential else set()
        return np.array([float(name not in held) for name in parameter_names(self.distortion_model)])


PLUMB_BOB = CameraModel()
"""All parameters of the usual model."""
