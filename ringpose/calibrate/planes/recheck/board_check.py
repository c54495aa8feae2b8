"""Check of a calibrated rig by a new view of the board: corners against its camera, stripes against its planes."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ringpose.calibrate.boards.corner_errors import corner_sigmas_px, maximum_likelihood_pose, view_equations
from ringpose.calibrate.camera.parameters import parameter_names
from ringpose.calibrate.planes.joint_adjustment import JointData, JointState, joint_data
from ringpose.calibrate.planes.stripes.errors import line_modes, stripe_residuals
from ringpose.calibrate.planes.stripes.extraction import triangulated
from ringpose.calibrate.planes.stripes.labels import labelled_by_planes
from ringpose.geometry.sheets import bends_of
from ringpose.types.arrays import Array, Float64
from ringpose.types.calibration import StripeView
from ringpose.types.rig import Rig, bow_parameters, laser_parameters

SIGMAS = 3.0
"""Limit of a stripe's distance from its plane in standard deviations of rig and view, to which FLATNESS_M is added."""

FLATNESS_M = 5e-5
"""Deviation of a board from a plane that is accepted."""

MAX_BOARD_PX = 0.5
"""Corner rms above which camera, lens or board have changed, whatever it was in the calibration."""

MIN_BOARD_PX = 0.1
"""Smallest limit of the corner rms."""

BOARD_FACTOR = 5.0
"""Limit of the corner rms over its value in the calibration: a principal point 10 px off makes 0.3 px."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserCheck:
    """How far one laser's stripe lies from its light plane, measured normal to the plane."""

    name: str
    offset_m: float
    """Distance of the stripe's line, at the end or middle where it is largest relative to its limit; NaN if unseen."""
    limit_m: float
    lies_on: str = ""
    """The other laser on whose plane the stripe lies instead; empty if none."""

    @property
    def holds(self) -> bool:
        """Whether the stripe lies on the light plane; false if no stripe is seen."""
        return abs(self.offset_m) <= self.limit_m


@dataclass(frozen=True, slots=True, kw_only=True)
class RigCheck:
    """The result of checking a rig by one view."""

    name: str
    distance_m: float
    board_rms_px: float
    board_limit_px: float
    lasers: tuple[LaserCheck, ...]

    @property
    def holds(self) -> bool:
        """Whether camera and all light planes agree with the view."""
        return self.board_rms_px <= self.board_limit_px and all(laser.holds for laser in self.lasers)


class BoardMeasurements(NamedTuple):
    """Measurements of corners and stripes in one view of a board, with the camera and light planes of a rig."""

    data: JointData
    """Corners and stripes of the view, with their standard deviations; the stripes have the labels that the rig gives
    them where the frames give none."""
    state: JointState
    """Camera and light planes of the rig, and the board's pose by its corners."""
    pose_covariance: Float64[Array, "pose=6 pose=6"]


def board_measurements(view: StripeView, rig: Rig) -> BoardMeasurements:
    """The measurements of a view of the board, by the camera and the light planes of a rig."""
    pose, unit_covariance = maximum_likelihood_pose(view.board, rig.camera)
    normal, distance_m = rig.lasers.normal, rig.lasers.distance_m
    points = [triangulated(px, pose, rig.camera) for px in view.unlabelled_px]
    view = labelled_by_planes(view, points, list(zip(normal, distance_m.tolist(), strict=True)))
    data = joint_data([view], rig.camera, corner_sigmas_px([view], [pose], rig.camera))
    bent = bends_of(rig)
    bow = None if bent is None else bent.parameters
    state = JointState(poses=(pose,), normal=normal, distance_m=distance_m, camera=rig.camera, bow=bow)
    return BoardMeasurements(data, state, data.corner_px[0] ** 2 * unit_covariance)


def rig_check(view: StripeView, rig: Rig, median_board_rms_px: float | None = None) -> RigCheck:
    """Agreement of a rig with a view: corners with its camera, each stripe with its light plane.

    `median_board_rms_px` is the corner rms of the rig's calibration, if it is known.
    """
    board, limit_px = board_measurements(view, rig), MAX_BOARD_PX
    if median_board_rms_px is not None:
        limit_px = min(max(BOARD_FACTOR * median_board_rms_px, MIN_BOARD_PX), MAX_BOARD_PX)
    (pose,) = board.state.poses
    return RigCheck(
        name=view.board.name,
        distance_m=float(pose.translation_m[2]),
        board_rms_px=pose.residual_rms_px,
        board_limit_px=limit_px,
        lasers=tuple(_laser_check(laser, board, rig) for laser in range(len(rig.lasers.names))),
    )


def rig_check_lines(check: RigCheck) -> list[str]:
    """The result of a check as lines of text."""
    words = {True: "holds", False: "does not hold"}
    head = f"{check.name}: board at {check.distance_m:.2f} m, corners {check.board_rms_px:.2f} px rms"
    lines = [f"{head} (limit {check.board_limit_px:.2f}): {words[check.board_rms_px <= check.board_limit_px]}"]
    for laser in check.lasers:
        if np.isnan(laser.offset_m):
            lines.append(f"{check.name}: {laser.name}: no stripe on the board, not checked")
        else:
            finding = f"{1e3 * laser.offset_m:+.3f} mm beside its plane (limit {1e3 * laser.limit_m:.3f})"
            swapped = f", it lies on the plane of {laser.lies_on}: are they swapped?" if laser.lies_on else ""
            lines.append(f"{check.name}: {laser.name}: {finding}: {words[laser.holds]}{swapped}")
    return lines


def _laser_check(laser: int, board: BoardMeasurements, rig: Rig) -> LaserCheck:
    """Distance of the laser's stripe from its own plane; if it is too large, also the laser on whose plane it lies."""
    own = _stripe_check(laser, laser, board, rig)
    if own.holds or np.isnan(own.offset_m):
        return own
    others = (_stripe_check(laser, other, board, rig) for other in range(len(rig.lasers.names)))
    return replace(own, lies_on=next((other.name for other in others if other.holds), ""))


def _stripe_check(stripe: int, laser: int, board: BoardMeasurements, rig: Rig) -> LaserCheck:
    """Distance of one laser's stripe from the plane of the same or another laser, and its limit.

    The distance is taken at the ends and the middle of the straight line fitted to the stripe; the worst is returned.
    Its variance is the sum of the contributions of the rig, of the board's pose, and of the line.
    """
    (view,), (pose,), name = board.data.views, board.state.poses, rig.lasers.names[laser]
    points_px = view.stripes_px[stripe]
    if not len(points_px):
        return LaserCheck(name=name, offset_m=float("nan"), limit_m=float("nan"))
    plane = rig.lasers.normal[laser], float(rig.lasers.distance_m[laser])
    bend = None if board.state.bends is None else board.state.bends.of(laser)
    residuals = stripe_residuals(board.data.rays[0][stripe], pose, *plane, bend)
    modes = line_modes(points_px)
    level, slope = modes
    ends = np.array([slope.min(), 0.0, slope.max()])
    weights = (level + ends[:, None] * slope) / len(slope) * residuals.metres_per_pixel
    offset_m = weights @ residuals.residual_px
    variance = _variance(weights @ residuals.wrt_pose, board.pose_covariance)
    variance += board.data.center_px[0][stripe] ** 2 / len(points_px) * np.sum((weights @ modes.T) ** 2, axis=1)
    if rig.covariance is not None:
        # A wrong camera displaces the board, too: by the pose that fits the corners with it.
        corners = view_equations(view.board, pose, rig.camera, 1.0)
        pose_wrt_camera = np.linalg.lstsq(corners.wrt_pose, -corners.wrt_camera)[0]
        wrt_rig = np.hstack([residuals.wrt_camera + residuals.wrt_pose @ pose_wrt_camera, residuals.wrt_plane])
        names = parameter_names(rig.camera.distortion_model) + laser_parameters([name])
        names += () if bend is None else bow_parameters([name])
        variance += _variance(weights @ wrt_rig, rig.covariance.of(names))
    limit_m = SIGMAS * np.sqrt(variance) + FLATNESS_M
    worst = int(np.argmax(np.abs(offset_m) / limit_m))
    return LaserCheck(name=name, offset_m=float(offset_m[worst]), limit_m=float(limit_m[worst]))


def _variance(
    jacobian: Float64[Array, "position parameter"], covariance: Float64[Array, "parameter parameter"]
) -> Float64[Array, "position"]:
    return np.einsum("pi,ij,pj->p", jacobian, covariance, jacobian)
