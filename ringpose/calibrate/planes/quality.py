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
    """The same views by the paper's method; None if it is not applicable."""
    without_board: Sequence[tuple[str, str]] = ()
    """Names of the images that show no board, and the reasons."""


def calibrated_rig(calibration: PlanesCalibration) -> Rig:
    """The rig of camera and light planes; a joint covariance replaces the camera's own."""
    joint = calibration.covariance is not None
    own = replace(calibration.camera, covariance=None) if joint else calibration.camera
    return Rig(camera=own, lasers=calibration.planes, covariance=calibration.covariance)


def planes_quality(assessment: PlanesAssessment) -> Mapping[str, Any]:
    """The key `quality` of rig.yaml."""
    calibration = assessment.calibration
    neighbours = [
        {"lasers": [angle.first, angle.second], "angle_rad": angle.angle_rad, "sd_rad": angle.sd_rad}
        for angle in plane_angles(calibration)
    ]
    quality = {
        "verdict": verdict_values(assessment.verdict),
        "method": calibration.method,
        "standard_deviations": _standard_deviations(calibration),
        "variance_excess": float(calibration.excess),
        "lasers": [_laser_quality(laser) for laser in calibration.lasers],
        "angles": {"neighbours": neighbours} if neighbours else None,
        "depth_sd_m": _depths(calibration),
        "ring_center_sd_m": _ring_centers(calibration),
        "boards": [
            {"name": pose.name, "rms_px": pose.residual_rms_px, "distance_m": float(pose.translation_m[2])}
            for pose in calibration.poses
        ],
        "paper": _paper(assessment),
        "remarks": [
            {"name": name, "reason": reason} for name, reason in (*calibration.contradicting, *calibration.remarks)
        ],
        "without_board": [{"name": name, "reason": reason} for name, reason in assessment.without_board],
    }
    return {"quality": {key: value for key, value in quality.items() if value is not None}}


def _standard_deviations(calibration: PlanesCalibration) -> dict[str, float]:
    """Standard deviations of the light planes' parameters, by name."""
    covariance = calibration.covariance
    every = {} if covariance is None else covariance.standard_deviations
    return {name: value for name, value in every.items() if "." in name}


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


def _depths(calibration: PlanesCalibration) -> dict[str, Any] | None:
    """Largest standard deviation of depths along each stripe, by distance; NaN if it is outside the image."""
    if calibration.covariance is None:
        return None
    found = worst_depth_sd_m(calibrated_rig(calibration), DEPTHS_M)
    rows = zip(calibration.planes.names, found.tolist(), strict=True)
    return {"distances_m": list(DEPTHS_M), "lasers": [{"name": name, "depth_sd_m": row} for name, row in rows]}


def _ring_centers(calibration: PlanesCalibration) -> dict[str, Any] | None:
    """Standard deviations of a ring's centre by the calibration alone, along the camera's axes; NaN without stripes."""
    if calibration.covariance is None:
        return None
    rig = calibrated_rig(calibration)
    sd = [ring_center_sd_m(rig, distance_m).tolist() for distance_m in DEPTHS_M]
    return {"radii_m": list(RADII_M), "distances_m": list(DEPTHS_M), "sd_m": sd}


def _paper(assessment: PlanesAssessment) -> list[dict[str, Any]] | None:
    """Comparison with the planes by the paper's method; the offset is that of the centroid of a laser's points."""
    if assessment.paper is None:
        return None
    compared = []
    for own, other in zip(assessment.calibration.lasers, assessment.paper.lasers, strict=True):
        centroid = np.concatenate([view.points for view in own.views]).mean(axis=0)
        compared.append(
            {
                "name": own.name,
                "rms_m": other.rms_m,
                "held_out_rms_m": other.held_out_rms_m,
                "angle_rad": float(angle_between(own.normal, other.normal)),
                "offset_m": abs(float(centroid @ other.normal - other.distance_m)),
            }
        )
    return compared


def planes_summary(assessment: PlanesAssessment) -> list[str]:
    """The result of a calibration as lines of text."""
    calibration = assessment.calibration
    lines = [f"{name}: {reason}" for name, reason in calibration.remarks]
    deviations = _standard_deviations(calibration)
    for laser in calibration.lasers:
        lines += _laser_lines(laser, deviations)
    for angle in plane_angles(calibration):
        sd = f" ± {np.degrees(angle.sd_rad):.4f}" if np.isfinite(angle.sd_rad) else ""
        lines.append(f"{angle.first} to {angle.second}: {np.degrees(angle.angle_rad):.3f}{sd} deg")
    depths, centers = _depths(calibration), _ring_centers(calibration)
    for entry in depths["lasers"] if depths else []:
        text = _by_distance_text(DEPTHS_M, entry["depth_sd_m"])
        lines += [f"{entry['name']}: standard deviation of depths: {text}"] if text else []
    if centers and (text := _by_distance_text(DEPTHS_M, [max(sd) for sd in centers["sd_m"]])):
        lines.append(f"standard deviation of a ring's centre (radius {RADII_M[1]:g} m) by this calibration: {text}")
    for entry in _paper(assessment) or []:
        lines.append(
            f"{entry['name']}: by the paper's method held out {1e6 * entry['held_out_rms_m']:.0f} um, "
            f"{np.degrees(entry['angle_rad']):.4f} deg and {1e6 * entry['offset_m']:.0f} um away"
        )
    return lines + verdict_lines(assessment.verdict)


def _laser_lines(laser: LaserCalibration, deviations: Mapping[str, float]) -> list[str]:
    """A laser's residuals and standard deviations, and the held-out errors of its nearest and farthest view."""
    points = sum(len(view.points) for view in laser.views)
    line = f"{laser.name}: {points} points of {len(laser.views)} views, rms {1e6 * laser.rms_m:.0f} um"
    if np.isfinite(laser.held_out_rms_m):
        line += f", held out {1e6 * laser.held_out_rms_m:.0f} um"
    else:
        line += ", held out unknown (needs a third view)"
    if deviations:
        tilt = np.degrees(max(deviations[f"{laser.name}.tilt_1"], deviations[f"{laser.name}.tilt_2"]))
        line += f", tilt ± {tilt:.4f} deg, distance ± {1e6 * deviations[f'{laser.name}.distance']:.0f} um"
    views = sorted((view for view in laser.views if np.isfinite(view.held_out_rms_m)), key=lambda view: view.distance_m)
    if len(views) < 2:
        return [line]
    ends = ", ".join(
        f"{1e6 * view.held_out_rms_m:.0f} um at {view.distance_m:.2f} m ({view.name})" for view in (views[0], views[-1])
    )
    return [line, f"{laser.name}: held out {ends}"]


def _by_distance_text(distances_m: Sequence[float], sigmas_m: Sequence[float]) -> str:
    """The known standard deviations, as text; empty if none is known."""
    known = [(z, sd) for z, sd in zip(distances_m, sigmas_m, strict=True) if np.isfinite(sd)]
    return ", ".join(f"{1e3 * sd:.2f} mm at {z:g} m" for z, sd in known)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlaneAngle:
    """The angle between two neighbouring light planes."""

    first: str
    second: str
    angle_rad: float
    sd_rad: float
    """Standard deviation of the angle; NaN without covariance."""


def plane_angles(calibration: PlanesCalibration) -> list[PlaneAngle]:
    """Angles between neighbouring planes, in the order of the lasers; empty for one laser."""
    names, normals = calibration.planes.names, calibration.planes.normal
    return [
        PlaneAngle(
            first=names[first],
            second=names[first + 1],
            angle_rad=float(angle_between(normals[first], normals[first + 1])),
            sd_rad=_angle_sd_rad(calibration, first, first + 1),
        )
        for first in range(len(names) - 1)
    ]


def _angle_sd_rad(calibration: PlanesCalibration, first: int, second: int) -> float:
    """Standard deviation of the angle of two planes: a tilt of a normal towards the other reduces it by as much."""
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
