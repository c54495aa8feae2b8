"""Light planes from views of a board with stripes (ringpose-method(7), section 6).

The light planes of a set of views by each method, and those of the views less one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ringpose.calibrate.boards.corner_errors import corner_sigmas_px, with_shared_errors
from ringpose.calibrate.boards.pose import board_pose, board_poses, marker_average_pose
from ringpose.calibrate.camera.distortion_bias import without_distortion_bias
from ringpose.calibrate.planes.board_surface import triangulated
from ringpose.calibrate.planes.covariance import laser_disagreements, planes_covariance, variance_excess
from ringpose.calibrate.planes.evidence import StripeEvidence, stripe_evidence
from ringpose.calibrate.planes.joint_adjustment import (
    JointData,
    JointFit,
    JointState,
    free_parameters,
    joint_data,
    joint_fit,
)
from ringpose.calibrate.planes.plane_fit import (
    FittedPlane,
    Points,
    determined_without,
    downward,
    fitted_plane,
    laser_calibration,
    plane_without,
)
from ringpose.errors import DataError
from ringpose.types.board import BoardPose
from ringpose.types.calibration import LaserCalibration, LaserView, PlanesCalibration, StripeView
from ringpose.types.camera import Camera
from ringpose.types.covariance import ParameterCovariance
from ringpose.types.options import PlanesMethod
from ringpose.types.rig import LaserPlanes


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanesModel:
    """What is estimated, and how."""

    names: tuple[str, ...]
    """Of the lasers, in the order of a shot's mask bits."""
    method: PlanesMethod = PlanesMethod.JOINT
    order: tuple[int, ...] | None = None
    """Lasers in the order in which their stripes cross the image, for frames with all lasers on."""
    free_camera: bool = False
    """Let boards and stripes improve the camera, from its covariance; only in the joint method."""


def calibrate_planes(views: Sequence[StripeView], camera: Camera, model: PlanesModel) -> PlanesCalibration:
    """The light planes in the camera frame, with what each view says about each of them."""
    views = [replace(view, board=without_distortion_bias(view.board, camera)) for view in views]
    poses = [_poses(view, camera, model.method) for view in views]
    evidence, remarks, contradicting = stripe_evidence(views, poses, camera, model.names, model.order)
    solution = _solution(evidence, model)
    lasers = tuple(_laser(laser, evidence, solution) for laser in range(len(model.names)))
    return PlanesCalibration(
        camera=solution.camera,
        planes=_planes(lasers),
        covariance=solution.covariance,
        method=model.method.value,
        lasers=lasers,
        poses=solution.poses,
        remarks=tuple(remarks),
        contradicting=tuple(contradicting),
        excess=solution.excess,
    )


HeldOut = Sequence[Sequence[FittedPlane | None]]
"""By laser and view: the plane of the other views; None where they determine none."""


class PlaneSolution(NamedTuple):
    """What a method found."""

    planes: tuple[FittedPlane, ...]
    poses: tuple[BoardPose, ...]
    camera: Camera
    corner_points: Sequence[Sequence[Points]]
    """By laser and view: the stripes on boards where their corners alone have them."""
    held_out: HeldOut
    covariance: ParameterCovariance | None = None
    excess: float = 1.0
    disagreement: tuple[float, ...] | None = None


def _solution(evidence: StripeEvidence, model: PlanesModel) -> PlaneSolution:
    if model.method is not PlanesMethod.JOINT:
        return separate_solution(evidence, model.method)
    try:
        return joint_solution(evidence, model.free_camera)
    except np.linalg.LinAlgError as error:
        found = "corners and stripes contradict one another so far that no boards and planes fit them"
        raise DataError("calibrate-planes", found, "measure the board's sizes; check board and camera file") from error


def _poses(view: StripeView, camera: Camera, method: PlanesMethod) -> list[BoardPose]:
    """The board's pose; and the mirrored one where the corners cannot tell."""
    if method is PlanesMethod.PAPER:
        return [marker_average_pose(view.board, camera)]
    return board_poses(view.board, camera)


def _laser(laser: int, evidence: StripeEvidence, solution: PlaneSolution) -> LaserCalibration:
    """One laser's plane, the points of its views where the solution has them, held out where the corners have them."""
    plane = solution.planes[laser]
    by_corners = solution.corner_points[laser]
    views = []
    for index, view in enumerate(evidence.views):
        if not len(by_corners[index]):
            continue
        pose, other = solution.poses[index], solution.held_out[laser][index]
        points = triangulated(view.stripes_px[laser], pose, solution.camera)
        unknown = np.full(len(points), np.nan)
        views.append(
            LaserView(
                name=view.board.name,
                points=points,
                residual_m=points @ plane.normal - plane.distance_m,
                held_out_m=unknown if other is None else by_corners[index] @ other.normal - other.distance_m,
            )
        )
    disagreement = float("nan") if solution.disagreement is None else solution.disagreement[laser]
    return laser_calibration(evidence.names[laser], plane, views, disagreement)


def _planes(lasers: Sequence[LaserCalibration]) -> LaserPlanes:
    return LaserPlanes(
        names=tuple(laser.name for laser in lasers),
        normal=np.stack([laser.normal for laser in lasers]),
        distance_m=np.array([laser.distance_m for laser in lasers]),
        projector_m=np.full((len(lasers), 3), np.nan),
    )


_SIGMA_ROUNDS = 5

_SETTLED = 0.95
"""Share of the corners' standard deviation below which a smaller one is tried."""


def separate_solution(evidence: StripeEvidence, method: PlanesMethod) -> PlaneSolution:
    """Each laser by itself, the boards where their corners have them."""
    points = [evidence.points(laser) for laser in range(len(evidence.names))]
    views = range(len(evidence.views))
    return PlaneSolution(
        planes=tuple(fitted_plane(name, own, method) for name, own in zip(evidence.names, points, strict=True)),
        poses=evidence.poses,
        camera=evidence.camera,
        corner_points=points,
        held_out=[[plane_without(own, view, method) for view in views] for own in points],
    )


def joint_solution(evidence: StripeEvidence, free_camera: bool) -> PlaneSolution:
    """Boards, lasers and, if it is free, the camera together, from where each by itself has them."""
    points = [evidence.points(laser) for laser in range(len(evidence.names))]
    nearest = PlanesMethod.TOTAL_LEAST_SQUARES
    start = [fitted_plane(name, own, nearest) for name, own in zip(evidence.names, points, strict=True)]
    data, fit = _fit(evidence, start, free_camera)
    held = data.with_camera(fit.state.camera) if free_camera else data
    excess = variance_excess(held, fit)
    return PlaneSolution(
        planes=_solved_planes(fit, start),
        poses=fit.state.poses,
        camera=fit.state.camera,
        corner_points=_seen_by(evidence, fit.state.camera) if free_camera else points,
        held_out=_held_out(points, held, fit),
        covariance=planes_covariance(evidence.names, fit, evidence.camera, excess, free_camera),
        excess=excess,
        disagreement=laser_disagreements(held, fit),
    )


def _fit(evidence: StripeEvidence, start: Sequence[FittedPlane], free_camera: bool) -> tuple[JointData, JointFit]:
    """The fit with the corners' errors as the fit has them: stray corners, which it resists, bend single boards."""
    corner_px = corner_sigmas_px(evidence.views, evidence.poses, evidence.camera)
    data = joint_data(evidence.views, evidence.camera, corner_px, free_camera)
    fit = joint_fit(data, _state(start, evidence.poses, evidence.camera))
    for _ in range(_SIGMA_ROUNDS):
        corner_px = corner_sigmas_px(evidence.views, fit.state.poses, fit.state.camera)
        if np.all(corner_px > _SETTLED * data.corner_px):
            break
        data = replace(data, corner_px=corner_px)
        fit = joint_fit(data, fit.state)
    taken = int(free_parameters(evidence.camera).sum()) if free_camera else 0
    wider = with_shared_errors(data.corner_px, evidence.views, fit.state.poses, fit.state.camera, taken)
    data = replace(data, corner_px=wider)
    return data, joint_fit(data, fit.state)


def _state(planes: Sequence[FittedPlane], poses: Sequence[BoardPose], camera: Camera) -> JointState:
    return JointState(
        poses=tuple(poses),
        normal=np.stack([plane.normal for plane in planes]),
        distance_m=np.array([plane.distance_m for plane in planes]),
        camera=camera,
    )


def _seen_by(evidence: StripeEvidence, camera: Camera) -> list[list[Points]]:
    """The stripes on the boards as another camera has them."""
    poses = tuple(board_pose(view.board, camera) for view in evidence.views)
    seen = replace(evidence, camera=camera, poses=poses)
    return [seen.points(laser) for laser in range(len(seen.names))]


def _solved_planes(fit: JointFit, start: Sequence[FittedPlane]) -> tuple[FittedPlane, ...]:
    pairs = zip(fit.state.normal, fit.state.distance_m.tolist(), start, strict=True)
    return tuple(FittedPlane(*downward(normal, distance_m), old.condition) for normal, distance_m, old in pairs)


def _held_out(points: Sequence[Sequence[Points]], data: JointData, fit: JointFit) -> HeldOut:
    """The planes without each view in turn; those of lasers that are then undetermined take no part."""
    by_view = []
    for view in range(len(data.views)):
        determined = [determined_without(own, view) for own in points]
        by_view.append(_without_view(data, fit, view, determined))
    return list(zip(*by_view, strict=True))


def _without_view(
    data: JointData, fit: JointFit, left_out: int, determined: Sequence[bool]
) -> list[FittedPlane | None]:
    if not any(determined):
        return [None] * len(determined)
    rest = data.without_view(left_out)
    for laser, known in enumerate(determined):
        rest = rest if known else rest.without_laser(laser)
    poses = fit.state.poses[:left_out] + fit.state.poses[left_out + 1 :]
    state = joint_fit(rest, replace(fit.state, poses=poses)).state
    planes = zip(state.normal, state.distance_m.tolist(), determined, strict=True)
    return [FittedPlane(normal, distance_m, np.nan) if known else None for normal, distance_m, known in planes]
