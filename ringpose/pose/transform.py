"""A pose in another frame than the camera's."""

from dataclasses import replace

import numpy as np

from ringpose.geometry.rotations import tilt_basis
from ringpose.types.arrays import Array, Float64
from ringpose.types.pose import RingPose


def pose_in_frame(pose: RingPose, frame_from_camera: Float64[Array, "4 4"]) -> RingPose:
    """The pose with its vectors, angles and covariances in the frame of a rigid transform.

    The tilt basis of the seven parameters is that of the normal in the new frame; radii stay as they are.
    """
    rotation, translation = frame_from_camera[:3, :3], frame_from_camera[:3, 3]
    known = bool(np.isfinite(pose.normal).all())
    jacobian = _parameters_from_camera(pose.normal, rotation, translation) if known else np.eye(7)
    return replace(
        pose,
        center_m=rotation @ pose.center_m + translation,
        normal=rotation @ pose.normal,
        grasp_m=rotation @ pose.grasp_m + translation,
        covariance=_carried(jacobian, pose.covariance),
        covariance_center_m2=_carried(rotation, pose.covariance_center_m2),
        covariance_grasp_m2=_carried(rotation, pose.covariance_grasp_m2),
    )


def _parameters_from_camera(
    normal: Float64[Array, "3"], rotation: Float64[Array, "3 3"], translation: Float64[Array, "3"]
) -> Float64[Array, "7 7"]:
    """Derivative of the seven parameters in the new frame by those in the camera frame.

    The plane's offset is n' . P' = n . P + n' . translation, which changes with the tilts too.
    """
    basis = tilt_basis(rotation @ normal)
    turn = basis @ rotation @ tilt_basis(normal).T
    jacobian = np.eye(7)
    jacobian[:2, :2] = turn
    jacobian[2, :2] = (basis @ translation) @ turn
    jacobian[3:5, 3:5] = turn
    return jacobian


def _carried(jacobian: Float64[Array, "n n"], covariance: Float64[Array, "n n"] | None) -> Float64[Array, "n n"] | None:
    """What is unknown stays so, and spoils nothing else: what is known in one frame is in the other."""
    if covariance is None:
        return None
    unknown = covariance != covariance
    carried = jacobian @ np.where(unknown, 0.0, covariance) @ jacobian.T
    return np.where(unknown, np.nan, carried)
