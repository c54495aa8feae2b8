"""Why a view does not fit the camera of the others, as far as its corners tell."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringpose.calibrate.board_pose import board_pose, residuals
from ringpose.calibrate.camera_solution import corners_of
from ringpose.calibrate.intrinsics import camera_with, parameters_of
from ringpose.calibrate.view_equations import view_equations
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardView
from ringpose.types.camera import Camera

FITS = 2.0
"""A view is explained by what brings its rms below this many times the usual one."""

MOSTLY_SATURATED = 0.5
"""Share of a view's corners with saturated pixels beside them, above which that is why it does not fit."""

_STEPS = 3
_MOST = 7
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
        used = lengths <= np.partition(lengths, _MOST * len(lengths) // 10)[_MOST * len(lengths) // 10]
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
