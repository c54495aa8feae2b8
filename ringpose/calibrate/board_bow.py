"""Whether a board that is taken for flat is bowed (ringpose-method(7), section 7).

A bow is the same in every view: the views agree on a wrong camera, and nothing else tells. One of 0.1 mm over a sheet
of A4 moves the focal length by 3 to 10 of its standard deviations.
"""

from collections.abc import Sequence

import numpy as np

from ringpose.calibrate.camera_model import CameraModel
from ringpose.calibrate.camera_solution import CameraSolution
from ringpose.calibrate.corner_likeness import by_independent_errors
from ringpose.calibrate.intrinsics import projection_jacobians
from ringpose.calibrate.lens_bends import without_bends
from ringpose.calibrate.view_equations import ViewEquations, view_equations
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.camera import Camera
from ringpose.types.verdict import Finding

FLAT_SIGMAS = 5.0
"""Root of chi-squared of the bow's three numbers: of flat boards it is 1.5, hardly ever 4."""


def bow_finding(
    used: Sequence[BoardView], solution: CameraSolution, model: CameraModel, widening: float = 1.0
) -> Finding:
    """How surely the board is bowed: one step from a flat one, camera and poses free.

    Errors of views are larger than their residuals say by the factor `widening`.
    """
    several = zip(used, solution.poses, solution.view_sigma_px.tolist(), strict=True)
    rows = [_rows(without_bends(view, solution.camera), pose, solution.camera, sigma) for view, pose, sigma in several]
    by_all, residual = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    free = np.flatnonzero(np.append(model.free, np.ones(3)))
    scale = np.maximum(np.linalg.norm(by_all[:, free], axis=0), 1e-300)
    by_free = by_all[:, free] / scale
    covariance = np.linalg.pinv(by_free.T @ by_free, hermitian=True)
    bow = (covariance @ by_free.T @ residual)[-3:]
    surely = float(np.sqrt(max(bow @ np.linalg.pinv(covariance[-3:, -3:], hermitian=True) @ bow, 0.0)))
    height_m = float(np.ptp(_shapes(_places(used)) @ (bow / scale[-3:])))
    return Finding(
        name="bow_sigmas",
        value=surely / widening,
        good_limit=FLAT_SIGMAS,
        redo_limit=np.inf,
        advice=f"the board is not flat, by about {1e3 * height_m:.2f} mm: fix it to glass or a plate",
    )


def _rows(
    view: BoardView, pose: BoardPose, camera: Camera, sigma_px: float
) -> tuple[Float64[Array, "row column"], Float64[Array, "row"]]:
    """Derivatives by the camera and by the bow, and residuals, less what the pose can take up."""
    equations = view_equations(view, pose, camera, sigma_px)
    by_pose, _ = projection_jacobians(view.points_board_m, pose, camera)
    by_height = by_pose[..., 3:] @ pose.rotation[:, 2]
    by_bow = (by_height[..., None] * _shapes(view.points_board_m)[:, None]).reshape(-1, 3)
    by_bow = by_independent_errors(by_bow, view) / sigma_px
    both = np.concatenate([equations.by_camera, by_bow], axis=1)
    return ViewEquations(by_pose=equations.by_pose, by_camera=both, residual=equations.residual).without_pose()


def _shapes(points_m: Float64[Array, "corner xyz=3"]) -> Float64[Array, "corner shape=3"]:
    """Heights of surfaces of the second order; planes are the pose's."""
    x, y = points_m[:, 0], points_m[:, 1]
    return np.stack([x**2, x * y, y**2], axis=1)


def _places(used: Sequence[BoardView]) -> Float64[Array, "corner xyz=3"]:
    """All corners seen, about their middle."""
    points = np.concatenate([view.points_board_m for view in used])
    places: Float64[Array, "corner xyz=3"] = points - (points.min(axis=0) + points.max(axis=0)) / 2
    return places
