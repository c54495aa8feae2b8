"""What a calibration of the light planes is worth, for the file and for the reader."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from ringpose.geometry.rotations import angle_between
from ringpose.types.calibration import LaserCalibration, PlanesCalibration
from ringpose.types.rig import Rig


def calibrated_rig(calibration: PlanesCalibration) -> Rig:
    """The rig of camera and light planes; the joint covariance, where there is one, holds the camera's too."""
    joint = calibration.covariance is not None
    own = replace(calibration.camera, covariance=None) if joint else calibration.camera
    return Rig(camera=own, lasers=calibration.planes, covariance=calibration.covariance)


def planes_quality(calibration: PlanesCalibration, without_board: Sequence[tuple[str, str]] = ()) -> Mapping[str, Any]:
    """The key `quality` of rig.yaml."""
    return {
        "quality": {
            "method": calibration.method,
            "standard_deviations": _standard_deviations(calibration),
            "lasers": [_laser_quality(laser) for laser in calibration.lasers],
            "boards": [
                {"name": pose.name, "rms_px": pose.residual_rms_px, "distance_m": float(pose.translation_m[2])}
                for pose in calibration.poses
            ],
            "remarks": [{"name": name, "reason": reason} for name, reason in calibration.remarks],
            "without_board": [{"name": name, "reason": reason} for name, reason in without_board],
        },
    }


def planes_summary(calibration: PlanesCalibration) -> list[str]:
    """The same in lines to read."""
    lines = [f"{name}: {reason}" for name, reason in calibration.remarks]
    deviations = _standard_deviations(calibration)
    for laser in calibration.lasers:
        points = sum(len(view.points) for view in laser.views)
        line = f"{laser.name}: {points} points of {len(laser.views)} views, rms {1e6 * laser.rms_m:.0f} um"
        if np.isfinite(laser.held_out_rms_m):
            line += f", held out {1e6 * laser.held_out_rms_m:.0f} um"
        else:
            line += ", held out unknown (a third view would tell)"
        if deviations:
            tilt = np.degrees(max(deviations[f"{laser.name}.tilt_1"], deviations[f"{laser.name}.tilt_2"]))
            line += f", tilt ± {tilt:.4f} deg, distance ± {1e6 * deviations[f'{laser.name}.distance']:.0f} um"
        lines.append(line)
        lines += _by_distance(laser)
    return lines + _angles(calibration)


def _by_distance(laser: LaserCalibration) -> list[str]:
    """Held-out errors of a laser's nearest and farthest view."""
    views = sorted((view for view in laser.views if np.isfinite(view.held_out_rms_m)), key=lambda view: view.distance_m)
    if len(views) < 2:
        return []
    ends = ", ".join(
        f"{1e6 * v.held_out_rms_m:.0f} um at {v.distance_m:.2f} m ({v.name})" for v in (views[0], views[-1])
    )
    return [f"{laser.name}: held out {ends}"]


def _angles(calibration: PlanesCalibration) -> list[str]:
    """Angles between neighbouring light planes."""
    lasers = calibration.lasers
    return [
        f"{first.name} to {second.name}: {np.degrees(float(angle_between(first.normal, second.normal))):.3f} deg"
        for first, second in pairwise(lasers)
    ]


def _standard_deviations(calibration: PlanesCalibration) -> dict[str, float]:
    """Of the light planes' parameters."""
    covariance = calibration.covariance
    every = {} if covariance is None else covariance.standard_deviations
    return {name: value for name, value in every.items() if "." in name}


def _laser_quality(laser: LaserCalibration) -> dict[str, Any]:
    return {
        "name": laser.name,
        "rms_m": laser.rms_m,
        "held_out_rms_m": laser.held_out_rms_m,
        "condition": laser.condition,
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
