"""Check of a calibrated rig by a new view of the board: corners against its camera, stripes against its planes."""

from dataclasses import dataclass, replace

import numpy as np

from ringpose.calibrate.boards.corner_errors import (
    MIN_SIGMA_PX,
    corner_sigma_px,
    maximum_likelihood_pose,
    whiten,
)
from ringpose.calibrate.camera.parameters import parameter_names, projection_jacobians
from ringpose.calibrate.planes.stripes.errors import (
    StripeResiduals,
    center_sigma_px,
    line_modes,
    shared_length,
    stripe_rays,
    stripe_residuals,
)
from ringpose.calibrate.planes.stripes.extraction import triangulated
from ringpose.calibrate.planes.stripes.labels import labelled_by_planes
from ringpose.geometry.rays import undistorted_pixels
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.calibration import StripeView
from ringpose.types.rig import Rig, laser_parameters

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


_BoardEstimate = tuple[BoardPose, Float64[Array, "pose=6 pose=6"]]
"""A board's pose by its corners, and the covariance that their residuals imply."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserCheck:
    """How far one laser's stripe lies from its light plane, measured normal to the plane."""

    name: str
    offset_m: float
    """Of the stripe's line, at the end or middle where it is largest relative to its limit; NaN without a stripe."""
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


def rig_check(view: StripeView, rig: Rig, median_board_rms_px: float | None = None) -> RigCheck:
    """Agreement of a rig with a view: corners with its camera, each stripe with its light plane.

    `median_board_rms_px` is the corner rms of the rig's calibration, if it is known.
    """
    pose, unit_covariance = maximum_likelihood_pose(view.board, rig.camera)
    corner_px = max(corner_sigma_px([view], [pose], rig.camera), MIN_SIGMA_PX)
    board = pose, corner_px**2 * unit_covariance
    view = labelled_by_rig(view, pose, rig)
    return RigCheck(
        name=view.board.name,
        distance_m=float(pose.translation_m[2]),
        board_rms_px=pose.residual_rms_px,
        board_limit_px=MAX_BOARD_PX
        if median_board_rms_px is None
        else min(max(BOARD_FACTOR * median_board_rms_px, MIN_BOARD_PX), MAX_BOARD_PX),
        lasers=tuple(_laser_check(laser, view, board, rig) for laser in range(len(rig.lasers.names))),
    )


def labelled_by_rig(view: StripeView, pose: BoardPose, rig: Rig) -> StripeView:
    """The view with the stripes of frames with all lasers on assigned to the lasers on whose planes they lie."""
    if not view.unlabelled_px:
        return view
    planes = list(zip(rig.lasers.normal, rig.lasers.distance_m.tolist(), strict=True))
    return labelled_by_planes(view, [triangulated(px, pose, rig.camera) for px in view.unlabelled_px], planes)


def rig_check_lines(check: RigCheck) -> list[str]:
    """The result of a check as lines of text."""
    words = {True: "holds", False: "does not hold"}
    head = f"{check.name}: board at {check.distance_m:.2f} m, corners {check.board_rms_px:.2f} px rms"
    lines = [f"{head} (limit {check.board_limit_px:.2f}): {words[check.board_rms_px <= check.board_limit_px]}"]
    for laser in check.lasers:
        if np.isnan(laser.offset_m):
            lines.append(f"{check.name}: {laser.name}: no stripe on the board, not checked")
        else:
            found = f"{1e3 * laser.offset_m:+.3f} mm beside its plane (limit {1e3 * laser.limit_m:.3f})"
            swapped = f", it lies on the plane of {laser.lies_on}: are they swapped?" if laser.lies_on else ""
            lines.append(f"{check.name}: {laser.name}: {found}: {words[laser.holds]}{swapped}")
    return lines


def _laser_check(laser: int, view: StripeView, board: _BoardEstimate, rig: Rig) -> LaserCheck:
    """Distance of the laser's stripe from its own plane; if it is too large, also the laser on whose plane it lies."""
    own = _stripe_check(laser, laser, view, board, rig)
    if own.holds or np.isnan(own.offset_m):
        return own
    others = (_stripe_check(laser, other, view, board, rig) for other in range(len(rig.lasers.names)))
    return replace(own, lies_on=next((other.name for other in others if other.holds), ""))


def _stripe_check(stripe: int, laser: int, view: StripeView, board: _BoardEstimate, rig: Rig) -> LaserCheck:
    """Distance of one laser's stripe from the plane of the same or another laser, and its limit.

    The variance of the offset is the sum of the parts of the rig, of the board's pose, and of the stripe's own line.
    """
    name, points_px = rig.lasers.names[laser], view.stripes_px[stripe]
    if not len(points_px):
        return LaserCheck(name=name, offset_m=float("nan"), limit_m=float("nan"))
    pose, pose_covariance = board
    normal, distance_m = rig.lasers.normal[laser], float(rig.lasers.distance_m[laser])
    found = stripe_residuals(stripe_rays(points_px, rig.camera), pose, normal, distance_m)
    weights = _line_weights(points_px) * found.metres_per_pixel
    offset_m = weights @ found.residual_px
    variance = _variance(weights @ found.wrt_pose, pose_covariance)
    if rig.covariance is not None:
        names = parameter_names(rig.camera.distortion_model) + laser_parameters([name])
        variance += _variance(weights @ _jacobian_by_rig(found, view.board, pose, rig), rig.covariance.of(names))
    straight = [undistorted_pixels(px, rig.camera) for px in view.stripes_px]
    line_variance = center_sigma_px(straight[stripe], shared_length(straight)) ** 2 / len(points_px)
    variance += _variance(weights @ line_modes(points_px).T, line_variance * np.eye(2))
    limit_m = SIGMAS * np.sqrt(variance) + FLATNESS_M
    worst = int(np.argmax(np.abs(offset_m) / limit_m))
    return LaserCheck(name=name, offset_m=float(offset_m[worst]), limit_m=float(limit_m[worst]))


def _line_weights(points_px: Float64[Array, "n xy=2"]) -> Float64[Array, "position=3 n"]:
    """Weights whose product with values along a stripe is their fitted straight line at its two ends and its middle."""
    level, slope = line_modes(points_px)
    ends = np.array([slope.min(), 0.0, slope.max()])
    return (level + ends[:, None] * slope) / len(slope)


def _jacobian_by_rig(
    found: StripeResiduals, view: BoardView, pose: BoardPose, rig: Rig
) -> Float64[Array, "n parameter"]:
    """Derivatives by the camera, including the change of the board's pose that it causes, and by the light plane."""
    pixel_wrt_pose, pixel_wrt_camera = projection_jacobians(view.points_board_m, pose, rig.camera)
    wrt_pose = whiten(pixel_wrt_pose.reshape(-1, 6), view)
    wrt_camera = whiten(pixel_wrt_camera.reshape(len(wrt_pose), -1), view)
    pose_wrt_camera, *_ = np.linalg.lstsq(wrt_pose, -wrt_camera, rcond=None)
    return np.hstack([found.wrt_camera + found.wrt_pose @ pose_wrt_camera, found.wrt_plane])


def _variance(
    jacobian: Float64[Array, "position parameter"], covariance: Float64[Array, "parameter parameter"]
) -> Float64[Array, "position"]:
    return np.einsum("pi,ij,pj->p", jacobian, covariance, jacobian)
