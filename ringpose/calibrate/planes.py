"""Light planes from views of a board with stripes (ringpose-method(7), section 6)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringpose.calibrate.board_pose import board_poses, marker_average_pose
from ringpose.calibrate.laser_fit import laser_calibration
from ringpose.calibrate.lens_bends import without_bends
from ringpose.calibrate.plane_points import triangulated
from ringpose.calibrate.plane_solution import PlaneSolution, joint_solution, separate_solution
from ringpose.calibrate.stripe_evidence import StripeEvidence, stripe_evidence
from ringpose.errors import DataError
from ringpose.types.board import BoardPose
from ringpose.types.calibration import LaserCalibration, LaserView, PlanesCalibration, StripeView
from ringpose.types.camera import Camera
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
    views = [replace(view, board=without_bends(view.board, camera)) for view in views]
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
