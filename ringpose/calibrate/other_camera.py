"""Whether some of the views are those of another camera, zoom or focus."""

from collections.abc import Sequence

import numpy as np

from ringpose.calibrate.board_pose import board_pose
from ringpose.calibrate.cross_validation import used_views
from ringpose.calibrate.view_reasons import FITS, camera_of, focal_difference, focal_share, turned
from ringpose.types.board import BoardView
from ringpose.types.calibration import CameraCalibration
from ringpose.types.camera import Camera
from ringpose.types.verdict import Finding

REDO_SHARE = 0.2
"""Of the views: with more of another camera nobody knows which one is wanted."""

LEAST_SHARE = 0.002
"""A focal length that differs by less is no other camera's."""

_HALF = 0.5
_SIGMAS = 5.0


def other_camera_finding(calibration: CameraCalibration, boards: Sequence[BoardView]) -> Finding:
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
    return Finding(
        name="other_camera_share",
        value=len(names) / len(boards),
        good_limit=0.0,
        redo_limit=REDO_SHARE,
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
    apart = abs(focal_share(other, camera)) > LEAST_SHARE
    return (members, other) if members and apart else ([], camera)


def _better(used: Sequence[BoardView], camera: Camera, other: Camera, usual_px: float) -> list[BoardView]:
    """Views that fit the other camera better than chance would have it."""
    gains = [len(one.ids) * (_rms_px(one, camera) ** 2 - _rms_px(one, other) ** 2) for one in used]
    return [one for one, gain in zip(used, gains, strict=True) if gain > (_SIGMAS * usual_px) ** 2]


def _rms_px(board: BoardView, camera: Camera) -> float:
    return board_pose(board, camera).residual_rms_px
