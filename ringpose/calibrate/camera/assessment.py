"""Assessment of a camera calibration: coverage, uncertainty, consistency of the views, flatness of the board.

A bent board (ringpose-method(7), section 7) has the same shape in every view, so that the views agree on a wrong camera
and no other check detects it. A bow of 0.1 mm over a sheet of A4 changes the focal length by 3 to 10 of its standard
deviations. Systematic errors that the views show enlarge the covariance in their own direction: the change of the
camera by the bow, and half of the difference between the cameras of two halves of the views.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ringpose.calibrate.acceptance import BOARD_LIMITS, check, marker_size_findings
from ringpose.calibrate.boards.corner_errors import view_equations, whiten, without_distortion_bias
from ringpose.calibrate.boards.pose import projection
from ringpose.calibrate.camera import validation
from ringpose.calibrate.camera.bundle_adjustment import CameraSolution, camera_solution
from ringpose.calibrate.camera.outliers import other_camera_finding
from ringpose.calibrate.camera.parameters import CameraModel, parameters_of
from ringpose.geometry.least_squares import Eliminated
from ringpose.geometry.rotations import angle_between, rotation_vector
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.calibration import CameraAssessment, CameraCalibration, Check, Coverage, Grade
from ringpose.types.rig import Camera

CHANCE = 2.5
"""Disagreement of the views, 1 if noise explains it, is significant above 1 + CHANCE / sqrt(views - 1): of 80 sets of 8
and 15 views with only noise, one exceeded it."""

EXACT_PX = 1e-4
"""Lower limit of the projection uncertainty: corners have single precision."""

DISTANCES_M = (0.2, 0.5, 1.0)
"""Default distances for the projection uncertainty in metres."""


CELL_COLUMNS = 8
"""Cells across the image; the number of rows makes them nearly square."""

BARE_SHARE = 1 / 3
"""A ninth of the image is bare if at most this share of its cells contains corners: a strip along one side."""

SAME_RAD = np.radians(2.0)
"""Poses count as one view if they differ by less than this rotation and by less than SAME_SHARE of their distance."""

SAME_SHARE = 0.02
"""Translation over distance up to which poses count as one view."""

_REGIONS = (("upper left", "top", "upper right"), ("left", "middle", "right"), ("lower left", "bottom", "lower right"))


def camera_assessment(
    calibration: CameraCalibration,
    model: CameraModel,
    distances_m: Sequence[float] = DISTANCES_M,
    compare: bool = False,
) -> CameraAssessment:
    """Coverage, uncertainty over the image, cross-validation, and with `compare` the other distortion model's fit.

    The covariance is inflated if the views disagree more than noise explains. A board that is bent, moves or reflects
    causes errors that the corners of a view have in common. Residuals do not show them, and the covariance treats the
    corners as independent. Views are independent.
    """
    used = validation.used_views(calibration)
    whole = camera_solution(used, calibration.camera, model)
    left_out, jackknife_px = validation.leave_one_out(used, whole, model)
    corners_px = np.concatenate([view.points_px[~view.left_out] for view in calibration.used])
    known, covariance = validation.known_lens(calibration.camera, corners_px), calibration.covariance
    sigma_px = np.where(known, validation.projection_sigma_px(calibration.camera, covariance.data), np.nan)
    disagreement = float(np.median(jackknife_px[known]) / max(np.median(sigma_px[known]), EXACT_PX))
    widening = disagreement if disagreement > 1 + CHANCE / np.sqrt(len(used) - 1) else 1.0
    halves = validation.split_halves(used, whole, model)
    half = np.zeros(len(model.free)) if halves is None else (parameters_of(halves[0]) - parameters_of(halves[1])) / 2
    bow = bow_error(used, whole, model, widening)
    of_bow = np.outer(bow.shift, bow.shift) * (bow.finding.grade is not Grade.GOOD)
    data = widening**2 * covariance.data + of_bow
    if widening > 1:
        data = data + np.outer(half, half)
    wider = replace(calibration.camera, covariance=replace(covariance, data=data))
    return CameraAssessment(
        calibration=replace(calibration, camera=wider),
        coverage=coverage(calibration),
        sigma_px=np.where(known, validation.projection_sigma_px(wider, data), np.nan),
        left_out=left_out,
        split_half_px=np.full(known.shape, np.nan) if halves is None else validation.displacement_px(*halves),
        half_difference=half,
        disagreement=disagreement,
        distances_m=tuple(distances_m),
        comparison=validation.model_comparison(used, whole, model) if compare else None,
        board=(
            other_camera_finding(calibration),
            *marker_size_findings([view.board for view in calibration.views]),
            bow.finding,
        ),
        bow_sigma_px=float(np.median(validation.projection_sigma_px(calibration.camera, of_bow)[known])),
    )


class BowError(NamedTuple):
    """The error by a bow of the board that is the same in all views."""

    finding: Check
    shift: Float64[Array, "parameter"]
    """The change of the camera's parameters that the bow causes."""


def bow_error(
    used: Sequence[BoardView], solution: CameraSolution, model: CameraModel, widening: float = 1.0
) -> BowError:
    """Error by the board's bow: by how many standard deviations the corners show one, the same in all views.

    The bow is a surface of second order, with three coefficients, estimated by one Gauss-Newton step together with
    camera and poses. `widening` is the factor by which the views' errors exceed what their residuals show.
    """
    several = zip(used, solution.poses, solution.view_sigma_px.tolist(), strict=True)
    rows = [
        _bow_equations(without_distortion_bias(view, solution.camera), pose, solution.camera, sigma)
        for view, pose, sigma in several
    ]
    jacobian = np.concatenate([one.wrt_shared for one in rows])
    residual = np.concatenate([one.residual for one in rows])
    free = np.flatnonzero(np.append(model.free, np.ones(3, dtype=bool)))
    scale = np.maximum(np.linalg.norm(jacobian[:, free], axis=0), 1e-300)
    scaled = jacobian[:, free] / scale
    covariance = np.linalg.pinv(scaled.T @ scaled, hermitian=True)
    step = covariance @ scaled.T @ residual
    bow = step[-3:]
    significance = float(np.sqrt(max(bow @ np.linalg.pinv(covariance[-3:, -3:], hermitian=True) @ bow, 0.0)))
    points_m = np.concatenate([view.points_board_m for view in used])
    centered_m = points_m - (points_m.min(axis=0) + points_m.max(axis=0)) / 2
    height_m = float(np.ptp(_surface_heights(centered_m) @ (bow / scale[-3:])))
    shift = np.zeros(len(model.free))
    shift[model.free] = (step / scale)[:-3]
    words = {"height_mm": 1e3 * height_m, "fx_px": abs(shift[0])}
    return BowError(check(BOARD_LIMITS, "bow_sigmas", significance / widening, **words), shift)


def _bow_equations(view: BoardView, pose: BoardPose, camera: Camera, sigma_px: float) -> Eliminated:
    """Whitened equations of camera and bow, with the pose eliminated."""
    equations = view_equations(view, pose, camera, sigma_px)
    _, wrt_pose, _ = projection(view.points_board_m, pose, camera)
    wrt_height = wrt_pose[..., 3:] @ pose.rotation[:, 2]
    wrt_bow = (wrt_height[..., None] * _surface_heights(view.points_board_m)[:, None]).reshape(-1, 3)
    both = np.hstack([equations.wrt_camera, whiten(wrt_bow, view) / sigma_px])
    return equations._replace(wrt_camera=both).without_pose()


def _surface_heights(points_m: Float64[Array, "corner xyz=3"]) -> Float64[Array, "corner shape=3"]:
    """Heights of the second-order surfaces x^2, x y and y^2; a plane would be equivalent to a change of pose."""
    x, y = points_m[:, 0], points_m[:, 1]
    return np.stack([x**2, x * y, y**2], axis=1)


def coverage(calibration: CameraCalibration) -> Coverage:
    """Used corners by cell of the image, tilts and distances of the used boards."""
    camera, used = calibration.camera, calibration.used
    points_px = np.concatenate([view.points_px[~view.left_out] for view in used])
    middles = [view.pose.rotation @ view.board.points_board_m.mean(axis=0) + view.pose.translation_m for view in used]
    normals = np.array([view.pose.rotation[:2, 2] for view in used])
    variance = np.linalg.eigvalsh(np.cov(normals.T)) if len(used) > 1 else np.zeros(2)
    across, along = np.sqrt(np.maximum(variance, 0.0)).tolist()  # ascending
    rows = max(round(CELL_COLUMNS * camera.image_height / camera.image_width), 1)
    # Each ninth of the image is divided into nine cells again: the share of these that contain corners.
    seen = (_counts(points_px, camera, 9, 9) > 0).reshape(3, 3, 3, 3).mean(axis=(1, 3))
    bare = zip(*np.nonzero(seen <= BARE_SHARE), strict=True)
    return Coverage(
        corners=_counts(points_px, camera, rows, CELL_COLUMNS),
        bare_regions=tuple(_REGIONS[row][column] for row, column in bare),
        tilt_rad=tuple(board_tilt_rad(view.pose) for view in used),
        tilt_spread_rad=(along, across),
        distance_m=tuple(float(np.linalg.norm(middle)) for middle in middles),
    )


def _counts(
    points_px: Float64[Array, "n xy=2"], camera: Camera, rows: int, columns: int
) -> Int64[Array, "cell_row cell_column"]:
    """Number of points in each cell of the image, which is divided into these numbers of rows and columns."""
    edges = [(-0.5, camera.image_height - 0.5), (-0.5, camera.image_width - 0.5)]
    counts, _, _ = np.histogram2d(points_px[:, 1], points_px[:, 0], bins=(rows, columns), range=edges)
    return counts.astype(np.int64)


def board_tilt_rad(pose: BoardPose) -> float:
    """Angle between board and image plane; at zero, perspective does not determine the focal length."""
    return float(angle_between(pose.rotation[:, 2], np.array([0.0, 0.0, 1.0])))


def different_poses(poses: Sequence[BoardPose]) -> int:
    """Number of distinct poses: repeated views of a board at rest add no information about the camera."""

    def same(pose: BoardPose, other: BoardPose) -> bool:
        angle_rad = np.linalg.norm(rotation_vector(pose.rotation.T @ other.rotation))
        shift_m = np.linalg.norm(pose.translation_m - other.translation_m)
        return bool(angle_rad < SAME_RAD and shift_m < SAME_SHARE * np.linalg.norm(pose.translation_m))

    different: list[BoardPose] = []
    for pose in poses:
        if not any(same(pose, other) for other in different):
            different.append(pose)
    return len(different)
