"""Camera calibration: intrinsic parameters and their covariance from views of a board, with outlier rejection."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ringpose.calibrate.acceptance import CAMERA_LIMITS, check
from ringpose.calibrate.boards.corner_errors import without_distortion_bias
from ringpose.calibrate.boards.pose import board_pose, residuals
from ringpose.calibrate.camera import bundle_adjustment, outliers
from ringpose.calibrate.camera.assessment import DISTANCES_M, camera_assessment
from ringpose.calibrate.camera.parameters import PLUMB_BOB, CameraModel, parameter_names
from ringpose.calibrate.camera.validation import radial_stretch_sd
from ringpose.errors import DataError
from ringpose.geometry.least_squares import covariance_of_free
from ringpose.geometry.rays import fold_px
from ringpose.types.arrays import Array, Bool
from ringpose.types.board import BoardView, BoardViews
from ringpose.types.calibration import CameraAssessment, CameraCalibration, CameraView, Check, Grade
from ringpose.types.rig import Camera, ParameterCovariance

MAX_FOCAL_SHARE = 0.1
"""Relative standard deviation of the focal length above which the views do not determine it."""

_MAX_ITERATIONS = 5


def assessed_camera(
    boards: BoardViews,
    model: CameraModel = PLUMB_BOB,
    camera_name: str = "camera",
    distances_m: Sequence[float] = DISTANCES_M,
    compare: bool = False,
) -> CameraAssessment:
    """The camera of views of a board, with its covariance as the agreement of the views justifies it.

    k3 is held at zero, and a check of the assessment states so, if the views do not determine it: if its standard
    deviation by the corners' noise, or by the disagreement of the views, leaves the image's corners unknown, or if the
    lens would fold the image. Where the lens without k3 folds the image, a free k3 is the only usable one.
    """

    def calibrated(model: CameraModel) -> CameraCalibration:
        return calibrate_camera(boards.views, boards.image_width, boards.image_height, model, camera_name)

    def assessed(calibration: CameraCalibration, model: CameraModel) -> CameraAssessment:
        return camera_assessment(calibration, model, distances_m, compare)

    if model.fix_k3:
        return assessed(calibrated(model), model)
    fixed = replace(model, fix_k3=True)
    try:
        free = calibrated(model)
    except DataError:
        return assessed(calibrated(fixed), fixed)
    undetermined = undetermined_k3(free.camera)
    whole = None if undetermined else assessed(free, model)
    if whole is not None and not (undetermined := undetermined_k3(whole.calibration.camera)):
        return whole
    with suppress(DataError):
        held = calibrated(fixed)
        if fold_px(held.camera) is None or fold_px(free.camera) is not None:
            found = assessed(held, fixed)
            return replace(found, board=(*found.board, *undetermined))
    return whole or assessed(free, model)


def undetermined_k3(camera: Camera) -> tuple[Check, ...]:
    """The checks by which a camera's k3 is not determined: its standard deviation, and an image that it folds."""
    assert camera.covariance is not None
    k3_sd = camera.covariance.standard_deviations["k3"]
    checks = [check(CAMERA_LIMITS, "radial_stretch_sd", radial_stretch_sd(camera), k3_sd=k3_sd)]
    if (at_px := fold_px(camera)) is not None:
        principal = camera.camera_matrix[:2, 2]
        last = np.array([camera.image_width - 1.0, camera.image_height - 1.0])
        corner_px = float(np.linalg.norm(np.maximum(principal, last - principal)))
        inside = 1.0 - float(np.linalg.norm(at_px - principal)) / corner_px
        checks.append(check(CAMERA_LIMITS, "folded_share", inside, x=at_px[0], y=at_px[1]))
    return tuple(each for each in checks if each.grade is not Grade.GOOD)


def calibrate_camera(
    views: Sequence[BoardView],
    image_width: int,
    image_height: int,
    model: CameraModel = PLUMB_BOB,
    camera_name: str = "camera",
) -> CameraCalibration:
    """The camera of the views by maximum likelihood, with covariance and the residuals of each view.

    The worst view is rejected until none is an outlier; then single outlying corners are left out.
    """
    blank = bundle_adjustment.blank_camera(camera_name, image_width, image_height, model)
    camera, rejected = _without_bad_views(views, blank, model)
    used = [view for index, view in enumerate(views) if index not in rejected]
    camera, left_out = _without_bad_corners(used, camera, model)
    usual_px = float(np.median([board_pose(view, camera).residual_rms_px for view in used]))
    masks = iter(left_out)
    camera_views = []
    for index, view in enumerate(views):
        if index not in rejected:
            camera_views.append(_camera_view(view, next(masks), camera, ""))
            continue
        reason = "; ".join(filter(None, (rejected[index], outliers.view_explanation(view, camera, usual_px))))
        camera_views.append(_camera_view(view, np.zeros(len(view.ids), dtype=bool), camera, reason))

    kept = [bundle_adjustment.corners_of(view, ~mask) for view, mask in zip(used, left_out, strict=True)]
    solution = bundle_adjustment.camera_solution(kept, camera, model)
    errors = np.concatenate([view.residual_px[~view.left_out] for view in camera_views if not view.rejected])
    return CameraCalibration(
        camera=replace(solution.camera, covariance=_covariance(solution, model)),
        rms_px=float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))),
        sigma_px=solution.sigma_px,
        views=tuple(camera_views),
    )


def _without_bad_views(views: Sequence[BoardView], blank: Camera, model: CameraModel) -> tuple[Camera, dict[int, str]]:
    """The camera of the consistent views, and the reason for each rejected view by its index."""
    used = list(range(len(views)))
    rejected: dict[int, str] = {}
    while True:
        camera = bundle_adjustment.camera_solution([views[index] for index in used], blank, model).camera
        poses = [board_pose(views[index], camera) for index in used]
        outlier = None if model.keep_all else outliers.outlying_view(poses)
        if outlier is None or len(rejected) + 1 > outliers.MAX_VIEW_SHARE * len(views):
            return camera, rejected
        worst, reason = outlier
        rejected[used.pop(worst)] = reason


def _without_bad_corners(
    views: Sequence[BoardView], camera: Camera, model: CameraModel
) -> tuple[Camera, list[Bool[Array, "_"]]]:
    """The camera without outlying corners, and their mask in each view; all are tested again after each solution."""
    left_out = [np.zeros(len(view.ids), dtype=bool) for view in views]
    for _ in range(0 if model.keep_all else _MAX_ITERATIONS):
        kept = [bundle_adjustment.corners_of(view, ~out) for view, out in zip(views, left_out, strict=True)]
        poses = [board_pose(view, camera) for view in kept]
        errors = [residuals(view, pose, camera) for view, pose in zip(views, poses, strict=True)]
        cleaned = [outliers.whole_markers(*one) for one in zip(views, outliers.outlying_corners(errors), strict=True)]
        if all(np.array_equal(*pair) for pair in zip(cleaned, left_out, strict=True)):
            break
        left_out = cleaned
        kept = [bundle_adjustment.corners_of(view, ~out) for view, out in zip(views, left_out, strict=True)]
        camera = bundle_adjustment.camera_solution(kept, camera, model).camera
    return camera, left_out


def _camera_view(view: BoardView, left_out: Bool[Array, "corner"], camera: Camera, rejected: str) -> CameraView:
    """A view's residuals with its pose fitted to the corners that are not left out."""
    unbiased = without_distortion_bias(view, camera)
    pose = board_pose(bundle_adjustment.corners_of(unbiased, ~left_out), camera)
    return CameraView(
        board=view,
        pose=pose,
        points_px=unbiased.points_px,
        residual_px=residuals(unbiased, pose, camera),
        left_out=left_out,
        rejected=rejected,
    )


def _covariance(solution: bundle_adjustment.CameraSolution, model: CameraModel) -> ParameterCovariance:
    """Covariance of the intrinsic parameters; DataError if the views do not determine them."""
    camera = solution.camera
    try:
        data = covariance_of_free(solution.information.sum(axis=0), model.free)
    except np.linalg.LinAlgError as error:
        raise bundle_adjustment.undetermined("the views do not determine the parameters uniquely") from error
    focal, sd = camera.camera_matrix[0, 0], float(np.sqrt(max(data[0, 0], 0.0)))
    if not np.isfinite(sd) or sd > MAX_FOCAL_SHARE * focal:
        finding = f"the views do not determine the focal length: {focal:.0f} px with standard deviation {sd:.0f} px"
        raise bundle_adjustment.undetermined(finding)
    return ParameterCovariance(parameters=parameter_names(camera.distortion_model), data=data)
