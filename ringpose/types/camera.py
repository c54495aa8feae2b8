"""The camera: pinhole model with OpenCV's distortion, under the names of ROS CameraInfo."""

from dataclasses import dataclass

from ringpose.types.arrays import Array, Float64
from ringpose.types.covariance import ParameterCovariance
from ringpose.types.options import DistortionModel

DISTORTION_COEFFICIENTS = {DistortionModel.PLUMB_BOB.value: 5, DistortionModel.RATIONAL_POLYNOMIAL.value: 8}
"""Number of coefficients of the ROS distortion models that OpenCV supports."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Camera:
    """Intrinsic parameters; pixel (0, 0) is the centre of the top-left pixel."""

    camera_name: str
    image_width: int
    image_height: int
    camera_matrix: Float64[Array, "3 3"]
    distortion_model: str
    distortion_coefficients: Float64[Array, "coefficient"]
    """OpenCV's order: k1, k2, p1, p2, k3 (plumb_bob), and k4, k5, k6 (rational_polynomial)."""
    covariance: ParameterCovariance | None = None
    """Covariance of the intrinsic parameters alone; the joint covariance of a rig is in `Rig`."""
