"""Whether the views disagree about the light planes by more than their corners and stripes explain."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from ringpose.calibrate.board_pose import moved_pose, pose_covariance, residuals
from ringpose.calibrate.plane_points import on_board
from ringpose.calibrate.stripe_errors import line_variance_px2, stripe_bend
from ringpose.geometry.rays import rays
from ringpose.types.arrays import Array
from ringpose.types.board import BoardPose
from ringpose.types.calibration import LaserCalibration, StripeView
from ringpose.types.camera import Camera

SIGNIFICANCE = 3.0
"""Standard deviations by which the sum of squares must exceed its mean (chi-squared) to be more than chance."""

_POSE_STEP = 1e-5
_LINE_STEP_PX = 0.01


def corner_sigma_px(views: Sequence[StripeView], poses: Sequence[BoardPose], camera: Camera) -> float:
    """Standard deviation of one coordinate of a corner, from the residuals of all views."""
    errors = [residuals(view.board, pose, camera) for view, pose in zip(views, poses, strict=True)]
    squares = sum(float(np.sum(error**2)) for error in errors)
    return float(np.sqrt(squares / max(sum(error.size - 6 for error in errors), 1)))


def view_excess(
    views: Sequence[StripeView],
    poses: Sequence[BoardPose],
    camera: Camera,
    lasers: Sequence[LaserCalibration],
    sigma_px: float,
) -> float:
    """Mean square of each stripe's offset and turn from its light plane, in units of the variance expected of them.

    One where chance explains it; above one if the board is bent or its sizes are not exact.
    """
    squares, numbers = 0.0, -3 * len(lasers)
    for view, pose in zip(views, poses, strict=True):
        of_pose = pose_covariance(view.board, pose, camera, sigma_px)
        for laser, points_px in zip(lasers, view.stripes_px, strict=True):
            if len(points_px):
                squares += _normalised_square(points_px, pose, camera, laser, of_pose)
                numbers += 2
    if numbers <= 0 or squares < numbers + SIGNIFICANCE * np.sqrt(2 * numbers):
        return 1.0
    return squares / numbers


def _normalised_square(
    points_px: Float64[Array, "n xy=2"],
    pose: BoardPose,
    camera: Camera,
    laser: LaserCalibration,
    of_pose: Float64[Array, "pose=6 pose=6"],
) -> float:
    """Squared Mahalanobis length of one stripe's offset and turn."""
    seen = rays(points_px, camera)
    by_pose = np.stack(
        [
            _offset_and_turn(on_board(seen, moved_pose(pose, step)), laser)
            - _offset_and_turn(on_board(seen, moved_pose(pose, -step)), laser)
            for step in _POSE_STEP * np.eye(6)
        ],
        axis=1,
    ) / (2 * _POSE_STEP)
    ways = [_LINE_STEP_PX * way for way in stripe_bend(points_px)]
    by_line = np.stack(
        [
            _offset_and_turn(on_board(rays(points_px + way, camera), pose), laser)
            - _offset_and_turn(on_board(rays(points_px - way, camera), pose), laser)
            for way in ways
        ],
        axis=1,
    ) / (2 * _LINE_STEP_PX)
    covariance = by_pose @ of_pose @ by_pose.T + line_variance_px2(points_px) * by_line @ by_line.T
    found = _offset_and_turn(on_board(seen, pose), laser)
    if np.linalg.matrix_rank(covariance) < 2:  # exact corners and stripes
        return 0.0
    return float(found @ np.linalg.solve(covariance, found))


def _offset_and_turn(points: Float64[Array, "n xyz=3"], laser: LaserCalibration) -> Float64[Array, "2"]:
    """Mean distance of a stripe's points from the light plane, and its change along the stripe, in metres rms."""
    distance = points @ laser.normal - laser.distance_m
    middle = points - points.mean(axis=0)
    run = middle @ (points[-1] - points[0])
    return np.array([distance.mean(), distance @ run / np.sqrt(np.mean(run**2)) / len(run)])
