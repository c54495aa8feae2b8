"""Acceptance of light planes: checks of a calibration against limits, each with advice for improvement."""

from collections.abc import Sequence

import numpy as np

from ringpose.calibrate.planes.covariance import depth_uncertainty, of_camera, ring_center_sd_m, stripes_apart_m
from ringpose.calibrate.planes.plane_fit import MAX_CONDITION
from ringpose.calibrate.planes.quality import middle_outside_rad, order_with_angles, plane_angles
from ringpose.types.calibration import LaserCalibration, PlanesCalibration
from ringpose.types.rig import LaserPlanes
from ringpose.types.verdict import Check, Verdict

FEW_VIEWS, MIN_VIEWS = 5.0, 2.0
"""Two views determine a plane without redundancy; among five, one that is wrong is conspicuous."""

GOOD_CONDITION = 10.0
"""That of views 200 mm wide whose distances differ by 20 mm across the light plane."""

GOOD_SHARE, BAD_SHARE = 2e-4, 2e-3
"""Held-out rms over distance: speckle makes 0.1 mm at 0.5 m on a good stripe; 1 mm indicates a wrong stripe."""

GOOD_EXCESS, BAD_EXCESS = 3.0, 100.0
"""A board flat to 0.1 mm can reach 3; above 100 the covariance is not meaningful."""

STRAY_FACTOR = 2.0
"""The advice names a view whose held-out rms exceeds the median by this factor."""

EXACT_M = 1e-6
"""Lower bound of the median in that comparison."""

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
    findings = [*board, _boards(calibration), _distances(calibration), _excess(calibration)]
    for laser in calibration.lasers:
        findings += [_views(laser), _condition(laser), _held_out(laser), _disagreement(laser)]
    findings += _depths(calibration) + _angles(calibration, expected_angles_rad)
    findings += [_center(calibration, working_distance_m), _middle(calibration)]
    return Verdict(findings=tuple(finding for finding in findings if finding is not None))


def _boards(calibration: PlanesCalibration) -> Check:
    rms_px = float(np.median([pose.residual_rms_px for pose in calibration.poses]))
    advice = "see with --overlay whether the corners are sharp; measure the board's sizes; check the camera file"
    if rms_px > BAD_BOARD_PX:
        advice = (
            f"the corners miss the boards by {rms_px:.1f} px: the camera file is another camera's, its lens moved, "
            "the board's sizes are others, or the board is bent; calibrate the camera anew"
        )
    return Check(name="board_rms_px", value=rms_px, pass_limit=GOOD_BOARD_PX, fail_limit=BAD_BOARD_PX, advice=advice)


def _distances(calibration: PlanesCalibration) -> Check:
    near, far = _range_m(calibration)
    advice = f"add views of the board nearer than {near / 1.2:.2f} m and farther than {1.2 * far:.2f} m"
    return Check(name="distance_ratio", value=far / near, pass_limit=GOOD_RANGE, fail_limit=BAD_RANGE, advice=advice)


def _range_m(calibration: PlanesCalibration) -> tuple[float, float]:
    """Depth of the nearest and the farthest board, at their stripes."""
    every = [view.distance_m for laser in calibration.lasers for view in laser.views]
    return min(every), max(every)


def _excess(calibration: PlanesCalibration) -> Check | None:
    if calibration.covariance is None:
        return None
    return Check(
        name="variance_excess",
        value=float(calibration.excess),
        pass_limit=GOOD_EXCESS,
        fail_limit=BAD_EXCESS,
        advice=f"the views disagree{_stray_view(calibration)}: see that the board is flat, stood still in each shot "
        "and has the sizes in its file; calibrate the camera anew",
    )


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


def _views(laser: LaserCalibration) -> Check:
    return Check(
        place=laser.name,
        name="views",
        value=float(len(laser.views)),
        pass_limit=FEW_VIEWS,
        fail_limit=MIN_VIEWS,
        advice=f"add views that show the stripe of {laser.name}: six to ten are good",
    )


def _condition(laser: LaserCalibration) -> Check:
    middle_m = float(np.mean([view.distance_m for view in laser.views]))
    return Check(
        place=laser.name,
        name="condition",
        value=laser.condition,
        pass_limit=GOOD_CONDITION,
        fail_limit=MAX_CONDITION,
        advice=f"add a view of the board 100 mm or more nearer or farther than {middle_m:.2f} m",
    )


def _held_out(laser: LaserCalibration) -> Check:
    middle_m = float(np.mean([view.distance_m for view in laser.views]))
    worst = max(laser.views, key=lambda view: np.nan_to_num(view.held_out_rms_m))
    return Check(
        place=laser.name,
        name="held_out_rms_m",
        value=laser.held_out_rms_m,
        pass_limit=GOOD_SHARE * middle_m,
        fail_limit=BAD_SHARE * middle_m,
        advice=f"see with --overlay whether the stripe of {laser.name} is sharp and unsaturated, in {worst.name} first"
        if np.isfinite(laser.held_out_rms_m)
        else "add a third view: two leave the held-out error undetermined",
    )


def _disagreement(laser: LaserCalibration) -> Check | None:
    dof = 2 * len(laser.views) - 3
    if not np.isfinite(laser.disagreement):
        return None
    return Check(
        place=laser.name,
        name="disagreement",
        value=float(laser.disagreement),
        pass_limit=GOOD_EXCESS + 3.0 * float(np.sqrt(2 / dof)),
        fail_limit=BAD_EXCESS,
        advice=f"the stripes of {laser.name} disagree with boards and other lasers: see whether they are its own",
    )


def _depths(calibration: PlanesCalibration) -> list[Check]:
    if calibration.covariance is None:
        return []
    near, far = _range_m(calibration)
    found = depth_uncertainty(calibration.camera, calibration.planes, calibration.covariance, (far,))
    return [
        Check(
            place=f"{laser.name} at {far:.2f} m",
            name="depth_sd_m",
            value=sd,
            pass_limit=GOOD_DEPTH_SHARE * far,
            fail_limit=BAD_DEPTH_SHARE * far,
            advice=f"add views at {far:.2f} m and {near:.2f} m, the stripe of {laser.name} over the whole image",
        )
        for laser, sd in zip(calibration.lasers, found.worst_m[:, 0].tolist(), strict=True)
        if np.isfinite(sd)
    ]


def _center(calibration: PlanesCalibration, working_distance_m: float | None) -> Check | None:
    """Standard deviation of a ring's centre; None if the ring misses a stripe."""
    if calibration.covariance is None:
        return None
    distance_m = working_distance_m or _range_m(calibration)[1]
    camera, lasers, covariance = calibration.camera, calibration.planes, calibration.covariance
    sd = float(ring_center_sd_m(camera, lasers, covariance, distance_m).max())
    if not np.isfinite(sd):
        return None
    by_camera = float(ring_center_sd_m(camera, lasers, of_camera(covariance), distance_m).max())
    good = GOOD_CENTER_SHARE * distance_m
    remedy = "calibrate the camera with more views" if by_camera > good else _advice_for_views(distance_m, lasers)
    return Check(
        place=f"at {distance_m:.2f} m",
        name="ring_center_sd_m",
        value=sd,
        pass_limit=good,
        fail_limit=BAD_CENTER_SHARE * distance_m,
        advice=f"poses {distance_m:.2f} m away will be off by {1e3 * sd:.1f} mm from this calibration alone: {remedy}",
    )


def _advice_for_views(distance_m: float, lasers: LaserPlanes) -> str:
    """Two more views for each laser at 1 m reduce the error of eight boards at 0.4 to 0.55 m to two fifths."""
    return (
        f"add six views of the board about {distance_m:.2f} m away, tilted by 10 to 25 degrees, "
        "the stripe of each laser across two of them "
        f"(the outermost are {stripes_apart_m(lasers, distance_m):.2f} m apart there)"
    )


def _angles(calibration: PlanesCalibration, expected_rad: Sequence[float]) -> list[Check]:
    if not expected_rad:
        return []
    other = order_with_angles(calibration, expected_rad, ANGLE_TOLERANCE_RAD)
    advice = "see with --overlay whether each stripe belongs to its laser, and how the lasers are mounted"
    if other is not None:
        advice = f"the angles fit the order {', '.join(other)}: see whether lasers are exchanged in all shots"
    return [
        Check(
            place=f"{angle.first} to {angle.second}",
            name="angle_error_rad",
            value=abs(angle.angle_rad - expected),
            pass_limit=ANGLE_TOLERANCE_RAD,
            fail_limit=5 * ANGLE_TOLERANCE_RAD,
            advice=advice,
        )
        for angle, expected in zip(plane_angles(calibration), expected_rad, strict=False)
    ]


def _middle(calibration: PlanesCalibration) -> Check | None:
    outside_rad = middle_outside_rad(calibration)
    if outside_rad is None:
        return None
    return Check(
        name="middle_outside_rad",
        value=outside_rad,
        pass_limit=ANGLE_TOLERANCE_RAD,
        fail_limit=float("inf"),
        advice="middle is not between left and right: see whether lasers are exchanged in all shots, "
        "or give their names in the order of their numbers (--laser-names)",
    )
