"""Outlying views and corners of a camera calibration, and the probable cause: other camera, rotation, exposure."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringpose.calibrate.acceptance import CAMERA_LIMITS, check
from ringpose.calibrate.boards.corner_errors import view_equations
from ringpose.calibrate.boards.pose import board_pose
from ringpose.calibrate.camera.parameters import camera_with, parameters_of
from ringpose.calibrate.camera.validation import used_views
from ringpose.geometry.least_squares import Rows, gauss_newton, robust_std
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.calibration import CameraCalibration, Check
from ringpose.types.rig import Camera

VIEW_FACTOR = 2.5
"""A view is rejected if its rms exceeds this multiple of the views' median; in good sets the ratio is below 1.5."""

FLOOR_PX = 0.05
"""Residuals below this, the accuracy of corner detection, are never rejected."""

MAX_VIEW_SHARE = 1 / 3
"""Maximum share of rejected views: if more disagree, it is ambiguous which of them are wrong."""

CORNER_SIGMAS = 5.0
"""Residual in standard deviations above which a corner is left out: of normal errors, four in a million."""

MAX_CORNER_SHARE = 0.05
"""Maximum share of corners left out: a wrong distortion model must not be hidden by rejecting what it misfits."""

MIN_FOCAL_DIFFERENCE = 0.002
"""Relative difference of the focal length below which two cameras are the same."""

MAX_EXPLAINED_FACTOR = 2.0
"""A cause explains a view if it reduces the view's rms below this multiple of the median of the views."""

SATURATED_SHARE = 0.5
"""Share of a view's corners near saturated pixels, above which saturation is given as the cause."""

_SEED_FACTOR = 0.5
"""A view belongs to another camera if its rms by that camera is below this share of its rms by the calibrated one."""

_GAIN_SIGMAS = 5.0
"""Significance, in standard deviations, with which a used view fits another camera better."""

_ITERATIONS = 3


def outlying_view(poses: Sequence[BoardPose]) -> tuple[int, str] | None:
    """Index of the view with the largest rms and the reason why it is an outlier, as text; None if it is not one."""
    rms = np.array([pose.residual_rms_px for pose in poses])
    worst, median = int(np.argmax(rms)), float(np.median(rms))
    if rms[worst] <= max(VIEW_FACTOR * median, FLOOR_PX):
        return None
    return worst, f"rms {rms[worst]:.2f} px, {rms[worst] / median:.1f} times the median of the views"


def outlying_corners(errors: Sequence[Float64[Array, "_ xy=2"]]) -> list[Bool[Array, "_"]]:
    """Mask of each view's outlying corners, by the robust standard deviation of all views' corners."""
    every = np.concatenate(errors)
    lengths = np.sort(np.linalg.norm(every, axis=1))
    allowed = int(MAX_CORNER_SHARE * len(lengths))
    limit = max(CORNER_SIGMAS * robust_std(every), FLOOR_PX, float(lengths[len(lengths) - allowed - 1]))
    return [np.asarray(np.linalg.norm(error, axis=1) > limit) for error in errors]


def whole_markers(view: BoardView, left_out: Bool[Array, "corner"]) -> Bool[Array, "corner"]:
    """The mask of corners extended to whole markers where corners are intersections of sides: a side moves two."""
    if view.end_correlation == 0:
        return left_out
    return np.repeat(left_out.reshape(-1, 4).any(axis=1), 4)


def other_camera_finding(calibration: CameraCalibration) -> Check:
    """Check of the share of views that one other camera explains.

    The other camera is estimated from rejected views only; used views that fit it better are counted as well.
    """
    camera = calibration.camera
    used = used_views(calibration)
    rejected = [view.board for view in calibration.views if view.rejected]
    usual_px = float(np.median([_rms_px(board, camera) for board in used]))
    members, other = _other_camera(rejected, camera, MAX_EXPLAINED_FACTOR * usual_px)
    names = {board.name for board in members}
    for board in used if names else ():  # those that fit the other camera significantly better
        gain = len(board.ids) * (_rms_px(board, camera) ** 2 - _rms_px(board, other) ** 2)
        names |= {board.name} if gain > (_GAIN_SIGMAS * usual_px) ** 2 else set()
    names = names if len(names) > 1 else set()
    listed = ", ".join(view.name for view in calibration.views if view.name in names)
    share, difference = len(names) / len(calibration.views), focal_difference(other, camera)
    return check(CAMERA_LIMITS, "other_camera_share", share, views=listed, difference=difference)


def _other_camera(rejected: Sequence[BoardView], camera: Camera, limit_px: float) -> tuple[list[BoardView], Camera]:
    """The largest group of views that one camera of another focal length fits, and that camera; may be empty."""
    seeds = [camera_of([board], camera, 1) for board in rejected]
    turned_px = [_rms_px(turned(board, camera), camera) for board in rejected]
    # Views that fit better rotated by half a turn have another cause.
    upright = [one for one, seed, px in zip(rejected, seeds, turned_px, strict=True) if _rms_px(one, seed) < px]
    groups = [[one for one in upright if _rms_px(one, seed) < _SEED_FACTOR * _rms_px(one, camera)] for seed in seeds]
    group = max(groups, key=len, default=[])
    if not group:
        return [], camera
    other = camera_of(group, camera, 3 if len(group) > 1 else 1)
    members = [one for one in upright if _rms_px(one, other) < limit_px]
    apart = abs(other.camera_matrix[0, 0] / camera.camera_matrix[0, 0] - 1.0) > MIN_FOCAL_DIFFERENCE
    return (members, other) if members and apart else ([], camera)


def _rms_px(board: BoardView, camera: Camera) -> float:
    """Rms residual of the corners of a view with a given camera, in pixels, with the board's pose fitted."""
    return board_pose(board, camera).residual_rms_px


def view_explanation(view: BoardView, camera: Camera, usual_px: float) -> str:
    """The probable cause of a view's large rms; empty if none of the known causes explains it."""
    limit_px = MAX_EXPLAINED_FACTOR * usual_px
    turned_px = _rms_px(turned(view, camera), camera)
    for unknowns in (1, 3):
        other = camera_of([view], camera, unknowns)
        rms_px = _rms_px(view, other)
        if rms_px < min(limit_px, turned_px):
            moved_px = np.linalg.norm(other.camera_matrix[:2, 2] - camera.camera_matrix[:2, 2])
            beside = f" and a principal point {moved_px:.1f} px off" if moved_px > 0 else ""
            different = f"with a focal length {focal_difference(other, camera)}{beside}"
            return f"{different} it would be {rms_px:.2f} px: another camera, zoom or focus, or cut"
        if turned_px < limit_px:
            return (
                "it fits if its image is turned by half a turn: mount the camera as for the others, or turn the image"
            )
    if view.saturated_share > SATURATED_SHARE:
        share = f"{100 * view.saturated_share:.0f} %"
        return f"white is saturated beside {share} of its corners, which displaces them: reduce the exposure"
    return ""


def turned(view: BoardView, camera: Camera) -> BoardView:
    """The view with its image turned by half a turn, as by a camera mounted upside down."""
    last = np.array([camera.image_width - 1.0, camera.image_height - 1.0])
    return replace(view, points_px=last - view.points_px)


def focal_difference(other: Camera, camera: Camera) -> str:
    """Relative difference of another camera's focal length, as text."""
    longer = float(other.camera_matrix[0, 0] / camera.camera_matrix[0, 0]) - 1.0
    return f"{abs(100 * longer):.1f} % {'longer' if longer > 0 else 'shorter'}"


def camera_of(views: Sequence[BoardView], camera: Camera, unknowns: int) -> Camera:
    """The camera with its focal length (`unknowns` 1), or also its principal point (3), fitted to these views.

    Three Gauss-Newton iterations, each with the boards' poses fitted anew; the given camera if they diverge. From a
    start that is 10 % off, the focal length agrees with that of `scipy.optimize.least_squares` to 3e-8 of its value;
    this takes 8 ms, SciPy's solver 30 to 35 ms.
    """
    directions = np.zeros((len(parameters_of(camera)), 3))
    directions[:2, 0] = parameters_of(camera)[:2]
    directions[2, 1] = directions[3, 2] = 1.0
    directions = directions[:, :unknowns]

    def linearize(fitted: Camera) -> Rows:
        reduced = [view_equations(view, board_pose(view, fitted), fitted, 1.0).without_pose() for view in views]
        wrt_camera = np.concatenate([one.wrt_shared for one in reduced])
        return Rows.of(np.concatenate([one.residual for one in reduced]), -wrt_camera @ directions)

    def retract(fitted: Camera, problem: Rows) -> Camera:
        if not np.abs(problem.step[0]) < 0.5:  # relative step of the focal length
            raise np.linalg.LinAlgError("the iteration diverges")
        return camera_with(parameters_of(fitted) + directions @ problem.step, fitted)

    try:
        return gauss_newton(linearize, retract, camera, _ITERATIONS)[0]
    except np.linalg.LinAlgError:
        return camera
