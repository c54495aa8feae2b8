"""Light planes from views of a board with stripes (ringpose-method(7), section 6)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from ringpose.calibrate.board_pose import board_pose, marker_average_pose
from ringpose.calibrate.laser_fit import LARGEST_CONDITION, laser_calibration, outlying_views
from ringpose.calibrate.plane_covariance import planes_covariance
from ringpose.calibrate.plane_fits import PlanesMethod, condition, robust_plane
from ringpose.calibrate.plane_points import triangulated
from ringpose.calibrate.stripe_labels import labelled_by_order, labelled_by_planes
from ringpose.errors import DataError
from ringpose.types.arrays import Array
from ringpose.types.board import BoardPose
from ringpose.types.calibration import LaserCalibration, PlanesCalibration, StripeView
from ringpose.types.camera import Camera
from ringpose.types.laser_planes import LaserPlanes

OUTLIER_FACTOR = 4.0
"""A view whose board fits this many times worse than the median of the views is left out ..."""

OUTLIER_FLOOR_PX = 0.5
"""... if its rms is above this."""

_Remark = tuple[str, str]
_Plane = tuple[Float64[Array, "3"], float]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanesModel:
    """What is estimated, and how."""

    names: tuple[str, ...]
    """Of the lasers, in the order of a shot's mask bits."""
    method: PlanesMethod = PlanesMethod.TOTAL_LEAST_SQUARES
    order: tuple[int, ...] | None = None
    """Lasers in the order in which their stripes cross the image, for frames with all lasers on."""


def calibrate_planes(views: Sequence[StripeView], camera: Camera, model: PlanesModel) -> PlanesCalibration:
    """The light planes in the camera frame, with what each view says about each of them."""
    poses = [_pose(view, camera, model.method) for view in views]
    views, poses, remarks = _good_boards(views, poses)
    views = _labelled(views, poses, camera, model)
    remarks += _missing(views, model)
    views, outlying = _agreeing(views, poses, camera, model)
    names = [view.board.name for view in views]
    lasers = tuple(
        laser_calibration(name, _points(laser, views, poses, camera), names, model.method)
        for laser, name in enumerate(model.names)
    )
    planes = _planes(lasers)
    return PlanesCalibration(
        planes=planes,
        covariance=None if model.method is PlanesMethod.PAPER else planes_covariance(views, poses, camera, lasers),
        method=model.method.value,
        lasers=lasers,
        poses=tuple(poses),
        remarks=tuple(remarks + outlying),
    )


def _pose(view: StripeView, camera: Camera, method: PlanesMethod) -> BoardPose:
    return marker_average_pose(view.board, camera) if method is PlanesMethod.PAPER else board_pose(view.board, camera)


def _good_boards(
    views: Sequence[StripeView], poses: Sequence[BoardPose]
) -> tuple[list[StripeView], list[BoardPose], list[_Remark]]:
    """The views whose corners fit the board, their poses, and the others with the reason."""
    if not views:
        remedy = "give shots of the board at two or more distances, 50 mm or more apart"
        raise DataError("calibrate-planes", "no view of the board", remedy)
    rms = np.array([pose.residual_rms_px for pose in poses])
    usual = float(np.median(rms))
    good = rms <= max(OUTLIER_FACTOR * usual, OUTLIER_FLOOR_PX)
    remarks = [
        (pose.name, f"left out: its corners miss the board by {pose.residual_rms_px:.2f} px rms, usual is {usual:.2f}")
        for pose, kept in zip(poses, good, strict=True)
        if not kept
    ]
    kept = np.flatnonzero(good).tolist()
    return [views[index] for index in kept], [poses[index] for index in kept], remarks


def _points(
    laser: int, views: Sequence[StripeView], poses: Sequence[BoardPose], camera: Camera
) -> list[Float64[Array, "_ xyz=3"]]:
    """One laser's points by view."""
    return [triangulated(view.stripes_px[laser], pose, camera) for view, pose in zip(views, poses, strict=True)]


def _labelled(
    views: Sequence[StripeView], poses: Sequence[BoardPose], camera: Camera, model: PlanesModel
) -> list[StripeView]:
    """The views with all stripes given to lasers: by the order, or by the planes of the labelled stripes."""
    if not any(view.unlabelled_px for view in views):
        return list(views)
    if model.order is not None:
        return [labelled_by_order(view, model.order) for view in views]
    planes = _preliminary_planes(views, poses, camera, model)
    return [
        labelled_by_planes(view, [triangulated(px, pose, camera) for px in view.unlabelled_px], planes)
        for view, pose in zip(views, poses, strict=True)
    ]


def _preliminary_planes(
    views: Sequence[StripeView], poses: Sequence[BoardPose], camera: Camera, model: PlanesModel
) -> list[_Plane]:
    """The planes through the stripes that are labelled already."""
    planes = []
    for laser, name in enumerate(model.names):
        points = np.concatenate(_points(laser, views, poses, camera))
        normal, distance_m, weights = robust_plane(points) if len(points) else (np.zeros(3), 0.0, np.zeros(0))
        if not len(points) or condition(points, weights) > LARGEST_CONDITION:
            raise DataError(
                f'laser "{name}"',
                "which stripe is its is not known: too few shots have a frame with it alone on",
                "capture with --sequence off,1,2,3, or give --laser-order",
            )
        planes.append((normal, distance_m))
    return planes


def _agreeing(
    views: Sequence[StripeView], poses: Sequence[BoardPose], camera: Camera, model: PlanesModel
) -> tuple[list[StripeView], list[_Remark]]:
    """The views without those stripes that lie beside their laser's plane, and which these are."""
    agreeing, remarks = list(views), []
    for laser, name in enumerate(model.names):
        for index, reason in outlying_views(_points(laser, views, poses, camera), model.method).items():
            agreeing[index] = _without(agreeing[index], laser)
            remarks.append((views[index].board.name, f"stripe of {name} left out: {reason}"))
    return agreeing, remarks


def _without(view: StripeView, laser: int) -> StripeView:
    none = np.empty((0, 2))
    return replace(view, stripes_px=tuple(none if i == laser else px for i, px in enumerate(view.stripes_px)))


def _planes(lasers: Sequence[LaserCalibration]) -> LaserPlanes:
    return LaserPlanes(
        names=tuple(laser.name for laser in lasers),
        normal=np.stack([laser.normal for laser in lasers]),
        distance_m=np.array([laser.distance_m for laser in lasers]),
        projector_m=np.full((len(lasers), 3), np.nan),
    )


def _missing(views: Sequence[StripeView], model: PlanesModel) -> list[_Remark]:
    """What the views do not show."""
    remarks = []
    for view in views:
        missing = [name for name, px in zip(model.names, view.stripes_px, strict=True) if not len(px)]
        if missing:
            found = "; ".join(view.remarks) or "none on the board"
            remarks.append((view.board.name, f"no stripe of {', '.join(missing)}: {found}"))
    return remarks
