"""One laser's plane through its triangulated points of all views (method(7), section 6)."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ringpose.calibrate.acceptance import PLANES_LIMITS
from ringpose.calibrate.planes.stripes.errors import (
    center_sigma_px,
    line_modes,
    shared_length,
    stripe_rays,
    stripe_residuals,
)
from ringpose.errors import DataError
from ringpose.geometry.least_squares import robust_std
from ringpose.geometry.rays import intersect, nearest_plane
from ringpose.geometry.sheets import Bends, bends
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose
from ringpose.types.options import PlanesMethod
from ringpose.types.rig import Camera, LaserBow, camera_parameters

MAX_CONDITION = PLANES_LIMITS["condition"].redo
"""Points with a larger condition number are collinear: views 100 mm long must differ by 2 mm across their stripe."""

MIN_MEAN_WEIGHT = 0.1
"""A view is an outlier if the mean robust weight of its points is smaller."""

MAX_SCATTER = 0.02
"""Root mean square distance from the plane, over the points' extent, above which they are not one stripe."""

_TUKEY = 4.685
"""Tuning constant of Tukey's biweight: 95 % efficient for normal errors."""

_MAX_ITERATIONS = 20

_MIN_SCALE_M = 1e-9
"""Lower bound of the robust standard deviation: residuals below it are rounding errors, not outliers."""

Points = Float64[Array, "_ xyz=3"]
"""Stripe centres of one laser in one view, triangulated, in the camera frame; none where the laser is not seen."""


class FittedPlane(NamedTuple):
    """A plane `normal . point = distance_m` through points, and the condition number of the points."""

    normal: Float64[Array, "xyz=3"]
    distance_m: float
    condition: float
    bend: Bends | None = None
    """How the sheet of light is bent over the plane; None if it is flat."""

    def off_m(self, points: Float64[Array, "n xyz=3"]) -> Float64[Array, "n"]:
        """Distances of points from the sheet of light, along the plane's normal."""
        off_m: Float64[Array, "n"] = points @ self.normal - self.distance_m
        return off_m if self.bend is None else off_m - self.bend.height_m(points)


def fitted_plane(name: str, points: Sequence[Points], method: PlanesMethod) -> FittedPlane:
    """The plane through a laser's points of all views; DataError if they do not determine one."""
    location = f'laser "{name}"'
    seen = sum(len(own) > 0 for own in points)
    if seen == 0:
        remedy = "see that its stripe crosses the board; add views at two distances, 50 mm or more apart"
        raise DataError(location, "no view shows its stripe on the board", remedy)
    every = np.concatenate(points)
    plane = light_plane(every, method)
    if plane.condition > MAX_CONDITION:
        lying = "its one view lie" if seen == 1 else f"its {seen} views lie"
        finding = f"the points of {lying} on one line (condition {plane.condition:.0f}), which determines no plane"
        remedy = f"add a view of the board 50 mm or more nearer or farther than {every[:, 2].mean():.2f} m"
        raise DataError(location, finding, remedy)
    rms_m = rms(plane.off_m(every))
    extent_m = float(np.sqrt(np.mean(np.sum((every - every.mean(axis=0)) ** 2, axis=1))))
    if rms_m > MAX_SCATTER * extent_m:
        finding = f"the points of its {seen} views lie on no common plane (rms {1e3 * rms_m:.1f} mm)"
        remedy = "see with --overlay whether these stripes are the laser's in every shot"
        raise DataError(location, finding, remedy)
    return plane


def plane_without(
    points: Sequence[Points], left_out: int, method: PlanesMethod, bend: Bends | None
) -> FittedPlane | None:
    """The plane through the points of the other views, with that bend; None if those do not determine one."""
    if not determined_without(points, left_out):
        return None
    others = np.concatenate([own for index, own in enumerate(points) if index != left_out])
    return light_plane(others, method)._replace(bend=bend)


def determined_without(points: Sequence[Points], left_out: int) -> bool:
    """Whether the points of the other views determine a plane."""
    every = np.concatenate([*(own for index, own in enumerate(points) if index != left_out), np.empty((0, 3))])
    return len(every) > 2 and condition(every, np.ones(len(every))) < MAX_CONDITION


def condition(points: Float64[Array, "n xyz=3"], weights: Float64[Array, "n"]) -> float:
    """Condition number: extent of the points along their longest direction over that across it, in their plane.

    Infinite for collinear points, which do not determine a plane.
    """
    _, _, (along, across, _) = nearest_plane(points, weights)
    return float(along / across) if across > 0 else float("inf")


def light_plane(points: Float64[Array, "n xyz=3"], method: PlanesMethod) -> FittedPlane:
    """The plane through points by one of the methods; its condition number is large if the points are collinear."""
    if method is PlanesMethod.PAPER:
        return FittedPlane(*paper_plane(points), condition(points, np.ones(len(points))))
    normal, distance_m, weights = robust_plane(points)
    return FittedPlane(normal, distance_m, condition(points, weights))


def robust_plane(
    points: Float64[Array, "n xyz=3"], start: tuple[Float64[Array, "3"], float] | None = None
) -> tuple[Float64[Array, "3"], float, Float64[Array, "n"]]:
    """Unit normal, distance and weights by iteratively re-weighted total least squares with Tukey's biweight.

    The default start is the unweighted plane.
    """
    weights = np.ones(len(points))
    normal, distance_m = nearest_plane(points)[:2] if start is None else start
    for _ in range(_MAX_ITERATIONS):
        residual = points @ normal - distance_m
        scale = max(robust_std(residual), _MIN_SCALE_M)
        updated = np.clip(1 - (residual / (_TUKEY * scale)) ** 2, 0.0, None) ** 2
        normal, distance_m, _ = nearest_plane(points, updated)
        if np.abs(updated - weights).max() < 1e-6:
            break
        weights = updated
    return *oriented(normal, distance_m), weights


def paper_plane(points: Float64[Array, "n xyz=3"]) -> tuple[Float64[Array, "3"], float]:
    """The paper's form S . P = 1 by ordinary least squares, as unit normal and distance.

    It does not minimise distances: |S| is biased when points scatter, and a plane through the camera has no S.
    """
    scaled, _, _, _ = np.linalg.lstsq(points, np.ones(len(points)), rcond=None)
    length = float(np.linalg.norm(scaled))
    return oriented(scaled / length, 1 / length)


def oriented(normal: Float64[Array, "3"], distance_m: float) -> tuple[Float64[Array, "3"], float]:
    """The plane with the largest component of its normal positive, so that calibrations can be compared."""
    if normal[np.argmax(np.abs(normal))] < 0:
        return -normal, -distance_m
    return normal, distance_m


def outlying_views(points: Sequence[Points]) -> dict[int, float]:
    """Indices of views beside the plane of the others, with their rms distances (m); empty for three or fewer views."""
    seen = [index for index, own in enumerate(points) if len(own)]
    if len(seen) < 4:
        return {}
    views = [points[index] for index in seen]
    # Start: of the planes of all views but one, the one with the smallest median distance (least median of squares).
    starts = [nearest_plane(np.concatenate([*views[:index], *views[index + 1 :]]))[:2] for index in range(len(views))]
    start = min(starts, key=lambda plane: float(np.median([rms(own @ plane[0] - plane[1]) for own in views])))
    normal, distance_m, weights = robust_plane(np.concatenate(views), start)
    by_view = np.split(weights, np.cumsum([len(own) for own in views])[:-1])
    return {
        index: rms(points[index] @ normal - distance_m)
        for index, weight in zip(seen, by_view, strict=True)
        if weight.mean() < MIN_MEAN_WEIGHT
    }


def rms(distances_m: Float64[Array, "n"]) -> float:
    """Root mean square of distances."""
    return float(np.sqrt(np.mean(distances_m**2)))


BOW_SIGMAS = 5.0
"""Standard deviations from which a light plane is bent. With half of them one flat plane in 80 would be; with twice as
many, bends are missed that the views show clearly."""

MIN_BOW_VIEWS = 3
"""Views that show the scatter of a bend; two show hardly any, and twice as many are most of a usual calibration."""


def fitted_bow(
    stripes: Sequence[tuple[Float64[Array, "_ xy=2"], BoardPose]], plane: FittedPlane, camera: Camera
) -> LaserBow | None:
    """The bend of a light sheet by the curvature of its stripes on flat boards; None where it is not significant.

    Shift and rotation of each stripe in the image are left open, so that errors of the boards' poses do not count.
    The standard deviation is that by the stripes' centres, or by the scatter between the views if that is larger, and
    by the camera's covariance: a wrong lens distortion bends stripes, too. `stripes`: their pixels, by view.
    """
    length = shared_length([points_px for points_px, _ in stripes])
    bow, variance, by_camera = [], [], []
    for points_px, pose in stripes:
        residuals = stripe_residuals(stripe_rays(points_px, camera), pose, plane.normal, plane.distance_m)
        bend_px = _bend_m(points_px, pose, plane, camera) / residuals.metres_per_pixel
        basis = np.linalg.qr(line_modes(points_px).T)[0]
        curved, seen, wrt_camera = (
            each - basis @ (basis.T @ each) for each in (bend_px, residuals.residual_px, residuals.wrt_camera)
        )
        square = float(curved @ curved)
        bow.append(float(curved @ seen) / square)
        variance.append(center_sigma_px(points_px, length) ** 2 / square)
        by_camera.append(curved @ wrt_camera / square)
    if len(bow) < MIN_BOW_VIEWS:
        return None
    weight = 1.0 / np.maximum(variance, np.finfo(np.float64).tiny)
    mean = float(weight @ bow / weight.sum())
    excess = float(weight @ (np.array(bow) - mean) ** 2) / (len(bow) - 1)
    of_camera, covariance = weight @ np.array(by_camera) / weight.sum(), np.zeros(2 * [len(by_camera[0])])
    if camera.covariance is not None:
        covariance = camera.covariance.of(camera_parameters(len(camera.distortion_coefficients)))
    sd = float(np.sqrt(max(excess, 1.0) / weight.sum() + of_camera @ covariance @ of_camera))
    return LaserBow(per_rad=mean, sd_per_rad=sd) if abs(mean) > BOW_SIGMAS * sd else None


def _bend_m(
    points_px: Float64[Array, "n xy=2"], pose: BoardPose, plane: FittedPlane, camera: Camera
) -> Float64[Array, "n"]:
    """Distance from the plane of a sheet of bow 1 about the camera, where rays of pixels meet a board."""
    board = pose.rotation[:, 2]
    point = intersect(stripe_rays(points_px, camera).ray, board, np.array(float(board @ pose.translation_m)))
    return bend_about_camera(plane, 1.0).height_m(point)


def bend_about_camera(plane: FittedPlane, per_rad: float) -> Bends:
    """A bend over a plane whose projector counts as the camera's centre."""
    return bends(plane.normal[None], np.array([per_rad]), np.zeros((1, 3))).of(0)


def on_plane(points: Points, plane: FittedPlane) -> Points:
    """Points of a bent sheet, lowered onto its plane; those of a flat one as they are."""
    return points if plane.bend is None else points - plane.bend.height_m(points)[:, None] * plane.normal
