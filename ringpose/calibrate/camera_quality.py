"""What a camera calibration is worth, for the file and for the reader."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ringpose.geometry.rotations import angle_between
from ringpose.types.board import BoardPose
from ringpose.types.calibration import CameraCalibration, CameraView


def camera_quality(calibration: CameraCalibration, without_board: Sequence[tuple[str, str]] = ()) -> Mapping[str, Any]:
    """The keys `standard_deviations` and `quality` of camera.yaml."""
    return {
        "standard_deviations": calibration.standard_deviations,
        "quality": {
            "rms_px": calibration.rms_px,
            "corner_sigma_px": calibration.sigma_px,
            "views_used": len(calibration.used),
            "views": [_view_quality(view) for view in calibration.views],
            "without_board": [{"name": name, "reason": reason} for name, reason in without_board],
        },
    }


def camera_summary(calibration: CameraCalibration) -> list[str]:
    """The same in lines to read."""
    camera, deviations = calibration.camera, calibration.standard_deviations
    values = dict(zip(deviations, _values(calibration), strict=True))
    lines = [f"{view.name}: left out: {view.rejected}" for view in calibration.views if view.rejected]
    lines.append(
        f"{len(calibration.used)} of {len(calibration.views)} views used, rms {calibration.rms_px:.3f} px, "
        f"corners {calibration.sigma_px:.3f} px"
    )
    pinhole = ", ".join(f"{name} {values[name]:.2f} ± {deviations[name]:.2f}" for name in ("fx", "fy", "cx", "cy"))
    lines.append(f"{pinhole} px ({camera.image_width} x {camera.image_height})")
    lines.append(
        f"{camera.distortion_model}: "
        + ", ".join(f"{name} {values[name]:.5f} ± {deviations[name]:.5f}" for name in list(values)[4:])
    )
    return lines


def tilt_rad(pose: BoardPose) -> float:
    """Angle between the board's normal and the line of sight to its origin; zero if it faces the camera."""
    return float(angle_between(pose.rotation[:, 2], pose.translation_m))


def _values(calibration: CameraCalibration) -> list[float]:
    matrix = calibration.camera.camera_matrix
    pinhole = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]
    return [float(value) for value in (*pinhole, *calibration.camera.distortion_coefficients)]


def _view_quality(view: CameraView) -> dict[str, Any]:
    lengths = np.linalg.norm(view.residual_px, axis=1)
    quality = {
        "name": view.name,
        "corners": len(lengths),
        "rms_px": view.pose.residual_rms_px,
        "worst_px": float(lengths.max()),
        "distance_m": float(view.pose.translation_m[2]),
        "tilt_rad": tilt_rad(view.pose),
    }
    return quality | ({"rejected": view.rejected} if view.rejected else {})
