"""Quality of a camera calibration: values for the file, summary for the user, verdict with advice."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from math import degrees
from typing import Any

import numpy as np

from ringpose.calibrate.acceptance import CAMERA_LIMITS, check, verdict_lines, verdict_values
from ringpose.calibrate.camera.assessment import board_tilt_rad, different_poses
from ringpose.calibrate.camera.outliers import CORNER_SIGMAS
from ringpose.calibrate.camera.parameters import parameters_of
from ringpose.calibrate.camera.validation import map_points_px
from ringpose.types.calibration import (
    CameraAssessment,
    CameraCalibration,
    CameraView,
    Check,
    Coverage,
    LeftOutView,
    ModelComparison,
    Verdict,
)
from ringpose.types.rig import CAMERA_PARAMETERS

MIN_VIEWS_OFF = 3
"""Views in which a corner must be off for a fault of the print: in one or two, glare or dirt may cover it."""


def camera_quality(
    assessment: CameraAssessment, verdict: Verdict, without_board: Sequence[tuple[str, str]] = ()
) -> Mapping[str, Any]:
    """The keys `standard_deviations` and `quality` of camera.yaml."""
    calibration = assessment.calibration
    covered, comparison = assessment.coverage, assessment.comparison
    quality: dict[str, Any] = {
        "verdict": verdict_values(verdict),
        "rms_px": calibration.rms_px,
        "corner_sigma_px": calibration.sigma_px,
        "views_used": len(calibration.used),
        "corners_left_out": sum(int(view.left_out.sum()) for view in calibration.used),
        "coverage": {
            "share": covered.share,
            "corners": covered.corners,
            "bare_regions": list(covered.bare_regions),
            "tilt_rad": [min(covered.tilt_rad), max(covered.tilt_rad)],
            "tilt_spread_rad": list(covered.tilt_spread_rad),
            "distance_m": [min(covered.distance_m), max(covered.distance_m)],
        },
        "projection": {
            "sigma_px": float(np.median(assessment.known_sigma_px)),
            "sigma_worst_px": float(np.max(assessment.known_sigma_px)),
            "unknown_share": assessment.unknown_share,
            "distances_m": list(assessment.distances_m),
            "sigma_m": projection_sigma_m(assessment),
        },
        "cross_validation": {
            "split_half_px": float(np.median(assessment.split_half_px)),
            "left_out": [asdict(view) for view in assessment.left_out],
            "disagreement": assessment.disagreement,
        },
    }
    if comparison is not None:
        difference_px = [float(np.nanmedian(comparison.difference_px)), float(np.nanmax(comparison.difference_px))]
        fits = [{key: value for key, value in asdict(fit).items() if key != "parameters"} for fit in comparison.fits]
        quality["models"] = {"difference_px": difference_px, "fits": fits}
    quality["views"] = [_view_quality(view) for view in calibration.views]
    quality["without_board"] = [{"name": name, "reason": reason} for name, reason in without_board]
    return {"standard_deviations": calibration.standard_deviations, "quality": quality}


def _view_quality(view: CameraView) -> dict[str, Any]:
    """One entry of the key `quality.views`."""
    lengths = np.linalg.norm(view.residual_px, axis=1)
    quality = {
        "name": view.name,
        "corners": len(lengths),
        "rms_px": view.pose.residual_rms_px,
        "worst_px": float(lengths.max()),
        "corners_left_out": [
            {"corner": int(number), "residual_px": residual}
            for number, residual in zip(view.board.ids[view.left_out], view.residual_px[view.left_out], strict=True)
        ],
        "distance_m": float(view.pose.translation_m[2]),
        "tilt_rad": board_tilt_rad(view.pose),
    }
    return quality | ({"rejected": view.rejected} if view.rejected else {})


def projection_sigma_m(assessment: CameraAssessment) -> list[float]:
    """Projection uncertainty in metres across the line of sight, median over the image, at each of the distances."""
    matrix = assessment.calibration.camera.camera_matrix
    angle = float(np.median(assessment.known_sigma_px)) / float(np.sqrt(matrix[0, 0] * matrix[1, 1]))
    return [angle * distance_m for distance_m in assessment.distances_m]


def camera_summary(assessment: CameraAssessment, verdict: Verdict) -> list[str]:
    """The result of a calibration as lines of text."""
    calibration = assessment.calibration
    lines = [f"{view.name}: left out: {view.rejected}" for view in calibration.views if view.rejected]
    lines += _left_out_lines(calibration)
    lines.append(
        f"{len(calibration.used)} of {len(calibration.views)} views used, rms {calibration.rms_px:.3f} px, "
        f"corners {calibration.sigma_px:.3f} px"
    )
    lines.append(_scale_line(assessment))
    camera, deviations = calibration.camera, calibration.standard_deviations
    values = dict(zip(deviations, parameters_of(camera).tolist(), strict=True))
    pinhole = ", ".join(f"{name} {values[name]:.2f} ± {deviations[name]:.2f}" for name in CAMERA_PARAMETERS[:4])
    distortion = ", ".join(f"{name} {values[name]:.5f} ± {deviations[name]:.5f}" for name in list(values)[4:])
    lines.append(f"{pinhole} px ({camera.image_width} x {camera.image_height})")
    lines.append(f"{camera.distortion_model}: {distortion}")
    sigma_px, share = assessment.known_sigma_px, assessment.unknown_share
    unknown = f", not known in {100 * share:.0f} % of the image" if share else ""
    sigmas_m = zip(projection_sigma_m(assessment), assessment.distances_m, strict=True)
    millimetres = ", ".join(f"{1e3 * sigma_m:.3f} mm at {distance_m:g} m" for sigma_m, distance_m in sigmas_m)
    pixels = f"{np.median(sigma_px):.3f} px (median), {np.max(sigma_px):.3f} px (worst)"
    lines.append(f"projection ± {pixels}{unknown}: {millimetres}")
    if assessment.comparison is not None:
        lines += _comparison_lines(assessment.comparison)
    return lines + verdict_lines(verdict)


def _scale_line(assessment: CameraAssessment) -> str:
    """Size and distances of the board as they follow from its given sizes: no residual shows a wrong scale."""
    corners_m = np.concatenate([view.board.points_board_m for view in assessment.calibration.views])
    width_m, height_m = np.ptp(corners_m[:, :2], axis=0)
    near_m, far_m = min(assessment.coverage.distance_m), max(assessment.coverage.distance_m)
    size = f"{1e3 * width_m:.1f} x {1e3 * height_m:.1f} mm from the first to the last corner"
    return f"the board as given: {size}, seen from {near_m:.3g} to {far_m:.3g} m; measure both"


def _left_out_lines(calibration: CameraCalibration) -> list[str]:
    """The corners left out: those that are off in most of the views in one line, then the others by view."""
    used, focal_px = calibration.used, float(calibration.camera.camera_matrix[0, 0])
    shown = np.concatenate([view.board.ids for view in used])
    off = np.concatenate([view.left_out for view in used])
    lengths_m = [np.linalg.norm(view.residual_px, axis=1) * view.pose.translation_m[2] / focal_px for view in used]
    shift_m = np.concatenate(lengths_m)
    lines, printed = [], []
    for number in np.unique(shown[off]):
        views, out = int(np.sum(shown == number)), int(np.sum(off[shown == number]))
        if out >= MIN_VIEWS_OFF and 2 * out > views:
            shift_mm = 1e3 * np.median(shift_m[off & (shown == number)])
            lines.append(f"corner {number} is off in {out} of {views} views, by {shift_mm:.2f} mm: see the print there")
            printed.append(number)
    for view in used:
        left_out = view.left_out & ~np.isin(view.board.ids, printed)
        if left_out.any():
            numbers = ", ".join(str(number) for number in view.board.ids[left_out])
            far_px = np.linalg.norm(view.residual_px[left_out], axis=1).max()
            finding = f"more than {CORNER_SIGMAS:g} sigmas off, up to {far_px:.2f} px"
            lines.append(f"{view.name}: corners left out: {numbers}: {finding}")
    return lines


def _comparison_lines(comparison: ModelComparison) -> list[str]:
    """Both distortion models, and which of them fits held-out views better."""
    lines = []
    for fit in comparison.fits:
        held_out = "" if np.isnan(fit.held_out_rms_px) else f", {fit.held_out_rms_px:.4f} px on views left out"
        lines.append(f"{fit.distortion_model}: rms {fit.rms_px:.4f} px{held_out}")
    median_px, most_px = np.nanmedian(comparison.difference_px), np.nanmax(comparison.difference_px)
    share = np.isfinite(comparison.difference_px).mean()
    where = "the image" if share == 1 else f"the {100 * share:.0f} % of the image that the corners reach"
    difference = f"the models differ by median {median_px:.3f} px, at most {most_px:.2f} px over {where}"
    if not any(np.isnan(fit.held_out_rms_px) for fit in comparison.fits):
        best = min(comparison.fits, key=lambda fit: fit.held_out_rms_px)
        difference += f"; views left out fit {best.distortion_model} best"
    return [*lines, difference]


def camera_verdict(assessment: CameraAssessment, images: int) -> Verdict:
    """Grade (good, can be improved, redo) and checks of the calibration; `images` is the number of input images."""
    return Verdict(
        findings=(
            *_view_findings(assessment.calibration, images),
            *assessment.board,
            *_coverage_findings(assessment.coverage),
            *_uncertainty_findings(assessment),
            *_validation_findings(assessment),
        )
    )


def _view_findings(calibration: CameraCalibration, images: int) -> list[Check]:
    """Checks of the number of views and of the accuracy of their corners."""
    used, different = len(calibration.used), different_poses([view.pose for view in calibration.used])
    number = check(CAMERA_LIMITS, "views_used", float(different), used=used)
    if different < used:
        same = f"only {different} of the {used} views differ: move or tilt the board before each of ten or more"
        number = replace(number, advice=same)
    worst = max(calibration.used, key=lambda view: view.pose.residual_rms_px).name
    return [
        number,
        check(CAMERA_LIMITS, "images_used_share", used / max(images, used)),
        check(CAMERA_LIMITS, "corner_sigma_px", calibration.sigma_px, worst=worst),
    ]


def _coverage_findings(covered: Coverage) -> list[Check]:
    """Checks of the corners' distribution over the image and of the boards' tilts and distances."""
    bare, distances, tilt_rad = covered.bare_regions, covered.distance_m, max(covered.tilt_rad)
    regions = ", ".join(bare[:-1]) + " and " + bare[-1] if len(bare) > 1 else "".join(bare)
    ratio = max(distances) / min(distances)
    return [
        check(CAMERA_LIMITS, "coverage_share", covered.share),
        check(CAMERA_LIMITS, "bare_regions", float(len(bare)), regions=regions),
        check(CAMERA_LIMITS, "largest_tilt_rad", tilt_rad, tilt_deg=degrees(tilt_rad)),
        check(CAMERA_LIMITS, "tilt_spread_across_rad", covered.tilt_spread_rad[1]),
        check(CAMERA_LIMITS, "distance_ratio", ratio, distance_m=np.mean(distances)),
    ]


def _uncertainty_findings(assessment: CameraAssessment) -> list[Check]:
    """Checks of the focal length's and the projection's standard deviations.

    More views do not help where a bow of the board causes most of the projection's variance: then its advice is given.
    """
    calibration = assessment.calibration
    sigma_px, deviations = assessment.sigma_px, calibration.standard_deviations
    x, y = map_points_px(calibration.camera)[np.unravel_index(int(np.nanargmax(sigma_px)), sigma_px.shape)]
    focal_share = deviations["fx"] / float(calibration.camera.camera_matrix[0, 0])
    or_hold = ", or hold k3 (--fix-k3)" if deviations["k3"] else ""
    checks = [
        check(CAMERA_LIMITS, "focal_sigma_share", focal_share),
        check(CAMERA_LIMITS, "projection_sigma_px", float(np.nanmedian(sigma_px))),
        check(CAMERA_LIMITS, "projection_sigma_worst_px", float(np.nanmax(sigma_px)), x=x, y=y, or_hold=or_hold),
        check(CAMERA_LIMITS, "projection_unknown_share", assessment.unknown_share),
    ]
    if 2 * assessment.bow_sigma_px**2 <= float(np.nanmedian(sigma_px)) ** 2:
        return checks
    flatten = next(each.advice for each in assessment.board if each.name == "bow_sigmas")
    return [replace(each, advice=flatten) for each in checks[:3]] + checks[3:]


def _validation_findings(assessment: CameraAssessment) -> list[Check]:
    """Checks of the agreement of the views and, where they were compared, of the distortion models."""
    unknown = LeftOutView(name="", shift_px=np.nan, rms_px=np.nan)
    view = max(assessment.left_out, key=lambda view: view.shift_px, default=unknown)
    half_px = abs(float(assessment.half_difference[0]))
    checks = [
        check(CAMERA_LIMITS, "view_disagreement", assessment.disagreement),
        check(CAMERA_LIMITS, "leave_one_out_px", view.shift_px, view.name),
        check(CAMERA_LIMITS, "split_half_px", float(np.median(assessment.split_half_px)), fx_px=half_px),
    ]
    if assessment.comparison is not None:
        own, other = assessment.comparison.fits
        ratio = own.held_out_rms_px / other.held_out_rms_px
        checks.append(check(CAMERA_LIMITS, "held_out_ratio", ratio, other=other.distortion_model))
    return checks
