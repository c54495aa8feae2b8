"""Acceptance of light planes: checks of a calibration against limits, each with advice for improvement."""

from collections.abc import Sequence

import numpy as np

from ringpose.calibrate.planes.covariance import of_camera, ring_center_sd_m, stripes_apart_m, worst_depth_sd_m
from ringpose.calibrate.planes.plane_fit import MAX_CONDITION
from ringpose.calibrate.planes.quality import middle_outside_rad, order_with_angles, plane_angles
from ringpose.types.calibration import Check, LaserCalibration, PlanesCalibration, Verdict
from ringpose.types.rig import ParameterCovariance

FEW_VIEWS, MIN_VIEWS = 5.0, 2.0
"""Good and minimum number of views of a laser: two determine a plane without redundancy; of five, a wrong one stands
out."""

GOOD_CONDITION = 10.0
"""Good condition number of a laser's points: that of views 200 mm wide that differ by 20 mm across their stripes."""

GOOD_SHARE, BAD_SHARE = 2e-4, 2e-3
"""Held-out rms over distance: speckle makes 0.1 mm at 0.5 m on a good stripe; 1 mm indicates a wrong stripe."""

GOOD_EXCESS, BAD_EXCESS = 3.0, 100.0
"""Limits of the factor by which the views disagree: a board flat to 0.1 mm can reach 3; above 100 the covariance is not
meaningful."""

STRAY_FACTOR = 2.0
"""The advice names a view whose held-out rms exceeds the median by this factor."""

EXACT_M = 1e-6
"""Lower bound of the median held-out rms in that comparison."""

GOOD_DEPTH_SHARE, BAD_DEPTH_SHARE = 1e-3, 1e-2
"""Standard deviation of depths over depth, at the farthest board."""

GOOD_CENTER_SHARE, BAD_CENTER_SHARE = 1e-3, 1e-2
"""Standard deviation of a ring's centre by this calibration, over its distance; the errors of a shot at 0.5 m are five
times as large."""

GOOD_RANGE, BAD_RANGE = 1.4, 1.05
"""Distance of the farthest over the nearest board: planes are valid over this range and about as far beyond."""

GOOD_BOARD_PX, BAD_BOARD_PX = 0.3, 1.0
"""Median over the views of the corner rms."""

ANGLE_TOLERANCE_RAD = float(np.radians(1.0))
"""Accepted deviation of the angles between lasers from their expected values."""


def planes_verdict(
    calibration: PlanesCalibration,
    expected_angles_rad: Sequence[float] = (),
    board: Sequence[Check] = (),
    working_distance_m: float | None = None,
) -> Verdict:
    """Grade (good, can be improved, redo) and checks; the expected angles are those of neighbouring lasers, in order.

    `board` are checks of the sizes in the board file. Ring poses are evaluated at the working distance, by default at
    the distance of the farthest board.
    """
    distances_m = [view.distance_m for laser in calibration.lasers for view in laser.views]
    near_m, far_m = min(distances_m), max(distances_m)
    findings = [*board, *_board_checks(calibration, near_m, far_m)]
    for laser in calibration.lasers:
        findings += _laser_checks(laser)
    if calibration.covariance is not None:
        findings += _depth_checks(calibration, calibration.covariance, near_m, far_m)
    findings += _angle_checks(calibration, expected_angles_rad)
    if calibration.covariance is not None:
        findings += _center_checks(calibration, calibration.covariance, working_distance_m or far_m)
    outside_rad = middle_outside_rad(calibration)
    if outside_rad is not None:
        advice = (
            "middle is not between left and right: see whether lasers are exchanged in all shots, "
            "or give their names in the order of their numbers (--laser-names)"
        )
        findings.append(_check("middle_outside_rad", outside_rad, (ANGLE_TOLERANCE_RAD, float("inf")), advice))
    return Verdict(findings=tuple(findings))


def _check(name: str, value: float, limits: tuple[float, float], advice: str, place: str = "") -> Check:
    """A check; its limits are that of a good value and that beyond which the calibration must be repeated."""
    return Check(name=name, value=value, pass_limit=limits[0], fail_limit=limits[1], advice=advice, place=place)


def _board_checks(calibration: PlanesCalibration, near_m: float, far_m: float) -> list[Check]:
    """Checks of the corners, of the boards' distances, and of the agreement of the views."""
    rms_px = float(np.median([pose.residual_rms_px for pose in calibration.poses]))
    corners = "see with --overlay whether the corners are sharp; measure the board's sizes; check the camera file"
    if rms_px > BAD_BOARD_PX:
        corners = (
            f"the corners miss the boards by {rms_px:.1f} px: the camera file is another camera's, its lens moved, "
            "the board's sizes are others, or the board is bent; calibrate the camera anew"
        )
    farther = f"add views of the board nearer than {near_m / 1.2:.2f} m and farther than {1.2 * far_m:.2f} m"
    checks = [
        _check("board_rms_px", rms_px, (GOOD_BOARD_PX, BAD_BOARD_PX), corners),
        _check("distance_ratio", far_m / near_m, (GOOD_RANGE, BAD_RANGE), farther),
    ]
    if calibration.covariance is not None:
        advice = (
            f"the views disagree{_stray_view(calibration)}: see that the board is flat, stood still in each shot "
            "and has the sizes in its file; calibrate the camera anew"
        )
        limits = (GOOD_EXCESS, BAD_EXCESS)
        checks.append(_check("variance_excess", float(calibration.excess), limits, advice))
    return checks


def _stray_view(calibration: PlanesCalibration) -> str:
    """The view whose held-out rms exceeds its laser's median most, if by more than STRAY_FACTOR; empty otherwise."""
    shares: dict[str, float] = {}
    for laser in calibration.lasers:
        known = [view for view in laser.views if np.isfinite(view.held_out_rms_m)]
        median_m = float(np.median([view.held_out_rms_m for view in known])) if known else 0.0
        for view in known:
            share = view.held_out_rms_m / max(median_m, EXACT_M)
            shares[view.name] = max(share, shares.get(view.name, 0.0))
    worst = max(shares, key=lambda name: shares[name], default="")
    return f", {worst} most of all" if shares.get(worst, 0.0) > STRAY_FACTOR else ""


def _laser_checks(laser: LaserCalibration) -> list[Check]:
    """Checks of one laser's views: number, arrangement, and agreement with each other and with the boards."""
    middle_m = float(np.mean([view.distance_m for view in laser.views]))
    more = f"add views that show the stripe of {laser.name}: six to ten are good"
    farther = f"add a view of the board 100 mm or more nearer or farther than {middle_m:.2f} m"
    worst = max(laser.views, key=lambda view: np.nan_to_num(view.held_out_rms_m)).name
    held_out = f"see with --overlay whether the stripe of {laser.name} is sharp and unsaturated, in {worst} first"
    if not np.isfinite(laser.held_out_rms_m):
        held_out = "add a third view: two leave the held-out error undetermined"
    shares = (GOOD_SHARE * middle_m, BAD_SHARE * middle_m)
    checks = [
        _check("views", float(len(laser.views)), (FEW_VIEWS, MIN_VIEWS), more, laser.name),
        _check("condition", laser.condition, (GOOD_CONDITION, MAX_CONDITION), farther, laser.name),
        _check("held_out_rms_m", laser.held_out_rms_m, shares, held_out, laser.name),
    ]
    if np.isfinite(laser.disagreement):
        # Three standard deviations of chi-squared per degree of freedom above the limit of the views' disagreement.
        good = GOOD_EXCESS + 3.0 * float(np.sqrt(2 / (2 * len(laser.views) - 3)))
        own = f"the stripes of {laser.name} disagree with boards and other lasers: see whether they are its own"
        checks.append(_check("disagreement", float(laser.disagreement), (good, BAD_EXCESS), own, laser.name))
    return checks


def _depth_checks(
    calibration: PlanesCalibration, covariance: ParameterCovariance, near_m: float, far_m: float
) -> list[Check]:
    """Checks of the standard deviation of depths at the farthest board; none for a laser whose stripe misses it."""
    limits = (GOOD_DEPTH_SHARE * far_m, BAD_DEPTH_SHARE * far_m)
    found = worst_depth_sd_m(calibration.camera, calibration.planes, covariance, (far_m,))
    checks = []
    for name, sd in zip(calibration.planes.names, found[:, 0].tolist(), strict=True):
        if np.isfinite(sd):
            advice = f"add views at {far_m:.2f} m and {near_m:.2f} m, the stripe of {name} over the whole image"
            checks.append(_check("depth_sd_m", sd, limits, advice, f"{name} at {far_m:.2f} m"))
    return checks


def _angle_checks(calibration: PlanesCalibration, expected_rad: Sequence[float]) -> list[Check]:
    """Checks of the angles of neighbouring lasers, if their expected values are given."""
    if not expected_rad:
        return []
    other = order_with_angles(calibration, expected_rad, ANGLE_TOLERANCE_RAD)
    advice = "see with --overlay whether each stripe belongs to its laser, and how the lasers are mounted"
    if other is not None:
        advice = f"the angles fit the order {', '.join(other)}: see whether lasers are exchanged in all shots"
    limits = (ANGLE_TOLERANCE_RAD, 5 * ANGLE_TOLERANCE_RAD)
    return [
        _check("angle_error_rad", abs(angle.angle_rad - expected), limits, advice, f"{angle.first} to {angle.second}")
        for angle, expected in zip(plane_angles(calibration), expected_rad, strict=False)
    ]


def _center_checks(calibration: PlanesCalibration, covariance: ParameterCovariance, distance_m: float) -> list[Check]:
    """Check of the standard deviation of a ring's centre; none if the ring misses a stripe."""
    camera, lasers = calibration.camera, calibration.planes
    sd = float(ring_center_sd_m(camera, lasers, covariance, distance_m).max())
    if not np.isfinite(sd):
        return []
    good = GOOD_CENTER_SHARE * distance_m
    if float(ring_center_sd_m(camera, lasers, of_camera(covariance), distance_m).max()) > good:
        remedy = "calibrate the camera with more views"
    else:  # two more views for each laser at 1 m reduce the error of eight boards at 0.4 to 0.55 m to two fifths
        remedy = (
            f"add six views of the board about {distance_m:.2f} m away, tilted by 10 to 25 degrees, "
            "the stripe of each laser across two of them "
            f"(the outermost are {stripes_apart_m(lasers, distance_m):.2f} m apart there)"
        )
    advice = f"poses {distance_m:.2f} m away will be off by {1e3 * sd:.1f} mm from this calibration alone: {remedy}"
    limits = (good, BAD_CENTER_SHARE * distance_m)
    return [_check("ring_center_sd_m", sd, limits, advice, f"at {distance_m:.2f} m")]
