"""What the corners of one marker have in common (ringpose-method(7), section 6).

Each corner is where two sides meet, and each side was drawn through its edge as one parabola: an error of a side
moves both corners at its ends. Taken for independent, the corners of four markers make boards seem a third better
placed than they are.

How exact the corners of each view are, by their residuals, where views differ (ringpose-method(7), section 7).

A view's own residuals tell its variance from a few dozen numbers, those of all views only what is usual. Both are
weighed by how much the views really differ: moderated variances (Smyth 2004), chi-squared about a common scale.

How far a board's corners may err in the image, by what they miss their boards (ringpose-method(7), section 6).
"""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq
from scipy.special import digamma, polygamma

from ringpose.calibrate.boards.pose import board_pose, moved_pose, residuals
from ringpose.calibrate.camera.parameters import projection_jacobians
from ringpose.geometry.robust import robust_std
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.calibration import StripeView
from ringpose.types.camera import Camera


def whiten(rows: Float64[Array, "coordinate *column"], view: BoardView) -> Float64[Array, "coordinate *column"]:
    """Rows of a view's corner coordinates (x and y of each in turn) turned into as many of independent errors.

    Their mean square stays that of a coordinate. Corners that err alike are those of whole markers.
    """
    if view.likeness == 0:
        return rows
    by_marker = rows.reshape(-1, 8, rows.size // len(rows))
    return np.linalg.solve(_error_root(view), by_marker).reshape(rows.shape)


def corner_residuals(view: BoardView, pose: BoardPose, camera: Camera) -> Float64[Array, "coordinate"]:
    """Of a view's corners in pixels, x and y of each in turn, changed to as many of independent errors."""
    return whiten(residuals(view, pose, camera).ravel(), view)


def maximum_likelihood_pose(view: BoardView, camera: Camera) -> tuple[BoardPose, Float64[Array, "pose=6 pose=6"]]:
    """The board's pose by corners that err alike, and its covariance for errors of one pixel in each coordinate."""
    pose = board_pose(view, camera)
    by_pose, _ = projection_jacobians(view.points_board_m, pose, camera)
    rows = whiten(by_pose.reshape(-1, 6), view)
    covariance: Float64[Array, "pose=6 pose=6"] = np.linalg.inv(rows.T @ rows)
    if view.likeness:
        pose = moved_pose(pose, covariance @ rows.T @ corner_residuals(view, pose, camera))
    return pose, covariance


def endpoint_correlation(left_out: float) -> float:
    """Correlation of a parabola's errors at a side's two ends, if it was drawn without this share of the side at each.

    Over places -1 to 1 its level, slope and bend have independent errors in the Legendre polynomials 1, 3^1/2 x and
    5^1/2 (3 x^2 - 1) / 2; the ends lie at x = 1 / (1 - 2 left_out) and opposite.
    """
    end = 1.0 / (1.0 - 2.0 * left_out)
    even = 1.0 + 5.0 * ((3.0 * end**2 - 1.0) / 2.0) ** 2
    odd = 3.0 * end**2
    return (even - odd) / (even + odd)


def endpoint_for_correlation(likeness: float) -> float:
    """Where a side ends, if it was drawn from -1 to 1 and its errors at both ends have this correlation.

    With u the square of it, the even and odd parts of the variance are 1 + 5/4 (3 u - 1)^2 and 3 u.
    """
    share = 3.0 * (1.0 + likeness) / (1.0 - likeness)
    squared = np.roots([11.25, -7.5 - share, 2.25])
    return float(np.sqrt(max(squared.real.max(), 1.0)))


def side_normals(corners: Float64[Array, "marker corner=4 xy=2"]) -> Float64[Array, "marker side=4 xy=2"]:
    """Unit normals of markers' sides, outwards: corners run clockwise."""
    along = np.roll(corners, -1, axis=1) - corners
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    return np.stack([along[..., 1], -along[..., 0]], axis=-1)


def _error_root(view: BoardView) -> Float64[Array, "marker coordinate=8 coordinate=8"]:
    """Root of the correlations of the eight coordinates that the ends of a marker's four sides give."""
    corners = view.points_px.reshape(-1, 4, 2)
    normals = side_normals(corners)
    meeting = np.linalg.inv(np.stack([normals, np.roll(normals, 1, axis=1)], axis=-2))
    by_ends = np.zeros((len(corners), 8, 8))
    for corner in range(4):
        by_ends[:, 2 * corner : 2 * corner + 2, [2 * corner, 2 * ((corner - 1) % 4) + 1]] = meeting[:, corner]
    ends = np.kron(np.eye(4), np.array([[1.0, view.likeness], [view.likeness, 1.0]]))
    root: Float64[Array, "marker coordinate=8 coordinate=8"] = np.linalg.cholesky(by_ends @ ends @ by_ends.mT)
    return root


_MIN_SPREAD = 1e-9
"""Variance of the logarithms of the views' variances below which the views do not differ."""


def moderated_variances(squares: Float64[Array, "view"], freedom: Float64[Array, "view"]) -> Float64[Array, "view"]:
    """Variance of each view, from the sum of its squared residuals and the degrees of freedom these have."""
    common = max(float(squares.sum() / freedom.sum()), np.finfo(float).tiny)
    own = np.maximum(squares / freedom, 1e-12 * common)
    prior, scale = _prior(np.log(own), freedom)
    if not np.isfinite(prior):
        return np.full(len(own), common)
    moderated: Float64[Array, "view"] = (prior * scale + freedom * own) / (prior + freedom)
    return moderated


def _prior(log_variance: Float64[Array, "view"], freedom: Float64[Array, "view"]) -> tuple[float, float]:
    """Degrees of freedom that the views have in common, and their common variance; infinite if they do not differ."""
    if len(log_variance) < 3:
        return float("inf"), float("nan")
    unbiased = log_variance - digamma(freedom / 2) + np.log(freedom / 2)
    spread = float(np.var(unbiased, ddof=1) - np.mean(polygamma(1, freedom / 2)))
    if spread < _MIN_SPREAD:
        return float("inf"), float("nan")
    bracket = (1 / spread, 1 / spread + 1)  # 1/x < trigamma(x) < 1/x + 1/x^2
    prior = 2 * float(brentq(lambda x: polygamma(1, x) - spread, *bracket))
    return prior, float(np.exp(unbiased.mean() + digamma(prior / 2) - np.log(prior / 2)))


MIN_SIGMA_PX = 0.002
"""Nothing in an image is known better, neither a corner of one view nor what it errs in all views alike."""

STRAY_SIGMAS = 3.0
"""Residuals beyond so many standard deviations count as so many."""

_POSE = 6


def corner_sigma_px(views: Sequence[StripeView], poses: Sequence[BoardPose], camera: Camera) -> float:
    """Standard deviation of one coordinate of a corner, from the residuals of all views; strays count as three."""
    errors = _residuals(views, poses, camera)
    every = np.abs(np.concatenate(errors))
    limit = STRAY_SIGMAS * robust_std(every)
    return float(np.sqrt(np.sum(np.minimum(every, limit) ** 2) / max(every.size - _POSE * len(errors), 1)))


def corner_sigmas_px(views: Sequence[StripeView], poses: Sequence[BoardPose], camera: Camera) -> Float64[Array, "view"]:
    """The same for each view: of its own residuals, drawn to the common one as far as its own are few."""
    errors = _residuals(views, poses, camera)
    common = robust_std(np.concatenate(errors))
    limits = [STRAY_SIGMAS * max(common, robust_std(own)) for own in errors]
    squares = [float(np.sum(np.minimum(np.abs(own), limit) ** 2)) for own, limit in zip(errors, limits, strict=True)]
    freedom = np.array([max(own.size - _POSE, 1) for own in errors], dtype=np.float64)
    sigmas: Float64[Array, "view"] = np.sqrt(moderated_variances(np.array(squares), freedom))
    return np.maximum(sigmas, MIN_SIGMA_PX)


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
    alone = [maximum_likelihood_pose(view.board, camera)[0] for view in views]
    errors = [_residuals(views, each, camera) for each in (poses, alone)]
    factor = min(_shared_factor(sigmas_px, views, own, taken) for own in errors)
    wider: Float64[Array, "view"] = np.sqrt(factor * sigmas_px**2 + len(views) * MIN_SIGMA_PX**2)
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
