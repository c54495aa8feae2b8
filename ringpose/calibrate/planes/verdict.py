"""Verdict on light planes: checks of a calibration, each with advice for improvement."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringpose.calibrate.acceptance import PLANES_LIMITS, check
from ringpose.calibrate.planes.covariance import of_camera, ring_center_sd_m, worst_depth_sd_m
from ringpose.calibrate.planes.quality import calibrated_rig, middle_outside_rad, plane_angles
from ringpose.types.calibration import Check, LaserCalibration, PlanesCalibration, Verdict
from ringpose.types.rig import ParameterCovariance, Rig

STRAY_FACTOR = 2.0
"""The advice names a view whose held-out rms exceeds the median by this factor."""

EXACT_M = 1e-6
"""Lower bound of the median held-out rms in that comparison."""


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
    rig = calibrated_rig(calibration)
    if calibration.covariance is not None:
        findings += _depth_checks(rig, near_m, far_m)
    if expected_angles_rad:
        findings += _angle_checks(calibration, expected_angles_rad)
    if calibration.covariance is not None:
        findings += _center_checks(rig, calibration.covariance, working_distance_m or far_m)
    outside_rad = middle_outside_rad(calibration)
    if outside_rad is not None:
        advice = (
            "middle is not between left and right: see whether lasers are exchanged in all shots, "
            "or give their names in the order of their numbers (--laser-names)"
        )
        findings.append(check(PLANES_LIMITS, "middle_outside_rad", outside_rad, advice))
    return Verdict(findings=tuple(findings))


def _board_checks(calibration: PlanesCalibration, near_m: float, far_m: float) -> list[Check]:
    """Checks of the corners, of the boards' distances, and of the agreement of the views."""
    rms_px = float(np.median([pose.residual_rms_px for pose in calibration.poses]))
    corners = "see with --overlay whether the corners are sharp; measure the board's sizes; check the camera file"
    if rms_px > PLANES_LIMITS["board_rms_px"][1]:
        corners = (
            f"the corners miss the boards by {rms_px:.1f} px: the camera file is another camera's, its lens moved, "
            "the board's sizes are others, or the board is bent; calibrate the camera anew"
        )
    farther = f"add views of the board nearer than {near_m / 1.2:.2f} m and farther than {1.2 * far_m:.2f} m"
    checks = [
        check(PLANES_LIMITS, "board_rms_px", rms_px, corners),
        check(PLANES_LIMITS, "distance_ratio", far_m / near_m, farther),
    ]
    if calibration.covariance is not None:
        advice = (
            f"the views disagree{_stray_view(calibration)}: see that the board is flat, stood still in each shot "
            "and has the sizes in its file; calibrate the camera anew"
        )
        checks.append(check(PLANES_LIMITS, "variance_excess", float(calibration.excess), advice))
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
    checks = [
        check(PLANES_LIMITS, "views", float(len(laser.views)), more, laser.name),
        check(PLANES_LIMITS, "condition", laser.condition, farther, laser.name),
        check(PLANES_LIMITS, "held_out_rms_m", laser.held_out_rms_m, held_out, laser.name, scale=middle_m),
    ]
    if np.isfinite(laser.disagreement):
        # Three standard deviations of chi-squared per degree of freedom above the limit of the views' disagreement.
        margin = 3.0 * float(np.sqrt(2 / (2 * len(laser.views) - 3)))
        own = f"the stripes of {laser.name} disagree with boards and other lasers: see whether they are its own"
        found = check(PLANES_LIMITS, "disagreement", float(laser.disagreement), own, laser.name)
        checks.append(replace(found, pass_limit=found.pass_limit + margin))
    return checks


def _depth_checks(rig: Rig, near_m: float, far_m: float) -> list[Check]:
    """Checks of the standard deviation of depths at the farthest board; none for a laser whose stripe misses it."""
    checks = []
    for name, (sd,) in zip(rig.lasers.names, worst_depth_sd_m(rig, [far_m]).tolist(), strict=True):
        if np.isfinite(sd):
            advice = f"add views at {far_m:.2f} m and {near_m:.2f} m, the stripe of {name} over the whole image"
            checks.append(check(PLANES_LIMITS, "depth_sd_m", sd, advice, f"{name} at {far_m:.2f} m", scale=far_m))
    return checks


def _angle_checks(calibration: PlanesCalibration, expected_rad: Sequence[float]) -> list[Check]:
    """Checks of the angles of neighbouring lasers."""
    advice = (
        "see with --overlay whether each stripe belongs to its laser, or lasers are exchanged in all shots; "
        "check how the lasers are mounted"
    )
    angles = zip(plane_angles(calibration), expected_rad, strict=False)
    return [
        check(PLANES_LIMITS, "angle_error_rad", abs(one["angle_rad"] - expected), advice, " to ".join(one["lasers"]))
        for one, expected in angles
    ]


def _center_checks(rig: Rig, covariance: ParameterCovariance, distance_m: float) -> list[Check]:
    """Check of the standard deviation of a ring's centre; none if the ring misses a stripe."""
    sd = float(ring_center_sd_m(rig, distance_m).max())
    if not np.isfinite(sd):
        return []
    good = PLANES_LIMITS["ring_center_sd_m"][0] * distance_m
    if float(ring_center_sd_m(replace(rig, covariance=of_camera(covariance)), distance_m).max()) > good:
        remedy = "calibrate the camera with more views"
    else:  # two more views for each laser at 1 m reduce the error of eight boards at 0.4 to 0.55 m to two fifths
        remedy = (
            f"add six views of the board about {distance_m:.2f} m away, tilted by 10 to 25 degrees, "
            "the stripe of each laser across two of them"
        )
    advice = f"poses {distance_m:.2f} m away will be off by {1e3 * sd:.1f} mm from this calibration alone: {remedy}"
    return [check(PLANES_LIMITS, "ring_center_sd_m", sd, advice, f"at {distance_m:.2f} m", scale=distance_m)]
