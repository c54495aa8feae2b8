"""Results of a calibration of the light planes: the key `quality` of rig.yaml, the summary, angles between planes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ringpose.calibrate.acceptance import verdict_lines, verdict_values
from ringpose.calibrate.planes.covariance import RADII_M, ring_center_sd_m, worst_depth_sd_m
from ringpose.calibrate.planes.stripes.labels import THREE
from ringpose.geometry.rotations import angle_between, tilt_basis
from ringpose.types.arrays import Array, Float64
from ringpose.types.calibration import LaserCalibration, PlanesCalibration, Verdict
from ringpose.types.rig import Rig, laser_parameters

DEPTHS_M = (0.2, 0.3, 0.5, 1.0)
"""Distances at which depth uncertainties are reported."""


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
    return Rig(camera=own, lasers=calibration.planes, covariance=calibration.covariance)


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
