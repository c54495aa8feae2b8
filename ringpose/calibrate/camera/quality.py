"""Quality of a camera calibration: values for the file, summary for the user, verdict with limits and advice.

The limits are those of a camera that measures to 0.1 mm at 0.5 m (0.2 to 0.4 px) with boards of some dozens of corners.
"""

from collections.abc import Mapping, Sequence
from math import degrees, inf, radians
from typing import Any

import numpy as np

from ringpose.calibrate.camera.assessment import board_tilt_rad, different_poses
from ringpose.calibrate.camera.outliers import CORNER_SIGMAS
from ringpose.calibrate.camera.parameters import parameters_of
from ringpose.calibrate.verdict_text import verdict_lines, verdict_values
from ringpose.types.calibration import (
    CameraAssessment,
    CameraCalibration,
    CameraView,
    Coverage,
    CrossValidation,
    LeftOutView,
    ModelComparison,
    ModelFit,
)
from ringpose.types.covariance import CAMERA_PARAMETERS
from ringpose.types.verdict import Check, Verdict


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
    """The summary for the user, one string per line."""
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
    """Both distortion models, and which of them fits held-out views better."""
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


FRONTAL_RAD = radians(10)
"""Boards tilted by less do not separate focal length from distance."""

_DISAGREEMENT = (
    "the views disagree by more than their noise: check that the board is flat and its sizes are true, "
    "that all images are one camera's, its focus and zoom fixed, and that no glare or cable is taken for a corner"
)


def camera_verdict(calibration: CameraCalibration, assessment: CameraAssessment, images: int) -> Verdict:
    """The verdict; `images` is the number of input images."""
    return Verdict(
        findings=(
            *_view_findings(calibration, images),
            *assessment.board,
            *_coverage_findings(assessment.coverage),
            *_placing_findings(assessment.coverage),
            *_uncertainty_findings(calibration, assessment),
            *_validation_findings(assessment),
            *_model_findings(assessment.comparison),
        )
    )


def _view_findings(calibration: CameraCalibration, images: int) -> list[Check]:
    used, different = len(calibration.used), different_poses([view.pose for view in calibration.used])
    loudest = max(calibration.used, key=lambda view: view.pose.residual_rms_px)
    return [
        Check(
            name="views_used",
            value=float(different),
            pass_limit=10.0,
            fail_limit=4.0,
            advice=_more_views(used, different),
        ),
        Check(
            name="images_used_share",
            value=used / max(images, used),
            pass_limit=0.8,
            fail_limit=0.5,
            advice="many images were of no use: the reasons stand beside their names",
        ),
        Check(
            name="corner_sigma_px",
            value=calibration.sigma_px,
            pass_limit=0.3,
            fail_limit=1.5,
            advice=f"the corners are inexact ({loudest.name} most): focus, more light, a flat board held still",
        ),
    ]


def _more_views(used: int, different: int) -> str:
    if different < used:
        return f"only {different} of the {used} views differ: move or tilt the board before each of ten or more"
    return f"only {used} views were used: take ten or more"


def _coverage_findings(covered: Coverage) -> list[Check]:
    return [
        Check(
            name="coverage_share",
            value=covered.share,
            pass_limit=0.6,
            fail_limit=0.25,
            advice="the corners cover little of the image: bring the board to its rims, or nearer",
        ),
        Check(
            name="bare_regions",
            value=float(len(covered.bare_regions)),
            pass_limit=0.0,
            fail_limit=6.0,
            advice=f"hardly any corners in the {_listed(covered.bare_regions)}: add a view with the board there",
        ),
    ]


def _placing_findings(covered: Coverage) -> list[Check]:
    largest, distances = max(covered.tilt_rad), covered.distance_m
    return [
        Check(
            name="largest_tilt_rad",
            value=largest,
            pass_limit=radians(20),
            fail_limit=FRONTAL_RAD,
            advice=f"all boards are within {degrees(largest):.0f} degrees of frontal: tilt the board by 20 to 40",
        ),
        Check(
            name="tilt_spread_across_rad",
            value=covered.tilt_spread_rad[1],
            pass_limit=radians(4),
            fail_limit=-inf,
            advice="the boards are tilted about one axis only: tilt the board the other way too",
        ),
        Check(
            name="distance_ratio",
            value=max(distances) / min(distances),
            pass_limit=1.2,
            fail_limit=-inf,
            advice=f"one distance only ({np.mean(distances):.2f} m): add views nearer and farther",
        ),
    ]


def _uncertainty_findings(calibration: CameraCalibration, assessment: CameraAssessment) -> list[Check]:
    sigma_px, where = assessment.sigma_px, assessment.image_map.points_px
    x, y = where[np.unravel_index(int(np.nanargmax(sigma_px)), sigma_px.shape)]
    other_way = ", or hold k3 (--fix-k3)" if calibration.standard_deviations["k3"] else ""
    return [
        Check(
            name="focal_sigma_share",
            value=calibration.standard_deviations["fx"] / float(calibration.camera.camera_matrix[0, 0]),
            pass_limit=0.002,
            fail_limit=0.02,
            advice="the focal length is uncertain: tilt the board more, and take it nearer and farther",
        ),
        Check(
            name="projection_sigma_px",
            value=float(np.nanmedian(sigma_px)),
            pass_limit=0.3,
            fail_limit=5.0,
            advice="the projection is uncertain: add views, tilted to different sides, in every part of the image",
        ),
        Check(
            name="projection_sigma_worst_px",
            value=float(np.nanmax(sigma_px)),
            pass_limit=1.0,
            fail_limit=inf,
            advice=f"the projection is most uncertain near pixel ({x:.0f}, {y:.0f}): bring the board there{other_way}",
        ),
        Check(
            name="projection_unknown_share",
            value=assessment.unknown_share,
            pass_limit=0.05,
            fail_limit=inf,
            advice="beyond the outermost corners nothing is known of this distortion model, whatever the covariance "
            "says: bring the board to the image's corners, or use --distortion-model plumb_bob",
        ),
    ]


def _validation_findings(assessment: CameraAssessment) -> list[Check]:
    worst = _worst(assessment.validation.left_out)
    halves_px = float(np.median(assessment.validation.split_half_px))
    return [
        Check(
            name="view_disagreement",
            value=assessment.disagreement,
            pass_limit=2.5,
            fail_limit=15.0,
            advice=_if_known(assessment.disagreement, _DISAGREEMENT),
        ),
        Check(
            name="leave_one_out_px",
            value=worst.shift_px,
            pass_limit=1.0,
            fail_limit=inf,
            place=worst.name,
            advice=_if_known(worst.shift_px, f"the result hangs on {worst.name}: add views like it, or leave it out"),
        ),
        Check(
            name="split_half_px",
            value=halves_px,
            pass_limit=1.0,
            fail_limit=inf,
            advice=_if_known(halves_px, "half of the views give another camera than the rest: add views of every kind"),
        ),
    ]


def _model_findings(comparison: ModelComparison | None) -> list[Check]:
    if comparison is None:
        return []
    own, other = comparison.fits
    ratio = own.held_out_rms_px / other.held_out_rms_px
    return [
        Check(
            name="held_out_ratio",
            value=ratio,
            pass_limit=1.05,
            fail_limit=inf,
            advice=_if_known(
                ratio, f"views left out fit another model better: use --distortion-model {other.distortion_model}"
            ),
        )
    ]


def _if_known(value: float, advice: str) -> str:
    """The advice, or none if too few views leave the value unknown: another check reports that."""
    return "" if np.isnan(value) else advice


def _worst(left_out: Sequence[LeftOutView]) -> LeftOutView:
    """The view with the largest influence on the result; NaN if no view was left out."""
    return max(left_out, key=lambda view: view.shift_px, default=LeftOutView(name="", shift_px=np.nan, rms_px=np.nan))


def _listed(words: Sequence[str]) -> str:
    return ", ".join(words[:-1]) + " and " + words[-1] if len(words) > 1 else "".join(words)
