"""Quality of a calibration of the light planes: values for the file, summary for the user, verdict with advice."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ringpose.calibrate.acceptance import PLANES_LIMITS, check, verdict_lines, verdict_values
from ringpose.calibrate.planes.covariance import RADII_M, of_camera, ring_center_sd_m, worst_depth_sd_m
from ringpose.calibrate.planes.stripes.labels import THREE
from ringpose.geometry.rotations import angle_between, tilt_basis
from ringpose.types.arrays import Array, Float64
from ringpose.types.calibration import Check, LaserCalibration, PlanesCalibration, Verdict
from ringpose.types.rig import ParameterCovariance, Rig, laser_parameters

DEPTHS_M = (0.2, 0.3, 0.5, 1.0)
"""Distances at which depth uncertainties are reported."""


STRAY_FACTOR = 2.0
"""The advice names a view whose held-out rms exceeds the median by this factor."""

SHEET_SIGMAS = 3.0
"""Standard deviations beyond which the height of the stripes beside the print is significant."""

EXACT_M = 1e-6
"""Lower bound of the median held-out rms in that comparison."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanesAssessment:
    """The light planes with verdict, and with the planes by the paper's method for comparison."""

    calibration: PlanesCalibration
    verdict: Verdict
    paper: PlanesCalibration | None = None
    """The calibration of the same views by the paper's method; None if it is not applicable."""
    without_board: Sequence[tuple[str, str]] = ()
    """Names of the images that show no board, and the reasons."""


def calibrated_rig(calibration: PlanesCalibration) -> Rig:
    """The rig of camera and light planes; a joint covariance replaces the camera's own."""
    joint = calibration.covariance is not None
    own = replace(calibration.camera, covariance=None) if joint else calibration.camera
    return Rig(
        camera=own,
        lasers=calibration.planes,
        covariance=calibration.covariance,
        ghosts=calibration.ghosts,
        bows=calibration.bows,
    )


def planes_quality(assessment: PlanesAssessment) -> Mapping[str, Any]:
    """The key `quality` of rig.yaml."""
    calibration, covariance = assessment.calibration, assessment.calibration.covariance
    reasons = {
        "remarks": (*calibration.contradicting, *calibration.remarks),
        "without_board": assessment.without_board,
    }
    quality: dict[str, Any] = {
        "verdict": verdict_values(assessment.verdict),
        "method": calibration.method,
        "standard_deviations": {},
        "variance_excess": float(calibration.excess),
        "lasers": [_laser_quality(laser) for laser in calibration.lasers],
    }
    if angles := plane_angles(calibration):
        quality["angles"] = {"neighbours": angles}
    if covariance is not None:
        rig = calibrated_rig(calibration)
        planes = {name: sd for name, sd in covariance.standard_deviations.items() if "." in name}
        depths = zip(rig.lasers.names, worst_depth_sd_m(rig, DEPTHS_M).tolist(), strict=True)
        quality["standard_deviations"] = planes
        quality["depth_sd_m"] = {
            "distances_m": list(DEPTHS_M),
            "lasers": [{"name": name, "depth_sd_m": sd} for name, sd in depths],
        }
        quality["ring_center_sd_m"] = {
            "radii_m": list(RADII_M),
            "distances_m": list(DEPTHS_M),
            "sd_m": [ring_center_sd_m(rig, distance_m).tolist() for distance_m in DEPTHS_M],
        }
    quality["boards"] = [
        {"name": pose.name, "rms_px": pose.residual_rms_px, "distance_m": float(pose.translation_m[2])}
        for pose in calibration.poses
    ]
    if assessment.paper is not None:
        pairs = zip(calibration.lasers, assessment.paper.lasers, strict=True)
        quality["paper"] = [_paper_quality(own, other) for own, other in pairs]
    for key, entries in reasons.items():
        quality[key] = [{"name": name, "reason": reason} for name, reason in entries]
    return {"quality": quality}


def _laser_quality(laser: LaserCalibration) -> dict[str, Any]:
    """One entry of the key `quality.lasers`."""
    return {
        "name": laser.name,
        "rms_m": laser.rms_m,
        "held_out_rms_m": laser.held_out_rms_m,
        "condition": laser.condition,
        "disagreement": float(laser.disagreement),
        "views": [
            {
                "name": view.name,
                "points": len(view.points),
                "distance_m": view.distance_m,
                "rms_m": view.rms_m,
                "held_out_rms_m": view.held_out_rms_m,
            }
            for view in laser.views
        ],
    }


def _paper_quality(own: LaserCalibration, paper: LaserCalibration) -> dict[str, Any]:
    """One entry of the key `quality.paper`: the plane by the paper's method, compared with this calibration's plane.

    The offset between the two planes is measured at the centroid of the laser's points.
    """
    centroid = np.concatenate([view.points for view in own.views]).mean(axis=0)
    return {
        "name": own.name,
        "rms_m": paper.rms_m,
        "held_out_rms_m": paper.held_out_rms_m,
        "angle_rad": float(angle_between(own.normal, paper.normal)),
        "offset_m": abs(float(centroid @ paper.normal - paper.distance_m)),
    }


def planes_summary(assessment: PlanesAssessment) -> list[str]:
    """The result of a calibration as lines of text, with the values of the key `quality`."""
    quality = planes_quality(assessment)["quality"]
    lines = [f"{name}: {reason}" for name, reason in assessment.calibration.remarks]
    for laser in quality["lasers"]:
        lines += _laser_lines(laser, quality["standard_deviations"])
    for name, ghost in assessment.calibration.ghosts.items():
        lines.append(f"{name}: {ghost}; detection will subtract it")
    for name, bow in assessment.calibration.bows.items():
        lines.append(
            f"{name}: its light plane is bent, by {bow.per_rad:.5f} ± {bow.sd_per_rad:.5f} rad one radian beside its "
            "middle; stripes are measured with this bend"
        )
    for angle in plane_angles(assessment.calibration):
        sd = f" ± {np.degrees(angle['sd_rad']):.4f}" if np.isfinite(angle["sd_rad"]) else ""
        lines.append(f"{' to '.join(angle['lasers'])}: {np.degrees(angle['angle_rad']):.3f}{sd} deg")
    for laser in quality.get("depth_sd_m", {"lasers": []})["lasers"]:
        text = _by_distance_text(laser["depth_sd_m"])
        lines += [f"{laser['name']}: standard deviation of depths: {text}"] if text else []
    centers = quality.get("ring_center_sd_m", {"sd_m": []})["sd_m"]
    if centers and (text := _by_distance_text([max(sd) for sd in centers])):
        lines.append(f"standard deviation of a ring's centre (radius {RADII_M[1]:g} m) by this calibration: {text}")
    for paper in quality.get("paper", ()):
        lines.append(
            f"{paper['name']}: by the paper's method held out {1e6 * paper['held_out_rms_m']:.0f} um, "
            f"{np.degrees(paper['angle_rad']):.4f} deg and {1e6 * paper['offset_m']:.0f} um away"
        )
    return lines + verdict_lines(assessment.verdict)


def _laser_lines(laser: Mapping[str, Any], deviations: Mapping[str, float]) -> list[str]:
    """A laser's residuals and standard deviations, and the held-out errors of its nearest and farthest view."""
    name, views, held_out_m = laser["name"], laser["views"], laser["held_out_rms_m"]
    points = sum(view["points"] for view in views)
    line = f"{name}: {points} points of {len(views)} views, rms {1e6 * laser['rms_m']:.0f} um, held out "
    line += f"{1e6 * held_out_m:.0f} um" if np.isfinite(held_out_m) else "unknown (needs a third view)"
    if deviations:
        tilt = np.degrees(max(deviations[f"{name}.tilt_1"], deviations[f"{name}.tilt_2"]))
        line += f", tilt ± {tilt:.4f} deg, distance ± {1e6 * deviations[f'{name}.distance']:.0f} um"
    known = sorted(
        (view for view in views if np.isfinite(view["held_out_rms_m"])), key=lambda view: float(view["distance_m"])
    )
    if len(known) < 2:
        return [line]
    ends = ", ".join(
        f"{1e6 * view['held_out_rms_m']:.0f} um at {view['distance_m']:.2f} m ({view['name']})"
        for view in (known[0], known[-1])
    )
    return [line, f"{name}: held out {ends}"]


def _by_distance_text(sd_m: Sequence[float]) -> str:
    """The finite ones among the standard deviations at `DEPTHS_M`, as text; empty if there are none."""
    known = [(z, sd) for z, sd in zip(DEPTHS_M, sd_m, strict=True) if np.isfinite(sd)]
    return ", ".join(f"{1e3 * sd:.2f} mm at {z:g} m" for z, sd in known)


def plane_angles(calibration: PlanesCalibration) -> list[dict[str, Any]]:
    """Angles between neighbouring planes in the order of the lasers: entries of the key `quality.angles.neighbours`.

    Each has the names of its `lasers`, `angle_rad`, and the standard deviation `sd_rad`, NaN without covariance.
    """
    names, normals = calibration.planes.names, calibration.planes.normal
    return [
        {
            "lasers": [names[first], names[first + 1]],
            "angle_rad": float(angle_between(normals[first], normals[first + 1])),
            "sd_rad": _angle_sd_rad(calibration, first, first + 1),
        }
        for first in range(len(names) - 1)
    ]


def _angle_sd_rad(calibration: PlanesCalibration, first: int, second: int) -> float:
    """Standard deviation of the angle between two planes (rad); NaN without covariance.

    A tilt of one normal towards the other reduces the angle by the same amount.
    """
    covariance = calibration.covariance
    if covariance is None:
        return float("nan")
    names = [name for laser in (first, second) for name in laser_parameters([calibration.lasers[laser].name])[:2]]
    columns = [covariance.parameters.index(name) for name in names]
    own, other = calibration.planes.normal[[first, second]]
    jacobian = np.concatenate([-_direction_towards(own, other), -_direction_towards(other, own)])
    return float(np.sqrt(max(jacobian @ covariance.data[np.ix_(columns, columns)] @ jacobian, 0.0)))


def _direction_towards(normal: Float64[Array, "xyz=3"], other: Float64[Array, "xyz=3"]) -> Float64[Array, "2"]:
    """Unit vector towards the other normal in the tilt basis of `normal`; zero if they are equal."""
    direction: Float64[Array, "2"] = tilt_basis(normal) @ other
    length = float(np.linalg.norm(direction))
    return direction / length if length > 0 else direction


def middle_outside_rad(calibration: PlanesCalibration) -> float | None:
    """Angle (rad) by which plane `middle` lies outside the wedge of `left` and `right`, 0 inside it.

    None unless the lasers have these names. A plane between two others makes a smaller angle with each than they make
    with each other.
    """
    planes = dict(zip(calibration.planes.names, calibration.planes.normal, strict=True))
    if set(planes) != set(THREE):
        return None
    left, middle, right = (planes[name] for name in THREE)
    inner = max(float(angle_between(left, middle)), float(angle_between(middle, right)))
    return max(inner - float(angle_between(left, right)), 0.0)


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
        findings += _laser_checks(laser, len(calibration.lasers))
    rig = calibrated_rig(calibration)
    if calibration.covariance is not None:
        findings += _depth_checks(rig, near_m, far_m)
    if expected_angles_rad:
        findings += _angle_checks(calibration, expected_angles_rad)
    if calibration.covariance is not None:
        findings += _center_checks(rig, calibration.covariance, working_distance_m or far_m)
    outside_rad = middle_outside_rad(calibration)
    if outside_rad is not None:
        findings.append(check(PLANES_LIMITS, "middle_outside_rad", outside_rad))
    return Verdict(findings=tuple(findings))


def _board_checks(calibration: PlanesCalibration, near_m: float, far_m: float) -> list[Check]:
    """Checks of the corners, of the boards' distances, and of the agreement of the views."""
    rms_px = float(np.median([pose.residual_rms_px for pose in calibration.poses]))
    checks = [
        check(PLANES_LIMITS, "board_rms_px", rms_px, rms_px=rms_px),
        check(PLANES_LIMITS, "distance_ratio", far_m / near_m, near_m=near_m / 1.2, far_m=1.2 * far_m),
    ]
    if calibration.covariance is not None:
        stray = _stray_view(calibration)
        checks.append(check(PLANES_LIMITS, "variance_excess", float(calibration.excess), stray=stray))
    if calibration.sheet_height_m is not None:
        checks.append(_sheet_check(*calibration.sheet_height_m, far_m))
    return checks


def _sheet_check(height_m: float, sd_m: float, far_m: float) -> Check:
    """Check of the plane of stripes beside the print; the height is unknown if it may be too large by chance."""
    good_m = PLANES_LIMITS["sheet_height_m"].good * far_m
    known = abs(height_m) > SHEET_SIGMAS * sd_m or SHEET_SIGMAS * sd_m <= good_m
    side = "behind" if height_m > 0 else "in front of"
    value_m = abs(height_m) if known else float("nan")
    return check(PLANES_LIMITS, "sheet_height_m", value_m, scale=far_m, height_mm=1e3 * abs(height_m), side=side)


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


def _laser_checks(laser: LaserCalibration, lasers: int) -> list[Check]:
    """Checks of one laser's views: number, arrangement, and agreement with each other, boards and other lasers."""
    name, number = laser.name, len(laser.views)
    middle_m = float(np.mean([view.distance_m for view in laser.views]))
    worst = max(laser.views, key=lambda view: np.nan_to_num(view.held_out_rms_m)).name
    checks = [
        check(PLANES_LIMITS, "views", float(number), name),
        check(PLANES_LIMITS, "condition", laser.condition, name, middle_m=middle_m),
        check(PLANES_LIMITS, "held_out_rms_m", laser.held_out_rms_m, name, scale=middle_m, worst=worst),
    ]
    if np.isfinite(laser.disagreement):
        # Three standard deviations of chi-squared per degree of freedom above the limit of the views' disagreement.
        margin = 3.0 * float(np.sqrt(2 / (2 * number - 3)))
        others = " and the other lasers" if lasers > 1 else ""
        checks.append(
            check(PLANES_LIMITS, "disagreement", float(laser.disagreement), name, margin=margin, others=others)
        )
    return checks


def _depth_checks(rig: Rig, near_m: float, far_m: float) -> list[Check]:
    """Checks of the standard deviation of depths at the farthest board; none for a laser whose stripe misses it."""
    assert rig.covariance is not None
    by_camera = replace(rig, covariance=of_camera(rig.covariance))
    depths, of_these = (worst_depth_sd_m(each, [far_m])[:, 0].tolist() for each in (rig, by_camera))
    checks = []
    for name, sd, camera_sd in zip(rig.lasers.names, depths, of_these, strict=True):
        remedy = f"add views at {far_m:.2f} m and {near_m:.2f} m, the stripe of {name} over the whole image"
        if camera_sd > PLANES_LIMITS["depth_sd_m"].good * far_m:
            remedy = "the camera is too uncertain for these depths: follow the advice of its calibration"
        if np.isfinite(sd):
            at = f"{name} at {far_m:.2f} m"
            checks.append(check(PLANES_LIMITS, "depth_sd_m", sd, at, scale=far_m, remedy=remedy))
    return checks


def _angle_checks(calibration: PlanesCalibration, expected_rad: Sequence[float]) -> list[Check]:
    """Checks of the angles of neighbouring lasers."""
    angles = zip(plane_angles(calibration), expected_rad, strict=False)
    return [
        check(PLANES_LIMITS, "angle_error_rad", abs(one["angle_rad"] - expected), " to ".join(one["lasers"]))
        for one, expected in angles
    ]


def _center_checks(rig: Rig, covariance: ParameterCovariance, distance_m: float) -> list[Check]:
    """Check of the standard deviation of a ring's centre; none if the ring misses a stripe."""
    sd = float(ring_center_sd_m(rig, distance_m).max())
    if not np.isfinite(sd):
        return []
    good = PLANES_LIMITS["ring_center_sd_m"].good * distance_m
    if float(ring_center_sd_m(replace(rig, covariance=of_camera(covariance)), distance_m).max()) > good:
        remedy = "calibrate the camera with more views"
    else:  # two more views for each laser at 1 m reduce the error of eight boards at 0.4 to 0.55 m to two fifths
        remedy = (
            f"add six views of the board about {distance_m:.2f} m away, tilted by 10 to 25 degrees, "
            "the stripe of each laser across two of them"
        )
    at = f"at {distance_m:.2f} m"
    own = check(
        PLANES_LIMITS,
        "ring_center_sd_m",
        sd,
        at,
        scale=distance_m,
        distance_m=distance_m,
        sd_mm=1e3 * sd,
        remedy=remedy,
    )
    return [own]
