"""The linear equations that one view gives for a camera, and what is left of them without its pose.

Views share no pose, so what they say of the camera is a sum over the views: with J_c and J_p the derivatives by camera
and pose, J_c^T J_c - J_c^T J_p (J_p^T J_p)^-1 J_p^T J_c of each.
"""

from typing import NamedTuple

import numpy as np

from ringpose.calibrate.board_pose import residuals
from ringpose.calibrate.corner_likeness import by_independent_errors
from ringpose.calibrate.intrinsics import projection_jacobians
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.camera import Camera


class ViewEquations(NamedTuple):
    """A view's linear equations, one row for each coordinate of a corner, of independent errors of unit variance."""

    by_pose: Float64[Array, "row pose=6"]
    by_camera: Float64[Array, "row parameter"]
    residual: Float64[Array, "row"]

    def without_pose(self) -> tuple[Float64[Array, "row parameter"], Float64[Array, "row"]]:
        """Derivatives by the camera and residuals, less what the pose can take up."""
        orthogonal, _ = np.linalg.qr(self.by_pose)
        by_camera = self.by_camera - orthogonal @ (orthogonal.T @ self.by_camera)
        return by_camera, self.residual - orthogonal @ (orthogonal.T @ self.residual)

    def pose_step(self, step: Float64[Array, "parameter"]) -> Float64[Array, "pose=6"]:
        """What the pose does when the camera's parameters take a step."""
        moved: Float64[Array, "pose=6"] = np.linalg.lstsq(self.by_pose, self.residual - self.by_camera @ step)[0]
        return moved


def view_equations(view: BoardView, pose: BoardPose, camera: Camera, sigma_px: float) -> ViewEquations:
    """Of a view whose corners have this standard deviation in each coordinate."""
    by_pose, by_camera = projection_jacobians(view.points_board_m, pose, camera)
    residual_px = residuals(view, pose, camera)[..., None]
    rows = np.concatenate([by_pose, by_camera, residual_px], axis=-1).reshape(2 * len(by_pose), -1)
    rows = by_independent_errors(rows, view) / sigma_px
    return ViewEquations(by_pose=rows[:, :6], by_camera=rows[:, 6:-1], residual=rows[:, -1])
