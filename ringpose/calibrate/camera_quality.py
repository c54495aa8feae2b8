"""What a camera calibration is worth, for the file and for the reader."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ringpose.calibrate.camera_outliers import CORNER_SIGMAS
from ringpose.calibrate.coverage import board_tilt_rad
from ringpose.calibrate.intrinsics import parameters_of
from ringpose.calibrate.verdict_text import verdict_lines, verdict_values
from ringpose.types.calibration import (
    CameraAssessment,
    CameraCalibration,
    CameraView,
    Coverage,
    CrossValidation,
    ModelComparison,
    ModelFit,
)
from ringpose.types.covariance import CAMERA_PARAMETERS
from ringpose.types.verdict import Verdict


def camera_quality(
    calibration: CameraCalibration,
    assessment: CameraAssessment,
    verdict: Verdict,
    without_board: Sequence[tuple[str, str]] = (),
) -> Mapping[str, Any]:
    """The keys `standard_deviations` and `quality` of camera.yaml."""
    quality: dict[str, Any] = {
        "verdict": verdict_values(verdict),
        "rms_px": calibration.rms_px,
        "corner_sigma_px": calibration.sigma_px,
        "views_used": len(calibration.used),
        "corners_left_out": sum(int(view.left_out.sum()) for view in calibration.used),
        "coverage": _coverage_values(assessment.coverage),
        "projection": _projection_values(calibration, assessment),
        "cross_validation": _validation_values(assessment.validation) | {"disagreement": assessment.disagreement},
    }
    if assessment.comparison is not None:
        quality["models"] = _model_values(assessment.comparison)
    quality["views"] = [_view_quality(view) for view in calibration.views]
    quality["without_board"] = [{"name": name, "reason": reason} for name, reason in without_board]
    return {"standard_deviations": calibration.standard_deviations, "quality": quality}


def camera_summary(calibration: CameraCalibration, assessment: CameraAssessment, verdict: Verdict) -> list[str]:
    """The same in lines to read."""
    lines = [f"{view.name}: left out: {view.rejected}" for view in calibration.views if view.rejected]
    lines += [_corner_line(view) for view in calibration.used if view.left_out.any()]
    lines.append(
        f"{len(calibration.used)} of {len(calibration.views)} views used, rms {calibration.rms_px:.3f} px, "
        f"corners {calibration.sigma_px:.3f} px"
    )
    lines += _parameter_lines(calibration)
    lines.append(_projection_line(calibration, assessment))
    if assessment.comparison is not None:
        lines += comparison_lines(assessment.comparison)
    return lines + verdict_lines(verdict)


def projection_sigma_m(calibration: CameraCalibration, assessment: CameraAssessment) -> list[float]:
    """Median projection uncertainty over the image, across the line of sight, at each of the distances."""
    matrix = calibration.camera.camera_matrix
    angle = float(np.median(assessment.known_sigma_px)) / float(np.sqrt(matrix[0, 0] * matrix[1, 1]))
    return [angle * distance_m for distance_m in assessment.distances_m]


def comparison_lines(comparison: ModelComparison) -> list[str]:
    """Both models, and which of them views that it has not seen speak for."""
    lines = [f"{fit.distortion_model}: rms {fit.rms_px:.4f} px{_held_out(fit)}" for fit in comparison.fits]
    difference = (
        f"median {np.median(comparison.difference_px):.3f} px, at most {np.max(comparison.difference_px):.2f} px"
    )
    lines.append(f"the models differ by {difference} over the image")
    if not any(np.isnan(fit.held_out_rms_px) for fit in comparison.fits):
        best = min(comparison.fits, key=lambda fit: fit.held_out_rms_px)
        lines[-1] += f"; views left out fit {best.distortion_model} best"
    return lines


def _held_out(fit: ModelFit) -> str:
    return "" if np.isnan(fit.held_out_rms_px) else f", {fit.held_out_rms_px:.4f} px on views left out"


def _corner_line(view: CameraView) -> str:
    off_px = np.linalg.norm(view.residual_px[view.left_out], axis=1)
    numbers = ", ".join(str(number) for number in view.ids[view.left_out])
    return (
        f"{view.name}: corners left out: {numbers}: more than {CORNER_SIGMAS:g} sigmas off, up to {off_px.max():.2f} px"
    )


def _parameter_lines(calibration: CameraCalibration) -> list[str]:
    camera, deviations = calibration.camera, calibration.standard_deviations
    values = dict(zip(deviations, parameters_of(camera).tolist(), strict=True))
    pinhole = ", ".join(f"{name} {values[name]:.2f} ± {deviations[name]:.2f}" for name in CAMERA_PARAMETERS[:4])
    bend = ", ".join(f"{name} {values[name]:.5f} ± {deviations[name]:.5f}" for name in list(values)[4:])
    return [f"{pinhole} px ({camera.image_width} x {camera.image_height})", f"{camera.distortion_model}: {bend}"]


def _projection_line(calibration: CameraCalibration, assessment: CameraAssessment) -> str:
    sigma_px = assessment.known_sigma_px
    share = assessment.unknown_share
    unknown = f", not known in {100 * share:.0f} % of the image" if share else ""
    millimetres = ", ".join(
        f"{1e3 * sigma_m:.3f} mm at {distance_m:g} m"
        for sigma_m, distance_m in zip(projection_sigma_m(calibration, assessment), assessment.distances_m, strict=True)
    )
    return (
        f"projection ± {np.median(sigma_px):.3f} px (median), {np.max(sigma_px):.3f} px (worst){unknown}: {millimetres}"
    )


def _coverage_values(covered: Coverage) -> dict[str, Any]:
    return {
        "share": covered.share,
        "corners": covered.corners,
        "bare_regions": list(covered.bare_regions),
        "tilt_rad": [min(covered.tilt_rad), max(covered.tilt_rad)],
        "tilt_spread_rad": list(covered.tilt_spread_rad),
        "distance_m": [min(covered.distance_m), max(covered.distance_m)],
    }


def _projection_values(calibration: CameraCalibration, assessment: CameraAssessment) -> dict[str, Any]:
    return {
        "sigma_px": float(np.median(assessment.known_sigma_px)),
        "sigma_worst_px": float(np.max(assessment.known_sigma_px)),
        "unknown_share": assessment.unknown_share,
        "distances_m": list(assessment.distances_m),
        "sigma_m": projection_sigma_m(calibration, assessment),
    }


def _validation_values(validation: CrossValidation) -> dict[str, Any]:
    return {
        "split_half_px": float(np.median(validation.split_half_px)),
        "left_out": [
            {"name": view.name, "shift_px": view.shift_px, "rms_px": view.rms_px} for view in validation.left_out
        ],
    }


def _model_values(comparison: ModelComparison) -> dict[str, Any]:
    return {
        "difference_px": [float(np.median(comparison.difference_px)), float(np.max(comparison.difference_px))],
        "fits": [
            {"distortion_model": fit.distortion_model, "rms_px": fit.rms_px, "held_out_rms_px": fit.held_out_rms_px}
            for fit in comparison.fits
        ],
    }


def _view_quality(view: CameraView) -> dict[str, Any]:
    lengths = np.linalg.norm(view.residual_px, axis=1)
    quality = {
        "name": view.name,
        "corners": len(lengths),
        "rms_px": view.pose.residual_rms_px,
        "worst_px": float(lengths.max()),
        "corners_left_out": [
            {"corner": int(number), "residual_px": residual}
            for number, residual in zip(view.ids[view.left_out], view.residual_px[view.left_out], strict=True)
        ],
        "distance_m": float(view.pose.translation_m[2]),
        "tilt_rad": board_tilt_rad(view.pose),
    }
    return quality | ({"rejected": view.rejected} if view.rejected else {})
