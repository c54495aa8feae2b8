"""Everything that a camera calibration is judged by, in one call."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringpose.calibrate.board_bow import bow_finding
from ringpose.calibrate.board_layout import marker_size_findings
from ringpose.calibrate.camera_model import CameraModel
from ringpose.calibrate.camera_solution import camera_solution
from ringpose.calibrate.coverage import coverage
from ringpose.calibrate.cross_validation import cross_validation, used_views
from ringpose.calibrate.distortion_models import model_comparison
from ringpose.calibrate.other_camera import other_camera_finding
from ringpose.calibrate.projection_map import image_map, known_lens, projection_sigma_px
from ringpose.types.board import BoardView
from ringpose.types.calibration import CameraAssessment, CameraCalibration

CHANCE = 2.5
"""A disagreement below 1 + this / sqrt(views - 1) is chance: of 80 sets of 8 and 15 views whose errors were noise
alone, one came above it."""

EXACT_PX = 1e-4
"""Less than this no camera is known to: corners are taken in single precision."""

DISTANCES_M = (0.2, 0.5, 1.0)
"""Where the projection uncertainty is given in metres, if nothing else is asked for."""


def camera_assessment(
    calibration: CameraCalibration,
    boards: Sequence[BoardView],
    model: CameraModel,
    distances_m: Sequence[float] = DISTANCES_M,
    compare: bool = False,
) -> CameraAssessment:
    """Coverage, uncertainty over the image, cross-validation; on request the other distortion model.

    The boards are those of all views, in their order.
    """
    where, used = image_map(calibration.camera), used_views(calibration, boards)
    whole = camera_solution(used, calibration.camera, model)
    validation = cross_validation(used, whole, model, where)
    corners_px = np.concatenate([view.points_px[~view.left_out] for view in calibration.used])
    known = known_lens(calibration.camera, corners_px, where)
    sigma_px = np.where(known, projection_sigma_px(calibration.camera, where), np.nan)
    disagreement = float(np.median(validation.jackknife_px[known]) / max(np.median(sigma_px[known]), EXACT_PX))
    return CameraAssessment(
        coverage=coverage(calibration, boards),
        image_map=where,
        sigma_px=sigma_px,
        validation=validation,
        disagreement=disagreement,
        distances_m=tuple(distances_m),
        comparison=model_comparison(used, whole, model, where) if compare else None,
        board=(
            other_camera_finding(calibration, boards),
            *marker_size_findings(boards),
            bow_finding(used, whole, model, _widening(disagreement, len(used))),
        ),
    )


def widened(calibration: CameraCalibration, assessment: CameraAssessment) -> tuple[CameraCalibration, CameraAssessment]:
    """Both with the covariance that the differences of the views ask for, where noise does not explain them.

    A board that is bent, moves or glares makes errors that the corners of a view have in common; the residuals do not
    show them, and each corner counts as if it were independent. Views are.
    """
    covariance = calibration.camera.covariance
    widening = _widening(assessment.disagreement, len(calibration.used))
    if covariance is None or widening == 1:
        return calibration, assessment
    camera = replace(calibration.camera, covariance=replace(covariance, data=widening**2 * covariance.data))
    return replace(calibration, camera=camera), replace(assessment, sigma_px=widening * assessment.sigma_px)


def _widening(disagreement: float, views: int) -> float:
    """Factor of the standard deviations; one where views disagree by chance, or are too few to tell."""
    return disagreement if disagreement > 1 + CHANCE / np.sqrt(views - 1) else 1.0
