"""Whether a calibrated rig still holds: a new view of the board against its camera and light planes."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ringpose.calibrate.boards.corner_errors import (
    MIN_SIGMA_PX,
    corner_sigma_px,
    maximum_likelihood_pose,
    whiten,
)
from ringpose.calibrate.camera.parameters import parameter_names, projection_jacobians
from ringpose.calibrate.planes.board_surface import triangulated
from ringpose.calibrate.planes.labels import labelled_by_planes
from ringpose.calibrate.planes.stripe_errors import StripeRows, center_sigma_px, shared_length, stripe_bend, stripe_rows
from ringpose.geometry.rays import rays, undistorted_pixels
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.calibration import StripeView
from ringpose.types.covariance import laser_parameters
from ringpose.types.rig import Rig

SIGMAS = 3.0
"""By so many standard deviations of rig and view a stripe may lie beside its plane ..."""

FLATNESS_M = 5e-5
"""... and by this, which boards are not flat to."""

MAX_BOARD_PX = 0.5
"""Corners further than this (rms) from where the camera has the board mean another camera, lens or board ..."""

MIN_BOARD_PX = 0.1
"""... as do those further than this and than ..."""

USUAL_FACTOR = 5.0
"""... so many times what they had when the rig was calibrated: a principal point 10 px off makes 0.3 px."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserCheck:
    """How far one laser's stripe lies from its light plane, measured normal to the plane."""

    name: str
    offset_m: float
    """Of the stripe's line, at its end or middle, where it is largest beside its limit; NaN where no stripe is seen."""
    limit_m: float
    lies_on: str = ""
    """The other laser on whose plane the stripe lies instead."""

    @property
    def holds(self) -> bool:
        """Whether the stripe is where the light plane has it; a stripe that is not seen confirms nothing."""
        return abs(self.offset_m) <= self.limit_m


@dataclass(frozen=True, slots=True, kw_only=True)
class RigCheck:
    """What one view says about a rig."""

    name: str
    distance_m: float
    board_rms_px: float
    board_limit_px: float
    lasers: tuple[LaserCheck, ...]

    @property
    def holds(self) -> bool:
        """Whether camera and all light planes agree with the view."""
        return self.board_rms_px <= self.board_limit_px and all(laser.holds for laser in self.lasers)


def rig_check(view: StripeView, rig: Rig, usual_board_px: float | None = None) -> RigCheck:
    """The board where its corners have it, and each stripe on it against its light plane.

    `usual_board_px` is the distance of corners from their boards when the rig was calibrated, if that is known.
    """
    board = _standing(view, rig)
    planes = list(zip(rig.lasers.normal, rig.lasers.distance_m.tolist(), strict=True))
    if view.unlabelled_px:
        view = labelled_by_planes(view, [triangulated(px, board.pose, rig.camera) for px in view.unlabelled_px], planes)
    return RigCheck(
        name=view.board.name,
        distance_m=float(board.pose.translation_m[2]),
        board_rms_px=board.pose.residual_rms_px,
        board_limit_px=_board_limit_px(usual_board_px),
        lasers=tuple(_judged(laser, view, board, rig) for laser in range(len(planes))),
    )


def rig_check_lines(check: RigCheck) -> list[str]:
    """The figures in lines to read."""
    head = f"{check.name}: board at {check.distance_m:.2f} m, corners {check.board_rms_px:.2f} px rms"
    lines = [f"{head} (limit {check.board_limit_px:.2f}): {_judgement(check.board_rms_px <= check.board_limit_px)}"]
    for laser in check.lasers:
        if np.isnan(laser.offset_m):
            lines.append(f"{check.name}: {laser.name}: no stripe on the board, not checked")
        else:
            found = f"{1e3 * laser.offset_m:+.3f} mm beside its plane (limit {1e3 * laser.limit_m:.3f})"
            swapped = f", it lies on the plane of {laser.lies_on}: are they swapped?" if laser.lies_on else ""
            lines.append(f"{check.name}: {laser.name}: {found}: {_judgement(laser.holds)}{swapped}")
    return lines


def _board_limit_px(usual_px: float | None) -> float:
    if usual_px is None:
        return MAX_BOARD_PX
    return min(max(USUAL_FACTOR * usual_px, MIN_BOARD_PX), MAX_BOARD_PX)


def _judgement(holds: bool) -> str:
    return "holds" if holds else "does not hold"


class _Standing(NamedTuple):
    pose: BoardPose
    covariance: Float64[Array, "pose=6 pose=6"]


def _standing(view: StripeView, rig: Rig) -> _Standing:
    """Where the view's corners have the board."""
    pose, unit = maximum_likelihood_pose(view.board, rig.camera)
    corner_px = max(corner_sigma_px([view], [pose], rig.camera), MIN_SIGMA_PX)
    return _Standing(pose, corner_px**2 * unit)


def _judged(laser: int, view: StripeView, board: _Standing, rig: Rig) -> LaserCheck:
    """The laser's stripe beside its own plane; where it is not there, whether it is on that of another."""
    found = _laser_check(laser, laser, view, board, rig)
    if found.holds or np.isnan(found.offset_m):
        return found
    others = (_laser_check(laser, other, view, board, rig) for other in range(len(rig.lasers.names)))
    return replace(found, lies_on=next((other.name for other in others if other.holds), ""))


def _laser_check(stripe: int, laser: int, view: StripeView, board: _Standing, rig: Rig) -> LaserCheck:
    """One laser's stripe beside the plane of a laser."""
    name, points_px = rig.lasers.names[laser], view.stripes_px[stripe]
    if not len(points_px):
        return LaserCheck(name=name, offset_m=float("nan"), limit_m=float("nan"))
    normal, distance_m = rig.lasers.normal[laser], float(rig.lasers.distance_m[laser])
    rows = stripe_rows(rays(points_px, rig.camera), board.pose, normal, distance_m, rig.camera)
    places = _line_places(points_px) * rows.metres_per_pixel
    offset_m = places @ rows.residual_px
    variance = _variance(places @ _by_rig(rows, view.board, board.pose, rig), _rig_covariance(rig, laser))
    variance += _variance(places @ rows.by_pose, board.covariance)
    straight = [undistorted_pixels(px, rig.camera) for px in view.stripes_px]
    line_variance = center_sigma_px(straight[stripe], shared_length(straight)) ** 2 / len(points_px)
    variance += _variance(places @ _unit_bends(points_px).T, line_variance * np.eye(2))
    limit_m = SIGMAS * np.sqrt(variance) + FLATNESS_M
    worst = int(np.argmax(np.abs(offset_m) / limit_m))
    return LaserCheck(name=name, offset_m=float(offset_m[worst]), limit_m=float(limit_m[worst]))


def _unit_bends(points_px: Float64[Array, "n xy=2"]) -> Float64[Array, "2 n"]:
    """How far centres move across the stripe when its line is shifted, and turned, by one pixel rms."""
    shift, turn = stripe_bend(points_px)
    return np.stack([np.ones(len(points_px)), turn @ shift[0]])


def _line_places(points_px: Float64[Array, "n xy=2"]) -> Float64[Array, "place=3 n"]:
    """Weights that make of values along a stripe those of their straight line at its two ends and its middle."""
    level, run = _unit_bends(points_px)
    ends = np.array([run.min(), 0.0, run.max()])
    weights: Float64[Array, "place=3 n"] = (level + ends[:, None] * run) / len(run)
    return weights


def _by_rig(rows: StripeRows, view: BoardView, pose: BoardPose, rig: Rig) -> Float64[Array, "n parameter"]:
    """Derivatives by the camera, which the board's pose follows, and by the light plane."""
    by_pose, by_camera = projection_jacobians(view.points_board_m, pose, rig.camera)
    by_pose = whiten(by_pose.reshape(-1, 6), view)
    by_camera = whiten(by_camera.reshape(len(by_pose), -1), view)
    follow, *_ = np.linalg.lstsq(by_pose, -by_camera, rcond=None)
    return np.hstack([rows.by_camera + rows.by_pose @ follow, rows.by_plane])


def _rig_covariance(rig: Rig, laser: int) -> Float64[Array, "parameter parameter"]:
    """Of the camera and one light plane; zero where the rig knows none."""
    names = parameter_names(rig.camera.distortion_model) + laser_parameters([rig.lasers.names[laser]])
    covariance = np.zeros((len(names), len(names)))
    if rig.covariance is not None:
        known = [index for index, name in enumerate(names) if name in rig.covariance.parameters]
        places = [rig.covariance.parameters.index(names[index]) for index in known]
        covariance[np.ix_(known, known)] = rig.covariance.data[np.ix_(places, places)]
    return covariance


def _variance(
    jacobian: Float64[Array, "place parameter"], covariance: Float64[Array, "parameter parameter"]
) -> Float64[Array, "place"]:
    variance: Float64[Array, "place"] = np.einsum("pi,ij,pj->p", jacobian, covariance, jacobian)
    return variance
