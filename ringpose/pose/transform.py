"""Transformation of a pose into another frame."""

from dataclasses import replace

import numpy as np

from ringpose.geometry.ring import normal_and_center, plane_and_center
from ringpose.geometry.rotations import skew, tilt_basis
from ringpose.types.arrays import Array, Float64
from ringpose.types.pose import RingPose, RingVelocity


def pose_in_frame(pose: RingPose, frame_from_camera: Float64[Array, "4 4"]) -> RingPose:
    """The pose with its vectors, angles and covariances in the frame of a rigid transform.

    The tilt basis of the seven parameters is that of the normal in the new frame; radii are invariant.
    """
    rotation, translation = frame_from_camera[:3, :3], frame_from_camera[:3, 3]
    normal_known = bool(np.isfinite(pose.normal).all())
    jacobian = _parameters_from_camera(pose, rotation, translation) if normal_known else np.eye(7)
    return replace(
        pose,
        center_m=rotation @ pose.center_m + translation,
        normal=rotation @ pose.normal,
        grasp_m=rotation @ pose.grasp_m + translation,
        covariance=_propagated(jacobian, pose.covariance),
        covariance_center_m2=_propagated(rotation, pose.covariance_center_m2),
        covariance_grasp_m2=_propagated(rotation, pose.covariance_grasp_m2),
    )


def with_camera_error(pose: RingPose, camera_m: Float64[Array, "xyz=3"], root: Float64[Array, "6 error"]) -> RingPose:
    """A pose in the tool's or the base frame with the error of the camera's pose there added to its covariances.

    The error turns the camera by a small vector w and moves it by d, with the covariance R R^T of both (`root`): a
    point p moves by w x (p - t) + d, where t is the camera's place `camera_m`, and the normal by w x n.
    """
    if not root.any():
        return pose
    covariance, lever_m = root @ root.T, camera_m
    parameters = pose.covariance
    if parameters is not None and bool(np.isfinite(pose.normal).all()):
        known = bool(np.isfinite(pose.center_m).all())
        on_plane = pose.center_m if known else (pose.grasp_m @ pose.normal) * pose.normal
        normal_wrt = np.hstack([-skew(pose.normal), np.zeros((3, 3))])
        center_wrt = np.hstack([-skew(on_plane - lever_m), np.eye(3)])
        jacobian = np.zeros((7, 6))
        jacobian[:5] = plane_and_center(pose.normal, on_plane, normal_wrt, center_wrt, tilt_basis(pose.normal))
        parameters = parameters + jacobian @ covariance @ jacobian.T

    def at(point_m: Float64[Array, "3"]) -> Float64[Array, "3 3"]:
        if not np.isfinite(point_m).all():
            return np.zeros((3, 3))
        wrt = np.hstack([-skew(point_m - lever_m), np.eye(3)])
        moved: Float64[Array, "3 3"] = wrt @ covariance @ wrt.T
        return moved

    center_m2, grasp_m2 = pose.covariance_center_m2, pose.covariance_grasp_m2
    return replace(
        pose,
        covariance=parameters,
        covariance_center_m2=None if center_m2 is None else center_m2 + at(pose.center_m),
        covariance_grasp_m2=None if grasp_m2 is None else grasp_m2 + at(pose.grasp_m),
    )


def velocity_in_frame(velocity: RingVelocity, pose: RingPose, frame_from_camera: Float64[Array, "4 4"]) -> RingVelocity:
    """The velocity of a pose that is still in the camera frame, rotated into another frame.

    The angular velocity's components refer to the tilt basis of the normal in the new frame. Without a known normal
    they stay as they are.
    """
    rotation = frame_from_camera[:3, :3]
    jacobian = np.eye(5)
    jacobian[:3, :3] = rotation
    if bool(np.isfinite(pose.normal).all()):
        jacobian[3:, 3:] = tilt_basis(rotation @ pose.normal) @ rotation @ tilt_basis(pose.normal).T
    return RingVelocity(
        center_m_s=rotation @ velocity.center_m_s,
        rate_rad_s=rotation @ velocity.rate_rad_s,
        covariance=jacobian @ velocity.covariance @ jacobian.T,
    )


def _parameters_from_camera(
    pose: RingPose, rotation: Float64[Array, "3 3"], translation: Float64[Array, "3"]
) -> Float64[Array, "7 7"]:
    """Derivatives of the seven parameters in the new frame with respect to those in the camera frame.

    Without a known centre any point of the plane serves: tilts and offset do not depend on it.
    """
    on_plane = pose.center_m if bool(np.isfinite(pose.center_m).all()) else (pose.grasp_m @ pose.normal) * pose.normal
    normal_wrt, center_wrt = normal_and_center(pose.normal, on_plane)
    jacobian = np.eye(7)
    normal, center_m = rotation @ pose.normal, rotation @ on_plane + translation
    jacobian[:5, :5] = plane_and_center(
        normal, center_m, rotation @ normal_wrt, rotation @ center_wrt, tilt_basis(normal)
    )
    return jacobian


def _propagated(
    jacobian: Float64[Array, "n n"], covariance: Float64[Array, "n n"] | None
) -> Float64[Array, "n n"] | None:
    """J C J^T; undetermined (NaN) elements stay NaN and do not affect the others."""
    if covariance is None:
        return None
    unknown = covariance != covariance
    propagated = jacobian @ np.where(unknown, 0.0, covariance) @ jacobian.T
    return np.where(unknown, np.nan, propagated)
