"""How far a board's corners may err in the image, by what they miss their boards (ringpose-method(7), section 6)."""

from collections.abc import Sequence

import numpy as np

from ringpose.calibrate.corner_likeness import corner_residuals, likeliest_pose
from ringpose.calibrate.normal_spread import normal_spread
from ringpose.calibrate.view_variances import moderated_variances
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose
from ringpose.types.calibration import StripeView
from ringpose.types.camera import Camera

LEAST_SIGMA_PX = 0.002
"""Nothing in an image is known better, neither a corner of one view nor what it errs in all views alike."""

STRAY_SIGMAS = 3.0
"""Residuals beyond so many standard deviations count as so many."""

_POSE = 6


def corner_sigma_px(views: Sequence[StripeView], poses: Sequence[BoardPose], camera: Camera) -> float:
    """Standard deviation of one coordinate of a corner, from the residuals of all views; strays count as three."""
    errors = _residuals(views, poses, camera)
    every = np.abs(np.concatenate(errors))
    limit = STRAY_SIGMAS * normal_spread(every)
    return float(np.sqrt(np.sum(np.minimum(every, limit) ** 2) / max(every.size - _POSE * len(errors), 1)))


def corner_sigmas_px(views: Sequence[StripeView], poses: Sequence[BoardPose], camera: Camera) -> Float64[Array, "view"]:
    """The same for each view: of its own residuals, drawn to the common one as far as its own are few."""
    errors = _residuals(views, poses, camera)
    common = normal_spread(np.concatenate(errors))
    limits = [STRAY_SIGMAS * max(common, normal_spread(own)) for own in errors]
    squares = [float(np.sum(np.minimum(np.abs(own), limit) ** 2)) for own, limit in zip(errors, limits, strict=True)]
    freedom = np.array([max(own.size - _POSE, 1) for own in errors], dtype=np.float64)
    sigmas: Float64[Array, "view"] = np.sqrt(moderated_variances(np.array(squares), freedom))
    return np.maximum(sigmas, LEAST_SIGMA_PX)


def with_shared_errors(
    sigmas_px: Float64[Array, "view"],
    views: Sequence[StripeView],
    poses: Sequence[BoardPose],
    camera: Camera,
    taken: int,
) -> Float64[Array, "view"]:
    """The standard deviations as large as means over the views ask for.

    A print that is not true, a board that is bent and an edge that light draws aside move the same corner in all
    views: such errors do not grow fewer with more views. `taken` parameters were estimated from all views. Stripes
    that disagree move corners alike, too, and so do stray corners where stripes do not hold their board: what counts
    is seen of boards at the given poses and of those where their corners alone have them.
    """
    alone = [likeliest_pose(view.board, camera)[0] for view in views]
    errors = [_residuals(views, each, camera) for each in (poses, alone)]
    factor = min(_shared_factor(sigmas_px, views, own, taken) for own in errors)
    wider: Float64[Array, "view"] = np.sqrt(factor * sigmas_px**2 + len(views) * LEAST_SIGMA_PX**2)
    return wider


def _shared_factor(
    sigmas_px: Float64[Array, "view"],
    views: Sequence[StripeView],
    errors: Sequence[Float64[Array, "_"]],
    taken: int,
) -> float:
    """Variance of corners' means over the views, over what errors of single views make it; never below one."""
    sums, counts = np.zeros((_most_corners(views), 2)), np.zeros(_most_corners(views))
    for view, own, sigma in zip(views, errors, sigmas_px.tolist(), strict=True):
        standard = np.clip(own / sigma, -STRAY_SIGMAS, STRAY_SIGMAS)
        sums[view.board.ids] += standard.reshape(-1, 2)
        counts[view.board.ids] += 1
    often = counts > 1
    freedom = 2 * int(often.sum()) - _POSE - taken
    if freedom <= 0:
        return 1.0
    return max(1.0, float(np.sum(sums[often] ** 2 / counts[often, None])) / freedom)


def _most_corners(views: Sequence[StripeView]) -> int:
    return 1 + max(int(view.board.ids.max()) for view in views)


def _residuals(views: Sequence[StripeView], poses: Sequence[BoardPose], camera: Camera) -> list[Float64[Array, "_"]]:
    return [corner_residuals(view.board, pose, camera) for view, pose in zip(views, poses, strict=True)]
