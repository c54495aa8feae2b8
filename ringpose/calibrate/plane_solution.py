"""The light planes of a set of views by each method, and those of the views less one."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ringpose.calibrate.board_pose import board_pose
from ringpose.calibrate.corner_sigmas import corner_sigmas_px, with_shared_errors
from ringpose.calibrate.laser_fit import FittedPlane, Points, determined_without, fitted_plane, plane_without
from ringpose.calibrate.plane_covariance import laser_disagreements, planes_covariance, variance_excess
from ringpose.calibrate.plane_fits import downward
from ringpose.calibrate.plane_joint import (
    JointData,
    JointFit,
    JointState,
    free_parameters,
    joint_data,
    joint_fit,
)
from ringpose.calibrate.stripe_evidence import StripeEvidence
from ringpose.types.board import BoardPose
from ringpose.types.camera import Camera
from ringpose.types.covariance import ParameterCovariance
from ringpose.types.options import PlanesMethod

HeldOut = Sequence[Sequence[FittedPlane | None]]
"""By laser and view: the plane of the other views; None where they determine none."""


_SIGMA_ROUNDS = 5

_SETTLED = 0.95
"""Share of the corners' standard deviation below which a smaller one is tried."""


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
        planes=_planes(fit, start),
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


def _planes(fit: JointFit, start: Sequence[FittedPlane]) -> tuple[FittedPlane, ...]:
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
