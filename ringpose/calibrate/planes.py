"""Light planes from views of a board with stripes (MATH.md section 6)."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Float64

from ringpose.calibrate.board_pose import board_pose, marker_average_pose
from ringpose.calibrate.plane_covariance import planes_covariance
from ringpose.calibrate.plane_fits import extents_m, paper_plane, robust_plane
from ringpose.calibrate.plane_points import triangulated
from ringpose.calibrate.stripe_labels import labelled_by_order, labelled_by_planes
from ringpose.errors import DataError
from ringpose.types.arrays import Array
from ringpose.types.board import BoardPose
from ringpose.types.calibration import LaserCalibration, LaserView, PlanesCalibration, StripeView
from ringpose.types.camera import Camera
from ringpose.types.laser_planes import LaserPlanes


class PlanesMethod(StrEnum):
    """How board poses and light planes are estimated."""

    TOTAL_LEAST_SQUARES = "total-least-squares"
    """One pose over all corners of a board; the plane nearest to the points, robust, with covariance."""
    PAPER = "paper"
    """The mean of the poses of the single markers; S . P = 1 by least squares."""


LARGEST_CONDITION = 50.0
"""Points this many times longer than wide lie on a line: views 100 mm long must differ by 2 mm across it."""

OUTLIER_FACTOR = 4.0
"""A view whose board fits this many times worse than the median of the views is left out ..."""

OUTLIER_FLOOR_PX = 0.5
"""... if its rms is above this."""

_Plane = tuple[Float64[Array, "3"], float]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanesModel:
    """What is estimated, and how."""

    names: tuple[str, ...]
    method: PlanesMethod = PlanesMethod.TOTAL_LEAST_SQUARES
    order: tuple[int, ...] | None = None
    """Lasers in the order in which their stripes cross the image, for frames with all lasers on."""


def calibrate_planes(views: Sequence[StripeView], camera: Camera, model: PlanesModel) -> PlanesCalibration:
    """The light planes in the camera frame, with what each view says about each of them."""
    poses = [_pose(view, camera, model.method) for view in views]
    bad = _bad_boards(views, poses)
    kept = [index for index in range(len(views)) if index not in bad]
    poses = [poses[index] for index in kept]
    labelled = _labelled([views[index] for index in kept], poses, camera, model)
    points = [
        [triangulated(view.stripes_px[laser], pose, camera) for view, pose in zip(labelled, poses, strict=True)]
        for laser in range(len(model.names))
    ]
    names = [view.board.name for view in labelled]
    lasers, planes, weights = _fitted(points, names, model)
    honest = model.method is PlanesMethod.TOTAL_LEAST_SQUARES
    return PlanesCalibration(
        planes=planes,
        covariance=planes_covariance(labelled, poses, camera, planes, weights) if honest else None,
        method=model.method.value,
        lasers=lasers,
        poses=tuple(poses),
        left_out=tuple([(views[i].board.name, reason) for i, reason in bad.items()] + _remarks(labelled, model)),
    )


def _pose(view: StripeView, camera: Camera, method: PlanesMethod) -> BoardPose:
    return marker_average_pose(view.board, camera) if method is PlanesMethod.PAPER else board_pose(view.board, camera)


def _bad_boards(views: Sequence[StripeView], poses: Sequence[BoardPose]) -> dict[int, str]:
    """Views whose corners do not fit the board, with the reason."""
    rms = np.array([pose.residual_rms_px for pose in poses])
    limit = max(OUTLIER_FACTOR * float(np.median(rms)) if len(rms) else 0.0, OUTLIER_FLOOR_PX)
    return {
        index: f"its corners miss the board by {pose.residual_rms_px:.2f} px rms, the others by {np.median(rms):.2f}"
        for index, pose in enumerate(poses)
        if pose.residual_rms_px > limit
    }


def _labelled(
    views: Sequence[StripeView], poses: Sequence[BoardPose], camera: Camera, model: PlanesModel
) -> list[StripeView]:
    """The views with all stripes given to lasers: by the order, or by the planes of the labelled stripes."""
    if not any(view.unlabelled_px for view in views):
        return list(views)
    order = (0,) if len(model.names) == 1 else model.order
    if order is not None:
        return [labelled_by_order(view, order) for view in views]
    planes = [_preliminary(laser, views, poses, camera) for laser in range(len(model.names))]
    known = [plane for plane in planes if plane is not None]
    if len(known) < len(planes):
        unknown = ", ".join(name for name, plane in zip(model.names, planes, strict=True) if plane is None)
        raise DataError(
            "calibrate-planes",
            f"which stripe is whose ({unknown}) is not known: too few shots have a frame with that laser alone on",
            "capture with --sequence off,1,2,3, or give --laser-order",
        )
    return [
        labelled_by_planes(view, [triangulated(px, pose, camera) for px in view.unlabelled_px], known)
        for view, pose in zip(views, poses, strict=True)
    ]


def _preliminary(laser: int, views: Sequence[StripeView], poses: Sequence[BoardPose], camera: Camera) -> _Plane | None:
    """The plane through the labelled stripes, if they determine one."""
    seen = [
        triangulated(view.stripes_px[laser], pose, camera)
        for view, pose in zip(views, poses, strict=True)
        if len(view.stripes_px[laser])
    ]
    if len(seen) < 2:
        return None
    points = np.concatenate(seen)
    normal, distance_m, weights = robust_plane(points)
    return (normal, distance_m) if condition(points, weights) < LARGEST_CONDITION else None


def condition(points: Float64[Array, "n xyz=3"], weights: Float64[Array, "n"]) -> float:
    """Extent of the points along their longest direction over that across it, in their plane."""
    along, across = extents_m(points, weights)
    return along / across if across > 0 else np.inf


def _fitted(
    points: Sequence[Sequence[Float64[Array, "_ xyz=3"]]], views: Sequence[str], model: PlanesModel
) -> tuple[tuple[LaserCalibration, ...], LaserPlanes, list[list[Float64[Array, "_"]]]]:
    """What each laser's points say: calibration, plane, weights by laser and view."""
    lasers, normals, distances, weights = [], [], [], []
    for name, by_view in zip(model.names, points, strict=True):
        (normal, distance_m), weight = _plane(name, by_view, model.method)
        split = np.split(weight, np.cumsum([len(view) for view in by_view])[:-1])
        lasers.append(_judged(name, by_view, views, (normal, distance_m), split, model.method))
        normals.append(normal)
        distances.append(distance_m)
        weights.append(split)
    planes = LaserPlanes(
        names=model.names,
        normal=np.stack(normals),
        distance_m=np.array(distances),
        projector_m=np.full((len(model.names), 3), np.nan),
    )
    return tuple(lasers), planes, weights


def _plane(
    name: str, by_view: Sequence[Float64[Array, "_ xyz=3"]], method: PlanesMethod
) -> tuple[_Plane, Float64[Array, "n"]]:
    """The light plane through the points of all views, if they determine one."""
    seen = [view for view in by_view if len(view)]
    place = f'laser "{name}"'
    if not seen:
        raise DataError(
            place, "its stripe is on the board in no view", "add two views of the board, 50 mm or more apart"
        )
    points = np.concatenate(seen)
    normal, distance_m, weight = _fit(points, method)
    depth = float(points[:, 2].mean())
    remedy = f"add a view of the board 50 mm or more nearer or farther than {depth:.2f} m"
    if len(seen) == 1:
        raise DataError(place, "seen in one view: its points lie on one line, which determines no plane", remedy)
    spread = condition(points, weight)
    if spread > LARGEST_CONDITION:
        found = (
            f"the points of its {len(seen)} views lie on one line (condition {spread:.0f}), which determines no plane"
        )
        raise DataError(place, found, remedy)
    return (normal, distance_m), weight


def _fit(
    points: Float64[Array, "n xyz=3"], method: PlanesMethod
) -> tuple[Float64[Array, "3"], float, Float64[Array, "n"]]:
    return paper_plane(points) if method is PlanesMethod.PAPER else robust_plane(points)


def _judged(
    name: str,
    by_view: Sequence[Float64[Array, "_ xyz=3"]],
    views: Sequence[str],
    plane: _Plane,
    weights: Sequence[Float64[Array, "_"]],
    method: PlanesMethod,
) -> LaserCalibration:
    """Distances from the plane, and from the planes of the other views."""
    seen = [index for index, points in enumerate(by_view) if len(points)]
    held_out = [_held_out_m(by_view, seen, index, method) for index in seen]
    distances = [by_view[index] @ plane[0] - plane[1] for index in seen]
    points = np.concatenate([by_view[index] for index in seen])
    return LaserCalibration(
        name=name,
        views=tuple(
            LaserView(
                name=views[index],
                points=by_view[index],
                weights=weights[index],
                rms_m=_rms(distance),
                held_out_rms_m=_rms(other),
            )
            for index, distance, other in zip(seen, distances, held_out, strict=True)
        ),
        rms_m=_rms(np.concatenate(distances)),
        held_out_rms_m=_rms(np.concatenate(held_out)),
        condition=condition(points, np.concatenate([weights[index] for index in seen])),
    )


def _held_out_m(
    by_view: Sequence[Float64[Array, "_ xyz=3"]], seen: Sequence[int], left_out: int, method: PlanesMethod
) -> Float64[Array, "n"]:
    """Distances of one view's points from the plane of the other views; NaN where those determine none."""
    others = [by_view[index] for index in seen if index != left_out]
    own = by_view[left_out]
    if len(others) < 2:
        return np.full(len(own), np.nan)
    normal, distance_m, weight = _fit(np.concatenate(others), method)
    if condition(np.concatenate(others), weight) > LARGEST_CONDITION:
        return np.full(len(own), np.nan)
    return own @ normal - distance_m


def _rms(distances: Float64[Array, "n"]) -> float:
    known = distances[np.isfinite(distances)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")


def _remarks(views: Sequence[StripeView], model: PlanesModel) -> list[tuple[str, str]]:
    """What the views do not say."""
    remarks = [(view.board.name, remark) for view in views for remark in view.remarks]
    for view in views:
        missing = [name for name, px in zip(model.names, view.stripes_px, strict=True) if not len(px)]
        if missing and not view.remarks:
            remarks.append((view.board.name, f"no stripe on the board of {', '.join(missing)}"))
    return remarks
