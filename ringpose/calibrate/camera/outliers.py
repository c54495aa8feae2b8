"""Views and corners that lie farther from the rest than chance puts them.

Whether some of the views are those of another camera, zoom or focus.

Why a view does not fit the camera of the others, as far as its corners tell.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringpose.calibrate.boards.pose import board_pose, residuals
from ringpose.calibrate.camera.bundle_adjustment import corners_of, view_equations
from ringpose.calibrate.camera.parameters import camera_with, parameters_of
from ringpose.calibrate.camera.validation import used_views
from ringpose.geometry.robust import robust_std
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.calibration import CameraCalibration
from ringpose.types.camera import Camera
from ringpose.types.verdict import Check

VIEW_FACTOR = 2.5
"""A view is rejected if its rms is this many times the median of the views'. Good sets stay below 1.5."""

FLOOR_PX = 0.05
"""No view and no corner below this is rejected: that is the corner finders' own accuracy."""

MAX_VIEW_SHARE = 1 / 3
"""If more views than this disagree, nobody knows which are the bad ones."""

CORNER_SIGMAS = 5.0
"""A corner is left out if it is so many standard deviations off; of normal errors four in a million are."""

MAX_CORNER_SHARE = 0.05
"""More corners than this are never left out, so that a bad lens model is not hidden by its own victims."""


def outlying_view(poses: Sequence[BoardPose]) -> int | None:
    """Index of the view that stands out most, if one does."""
    rms = np.array([pose.residual_rms_px for pose in poses])
    worst = int(np.argmax(rms))
    limit = max(VIEW_FACTOR * float(np.median(rms)), FLOOR_PX)
    return worst if rms[worst] > limit else None


def view_reason(poses: Sequence[BoardPose], worst: int) -> str:
    """Why this view is left out, in words."""
    rms = [pose.residual_rms_px for pose in poses]
    return f"rms {rms[worst]:.2f} px, {rms[worst] / float(np.median(rms)):.1f} times the median of the views"


def outlying_corners(errors: Sequence[Float64[Array, "_ xy=2"]]) -> list[Bool[Array, "_"]]:
    """Which corners of each view are too far off, by the spread of the bulk of all views' corners."""
    every = np.concatenate(errors)
    sigma_px = robust_std(every)
    lengths = np.linalg.norm(every, axis=1)
    allowed = int(MAX_CORNER_SHARE * len(lengths))
    limit = max(CORNER_SIGMAS * sigma_px, FLOOR_PX, float(np.sort(lengths)[len(lengths) - allowed - 1]))
    return [np.asarray(np.linalg.norm(error, axis=1) > limit) for error in errors]


def whole_markers(view: BoardView, left_out: Bool[Array, "corner"]) -> Bool[Array, "corner"]:
    """The same, and with a corner between a marker's sides the marker's other three: sides have two ends."""
    if view.likeness == 0:
        return left_out
    return np.repeat(left_out.reshape(-1, 4).any(axis=1), 4)


REDO_SHARE = 0.2
"""Of the views: with more of another camera nobody knows which one is wanted."""

MIN_SHARE = 0.002
"""A focal length that differs by less is no other camera's."""

_HALF = 0.5

_SIGMAS = 5.0


def other_camera_finding(calibration: CameraCalibration, boards: Sequence[BoardView]) -> Check:
    """The share of the views that one other camera explains; the boards are those of all views, in their order.

    It is sought by the rejected views alone; views that were used belong to it too if they fit it better.
    """
    camera = calibration.camera
    used = used_views(calibration, boards)
    rejected = [board for view, board in zip(calibration.views, boards, strict=True) if view.rejected]
    usual_px = float(np.median([_rms_px(board, camera) for board in used]))
    members, other = _other_camera(rejected, camera, FITS * usual_px)
    names = {board.name for board in (*members, *_better(used, camera, other, usual_px))}
    names = names if len(names) > 1 else set()
    listed = ", ".join(view.name for view in calibration.views if view.name in names)
    return Check(
        name="other_camera_share",
        value=len(names) / len(boards),
        pass_limit=0.0,
        fail_limit=REDO_SHARE,
        advice=f"views {listed} look like another camera's, or another zoom's: "
        f"focal length {focal_difference(other, camera)}; calibrate each by itself",
    )


def _other_camera(rejected: Sequence[BoardView], camera: Camera, limit_px: float) -> tuple[list[BoardView], Camera]:
    """The largest group of views that one camera of another focal length fits; without views if there is none."""
    seeds = [camera_of([board], camera, 1) for board in rejected]
    turned_px = [_rms_px(turned(board, camera), camera) for board in rejected]
    seen = [one for one, seed, px in zip(rejected, seeds, turned_px, strict=True) if _rms_px(one, seed) < px]
    groups = [[one for one in seen if _rms_px(one, seed) < _HALF * _rms_px(one, camera)] for seed in seeds]
    group = max(groups, key=len, default=[])
    if not group:
        return [], camera
    other = camera_of(group, camera, 3 if len(group) > 1 else 1)
    members = [one for one in seen if _rms_px(one, other) < limit_px]
    apart = abs(focal_share(other, camera)) > MIN_SHARE
    return (members, other) if members and apart else ([], camera)


def _better(used: Sequence[BoardView], camera: Camera, other: Camera, usual_px: float) -> list[BoardView]:
    """Views that fit the other camera better than chance would have it."""
    gains = [len(one.ids) * (_rms_px(one, camera) ** 2 - _rms_px(one, other) ** 2) for one in used]
    return [one for one, gain in zip(used, gains, strict=True) if gain > (_SIGMAS * usual_px) ** 2]


def _rms_px(board: BoardView, camera: Camera) -> float:
    return board_pose(board, camera).residual_rms_px


FITS = 2.0
"""A view is explained by what brings its rms below this many times the usual one."""

MOSTLY_SATURATED = 0.5
"""Share of a view's corners with saturated pixels beside them, above which that is why it does not fit."""

_STEPS = 3

_MAX_COUNT = 7
"""Tenths of the corners that are taken for good."""


def view_explanation(view: BoardView, camera: Camera, usual_px: float) -> str:
    """What would make a view fit whose rms is larger than the usual one; empty if nothing simple does."""
    limit_px = FITS * usual_px
    turned_px = board_pose(turned(view, camera), camera).residual_rms_px
    for unknowns in (1, 3):
        other = camera_of([view], camera, unknowns)
        rms_px = board_pose(view, other).residual_rms_px
        if rms_px < min(limit_px, turned_px):
            return f"{_difference(other, camera)} it would be {rms_px:.2f} px: another camera, zoom or focus, or cut"
        if turned_px < limit_px:
            return "it fits if its image is turned by half a turn: turn the camera back, or the image"
    if view.saturated_share > MOSTLY_SATURATED:
        share = f"{100 * view.saturated_share:.0f} %"
        return f"white is saturated beside {share} of its corners, which draws them aside: expose it for less"
    lengths = _errors_beside_most(view, camera)
    return _where_off(view, lengths) if np.median(lengths) < limit_px else ""


def turned(view: BoardView, camera: Camera) -> BoardView:
    """The view as a camera sees it that hangs upside down."""
    last = np.array([camera.image_width - 1.0, camera.image_height - 1.0])
    return replace(view, points_px=last - view.points_px)


def focal_share(other: Camera, camera: Camera) -> float:
    """By how much of it another camera's focal length is longer."""
    return float(other.camera_matrix[0, 0] / camera.camera_matrix[0, 0]) - 1.0


def focal_difference(other: Camera, camera: Camera) -> str:
    """The same in words."""
    longer = focal_share(other, camera)
    return f"{abs(100 * longer):.1f} % {'longer' if longer > 0 else 'shorter'}"


def _difference(other: Camera, camera: Camera) -> str:
    moved_px = np.linalg.norm(other.camera_matrix[:2, 2] - camera.camera_matrix[:2, 2])
    beside = f" and a principal point {moved_px:.1f} px off" if moved_px > 0 else ""
    return f"with a focal length {focal_difference(other, camera)}{beside}"


def _errors_beside_most(view: BoardView, camera: Camera) -> Float64[Array, "corner"]:
    """Lengths of the corners' errors beside the pose that most of them agree on."""
    used = np.ones(len(view.ids), dtype=bool)
    for _ in range(_STEPS):
        pose = board_pose(corners_of(replace(view, likeness=0.0), used), camera)
        lengths: Float64[Array, "corner"] = np.linalg.norm(residuals(view, pose, camera), axis=1)
        used = lengths <= np.partition(lengths, _MAX_COUNT * len(lengths) // 10)[_MAX_COUNT * len(lengths) // 10]
    return lengths


def camera_of(views: Sequence[BoardView], camera: Camera, unknowns: int) -> Camera:
    """The camera with the focal length, or with it and the principal point, that these views alone ask for."""
    found = camera
    directions = np.zeros((len(parameters_of(camera)), 3))
    directions[:2, 0] = parameters_of(camera)[:2]
    directions[2, 1] = directions[3, 2] = 1.0
    directions = directions[:, :unknowns]
    for _ in range(_STEPS):
        rows = [view_equations(view, board_pose(view, found), found, 1.0).without_pose() for view in views]
        by_camera, residual = (np.concatenate(parts) for parts in zip(*rows, strict=True))
        step = np.linalg.lstsq(by_camera @ directions, residual)[0]
        if not np.abs(step[0]) < 0.5:
            return camera
        found = camera_with(parameters_of(found) + directions @ step, found)
    return found


def _where_off(view: BoardView, lengths: Float64[Array, "corner"]) -> str:
    x, y = np.average(view.points_px, axis=0, weights=lengths**2)
    return f"most of its corners fit, the worst are about pixel ({x:.0f}, {y:.0f}): glare, a shadow or something there"
