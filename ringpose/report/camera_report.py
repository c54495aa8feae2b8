"""A camera calibration as one HTML page."""

from collections.abc import Sequence

import numpy as np

from ringpose.calibrate.camera.parameters import parameters_of
from ringpose.calibrate.camera.quality import projection_sigma_m
from ringpose.report.camera_pictures import (
    comparison_picture,
    coverage_picture,
    residual_field,
    uncertainty_map,
    view_picture,
)
from ringpose.report.page import Section, Table, page
from ringpose.report.verdict_section import verdict_section
from ringpose.types.calibration import CameraAssessment, CameraCalibration, CameraView, ModelComparison
from ringpose.types.covariance import CAMERA_PARAMETERS
from ringpose.types.verdict import Verdict


def camera_report(
    calibration: CameraCalibration,
    assessment: CameraAssessment,
    verdict: Verdict,
    without_board: Sequence[tuple[str, str]] = (),
) -> str:
    """The page, whole; the last argument names the images that show no board, with the reason."""
    sections = [
        verdict_section(verdict),
        _parameters(calibration),
        _uncertainty(calibration, assessment),
        Section(title="Coverage", pictures=[coverage_picture(calibration, assessment)]),
        Section(title="Residuals", pictures=[residual_field(calibration)]),
        _views(calibration, assessment, without_board),
    ]
    if assessment.comparison is not None:
        sections.append(_comparison(calibration, assessment.comparison))
    return page(f"Calibration of {calibration.camera.camera_name or 'a camera'}", sections)


def _parameters(calibration: CameraCalibration) -> Section:
    camera, deviations = calibration.camera, calibration.standard_deviations
    rows = [
        [_with_unit(name), f"{value:.6g}", f"{deviation:.2g}" if deviation else "held"]
        for (name, deviation), value in zip(deviations.items(), parameters_of(camera).tolist(), strict=True)
    ]
    return Section(
        title=f"Camera: {camera.image_width} x {camera.image_height} pixels, {camera.distortion_model}",
        text=[
            f"{len(calibration.used)} of {len(calibration.views)} views, rms {calibration.rms_px:.4f} px, "
            f"standard deviation of a corner's coordinate {calibration.sigma_px:.4f} px."
        ],
        table=Table(headings=("parameter", "value", "standard deviation"), rows=rows),
    )


def _with_unit(parameter: str) -> str:
    return f"{parameter} (px)" if parameter in CAMERA_PARAMETERS[:4] else parameter


def _uncertainty(calibration: CameraCalibration, assessment: CameraAssessment) -> Section:
    sigmas_m = projection_sigma_m(calibration, assessment)
    return Section(
        title="Projection uncertainty",
        table=Table(
            headings=("distance", "median over the image"),
            rows=[[f"{d:g} m", f"{1e3 * s:.4f} mm"] for d, s in zip(assessment.distances_m, sigmas_m, strict=True)],
        ),
        pictures=[uncertainty_map(calibration, assessment)],
    )


def _views(
    calibration: CameraCalibration, assessment: CameraAssessment, without_board: Sequence[tuple[str, str]]
) -> Section:
    held = {view.name: view for view in assessment.validation.left_out}
    rows = [
        [*_view_row(view), f"{held[view.name].rms_px:.3f}" if view.name in held else "", view.rejected]
        for view in calibration.views
    ]
    rows += [[name, "", "", "", "", reason] for name, reason in without_board]
    headings = ("view", "corners", "left out", "rms (px)", "rms of the view left out (px)", "why it was not used")
    return Section(
        title="Views", table=Table(headings=headings, rows=rows), pictures=[view_picture(calibration, assessment)]
    )


def _view_row(view: CameraView) -> list[str]:
    return [
        view.name,
        str(len(view.left_out)),
        str(int(np.sum(view.left_out))),
        f"{view.pose.residual_rms_px:.3f}",
    ]


def _comparison(calibration: CameraCalibration, comparison: ModelComparison) -> Section:
    rows = [
        [
            fit.distortion_model,
            str(fit.parameters),
            f"{fit.rms_px:.4f}",
            f"{fit.held_out_rms_px:.4f}".replace("nan", "unknown"),
        ]
        for fit in comparison.fits
    ]
    return Section(
        title="Distortion models",
        table=Table(headings=("model", "parameters", "rms (px)", "rms of views left out (px)"), rows=rows),
        pictures=[comparison_picture(calibration, comparison)],
    )
