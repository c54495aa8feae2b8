"""From shots of a board with stripes to assessed light planes, by each method (method(7), section 6)."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from math import nan
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ringpose.calibrate.acceptance import marker_size_findings
from ringpose.calibrate.boards.corner_errors import corner_sigmas_px, with_shared_errors, without_distortion_bias
from ringpose.calibrate.boards.pose import board_pose, board_poses, marker_average_pose
from ringpose.calibrate.boards.shots import STILL_PX, BoardShots, board_shift_px
from ringpose.calibrate.planes import joint_adjustment, plane_fit
from ringpose.calibrate.planes.covariance import (
    laser_disagreements,
    planes_covariance,
    sheet_height_m,
    variance_excess,
)
from ringpose.calibrate.planes.evidence import Remark, StripeEvidence, stripe_evidence
from ringpose.calibrate.planes.quality import PlanesAssessment, planes_verdict
from ringpose.calibrate.planes.stripes.extraction import stripe_view, triangulated
from ringpose.calibrate.planes.stripes.labels import laser_names, laser_order, lasers_in_masks
from ringpose.detect.stripes import ghost_of_rig
from ringpose.errors import DataError, UsageError
from ringpose.geometry.board import LAYOUTS
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import Board, BoardPose, BoardView
from ringpose.types.calibration import LaserCalibration, LaserView, PlanesCalibration, StripeView, Verdict
from ringpose.types.image import Shot
from ringpose.types.options import PlanesMethod
from ringpose.types.rig import BOW_PARAMETERS, Camera, LaserBow, LaserGhost, LaserPlanes, ParameterCovariance

_SIGMA_ROUNDS = 5
"""Maximum number of re-estimations of the corners' standard deviations."""

_SETTLED = 0.95
"""The adjustment is repeated while a view's corner standard deviation falls below this share of its former value."""

HeldOut = Sequence[Sequence[plane_fit.FittedPlane | None]]
"""By laser and view: the plane of the other views; None where they do not determine one."""


class StripeShots:
    """Accumulator of the shots of a calibration; the first determines the number of lasers if no names are given."""

    def __init__(
        self, boards: BoardShots, camera: Camera, names: str | None, order: str | None, surround_m: float | None = None
    ) -> None:
        self.boards = boards
        self.camera = camera
        self.given_names, self.given_order = names, order
        """Values of --laser-names and --laser-order."""
        self.surround_m = surround_m
        self.names: tuple[str, ...] = ()
        """Names of the lasers, by mask bit; empty before the first shot."""
        self.views: list[StripeView] = []

    def add(self, shot: Shot, board: BoardView) -> StripeView:
        """Add a shot to the calibration and return the stripes on its board; DataError if the shot cannot be used."""
        height, width = shot.images.shape[1:]
        if (width, height) != (self.camera.image_width, self.camera.image_height):
            expected = f"{self.camera.image_width} x {self.camera.image_height}"
            finding = f"{width} x {height} pixels, the camera has {expected}"
            raise DataError(shot.name, finding, "give the camera that took the shots")
        self._check_names(shot)
        shift_px = board_shift_px(shot, board, self.boards.board, self.boards.find_board)
        if shift_px > STILL_PX:
            finding = f"the board, or the camera, moved by {shift_px:.1f} px between its frames"
            raise DataError(shot.name, finding, "left out: hold it still until all frames are taken")
        view = stripe_view(shot, board, self.boards.board, self.camera, self.names, self.surround_m)
        self.views.append(view)
        return view

    def assessment(
        self,
        method: PlanesMethod,
        free_camera: bool = False,
        expected_rad: Sequence[float] = (),
        working_distance_m: float | None = None,
    ) -> PlanesAssessment:
        """The light planes of all views, with verdict and with the paper's method for comparison."""
        order = laser_order(self.given_order, self.names) if self.names else None
        model = PlanesModel(names=self.names, method=method, order=order, free_camera=free_camera)
        pairs = [f"{first} to {second}" for first, second in pairwise(self.names)]
        if len(expected_rad) not in (0, len(pairs)):
            finding = f"has {len(expected_rad)}, must have {len(pairs)}"
            raise UsageError("--expected-angles", finding, f"give {', '.join(pairs)}")
        board = marker_size_findings([view.board for view in self.views])
        try:
            calibration = calibrate_planes(self.views, self.camera, model)
        except DataError as error:  # wrong sizes in the board file may be the reason
            remedies = [*Verdict(findings=board).advice, *([error.remedy] if error.remedy else [])]
            raise DataError(error.location, error.finding, "; ".join(remedies)) from error
        paper = None
        if model.method is not PlanesMethod.PAPER and _has_single_markers(self.boards.board):
            with suppress(DataError):
                paper = calibrate_planes(self.views, self.camera, replace(model, method=PlanesMethod.PAPER))
        return PlanesAssessment(
            calibration=calibration,
            verdict=planes_verdict(calibration, expected_rad, board, working_distance_m),
            paper=paper,
            without_board=tuple(self.boards.without_board),
        )

    def _check_names(self, shot: Shot) -> None:
        """Determine the lasers' names with the first shot; later ones must not refer to other lasers."""
        number = lasers_in_masks(shot)
        if not (self.names or self.given_names or number):
            finding = f"{shot.name} does not state how many lasers are on"
            raise UsageError("--laser-names", finding, "give one name for each laser that there is, seen or not")
        self.names = self.names or laser_names(self.given_names, number)
        if number > len(self.names):
            finding = f"a frame names laser {number}, there are {len(self.names)} ({', '.join(self.names)})"
            raise DataError(shot.name, finding, "give all names with --laser-names, or shots of these lasers")


def check_method(method: PlanesMethod, free_camera: bool, board: Board, camera: Camera) -> None:
    """Raise UsageError if the board or the camera does not support the method."""
    if free_camera and method is not PlanesMethod.JOINT:
        raise UsageError(
            "--free-camera", "only the joint method estimates the camera", "leave it out, or use --method joint"
        )
    if free_camera and camera.covariance is None:
        finding = "the camera has no covariance"
        raise UsageError("--free-camera", finding, "leave it out, or give a camera.yaml of ringpose calibrate-camera")
    if method is PlanesMethod.PAPER and not _has_single_markers(board):
        raise UsageError("--method paper", "averages the poses of single markers, and the board has none")


def _has_single_markers(board: Board) -> bool:
    """Whether the corners are those of single markers, as the paper's method needs them."""
    return LAYOUTS[board.kind].pattern == "markers"


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanesModel:
    """Options of a calibration of the light planes."""

    names: tuple[str, ...]
    """Names of the lasers, in the order of a shot's mask bits."""
    method: PlanesMethod = PlanesMethod.JOINT
    order: tuple[int, ...] | None = None
    """Lasers in the order in which their stripes cross the image, for frames with all lasers on."""
    free_camera: bool = False
    """Estimate the camera too, with its covariance as prior; only in the joint method."""


class PlaneSolution(NamedTuple):
    """Light planes, board poses and covariance, as estimated by one of the methods."""

    planes: tuple[plane_fit.FittedPlane, ...]
    poses: tuple[BoardPose, ...]
    camera: Camera
    corner_points: Sequence[Sequence[plane_fit.Points]]
    """By laser and view: stripe centres in the camera frame, triangulated with board poses from the corners alone."""
    held_out: HeldOut
    covariance: ParameterCovariance | None = None
    excess: float = 1.0
    disagreement: tuple[float, ...] | None = None
    sheet_height_m: tuple[float, float] | None = None
    bows: Mapping[int, LaserBow] = MappingProxyType({})
    """Bends of light planes, by laser."""


def calibrate_planes(views: Sequence[StripeView], camera: Camera, model: PlanesModel) -> PlanesCalibration:
    """The light planes in the camera frame, with the residuals of each view."""
    views = [replace(view, board=without_distortion_bias(view.board, camera)) for view in views]
    evidence, remarks, contradicting = evidence_of(views, camera, model)
    if model.method is PlanesMethod.JOINT:
        solution = joint_solution(evidence, model.free_camera)
    else:
        solution = separate_solution(evidence, model.method)
    lasers = tuple(_laser(laser, evidence, solution) for laser in range(len(model.names)))
    planes = LaserPlanes(
        names=model.names,
        normal=np.stack([laser.normal for laser in lasers]),
        distance_m=np.array([laser.distance_m for laser in lasers]),
        projector_m=np.stack([_projector_m(plane, solution) for plane in solution.planes]),
    )
    return PlanesCalibration(
        camera=solution.camera,
        planes=planes,
        covariance=solution.covariance,
        method=model.method.value,
        lasers=lasers,
        poses=solution.poses,
        remarks=tuple(remarks),
        contradicting=tuple(contradicting),
        excess=solution.excess,
        ghosts=_ghosts(views, model.names),
        bows={model.names[laser]: bow for laser, bow in solution.bows.items()},
        sheet_height_m=solution.sheet_height_m,
    )


def evidence_of(
    views: Sequence[StripeView], camera: Camera, model: PlanesModel
) -> tuple[StripeEvidence, list[Remark], list[Remark]]:
    """The stripes that are used, remarks on the others, and contradicting views; corners without bias by distortion."""
    if model.method is PlanesMethod.PAPER:
        poses = [[marker_average_pose(view.board, camera)] for view in views]
    else:
        poses = [board_poses(view.board, camera) for view in views]
    return stripe_evidence(views, poses, camera, model.names, model.order)


def _ghosts(views: Sequence[StripeView], names: Sequence[str]) -> dict[str, LaserGhost]:
    """By the laser's name, the ghosts that several views show."""
    seen = {
        name: ghost_of_rig([ghost for view in views for of, ghost in view.ghosts if of == laser])
        for laser, name in enumerate(names)
    }
    return {name: ghost for name, ghost in seen.items() if ghost is not None}


def _bows(
    evidence: StripeEvidence, planes: Sequence[plane_fit.FittedPlane], poses: Sequence[BoardPose], camera: Camera
) -> dict[int, LaserBow]:
    """The bends of light planes that the views show, by laser, about the camera's centre."""
    known = replace(camera, covariance=evidence.camera.covariance)
    bows: dict[int, LaserBow] = {}
    for laser, plane in enumerate(planes):
        stripes = [
            (view.stripes_px[laser], pose)
            for view, pose in zip(evidence.views, poses, strict=True)
            if len(view.stripes_px[laser])
        ]
        bow = plane_fit.fitted_bow(stripes, plane, known)
        bows |= {} if bow is None else {laser: bow}
    return bows


def _projector_m(plane: plane_fit.FittedPlane, solution: PlaneSolution) -> Float64[Array, "xyz=3"]:
    """The projector of a bent plane, on the plane, if it was estimated with the bend; else NaN."""
    if plane.bend is None or solution.covariance is None:
        return np.full(3, np.nan)
    return plane.bend.projector_m + plane.distance_m * plane.normal


def _laser(laser: int, evidence: StripeEvidence, solution: PlaneSolution) -> LaserCalibration:
    """Plane of one laser, with the residuals of its points by view.

    Residuals use the board poses of the solution; held-out residuals use those of the corners alone, because the
    solution's poses depend on the stripe itself.
    """
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
                residual_m=plane.off_m(points),
                held_out_m=unknown if other is None else other.off_m(by_corners[index]),
            )
        )
    return LaserCalibration(
        name=evidence.names[laser],
        normal=plane.normal,
        distance_m=plane.distance_m,
        views=tuple(views),
        condition=plane.condition,
        disagreement=float("nan") if solution.disagreement is None else solution.disagreement[laser],
    )


def separate_solution(evidence: StripeEvidence, method: PlanesMethod) -> PlaneSolution:
    """The plane of each laser fitted separately, with board poses from the corners alone."""
    points = [evidence.points(laser) for laser in range(len(evidence.names))]
    views = range(len(evidence.views))
    planes = [plane_fit.fitted_plane(name, own, method) for name, own in zip(evidence.names, points, strict=True)]
    bows = _bows(evidence, planes, evidence.poses, evidence.camera)
    lowered = list(points)
    for laser, bow in bows.items():
        bent = planes[laser]._replace(bend=plane_fit.bend_about_camera(planes[laser], bow.per_rad))
        lowered[laser] = [plane_fit.on_plane(own, bent) for own in points[laser]]
        planes[laser] = plane_fit.fitted_plane(evidence.names[laser], lowered[laser], method)._replace(bend=bent.bend)
    return PlaneSolution(
        planes=tuple(planes),
        poses=evidence.poses,
        camera=evidence.camera,
        corner_points=points,
        held_out=[
            [plane_fit.plane_without(own, view, method, plane.bend) for view in views]
            for own, plane in zip(lowered, planes, strict=True)
        ],
        sheet_height_m=(nan, nan) if evidence.any_beside_print else None,
        bows=bows,
    )


def joint_solution(evidence: StripeEvidence, free_camera: bool) -> PlaneSolution:
    """Board poses, planes and, if it is free, the camera by joint adjustment, started from the separate solution."""
    points = [evidence.points(laser) for laser in range(len(evidence.names))]
    start = [
        plane_fit.fitted_plane(name, own, PlanesMethod.TOTAL_LEAST_SQUARES)
        for name, own in zip(evidence.names, points, strict=True)
    ]
    try:
        data, state = weighted_fit(evidence, start, free_camera)
        shown = _bows(evidence, _planes_of(state, start), state.poses, state.camera)
        if shown:
            data, state = weighted_fit(evidence, _planes_of(state, start), free_camera, shown)
        information, fixed = joint_adjustment.joint_information(data, state), data
        if free_camera:  # from here on the camera is held fixed, with the stripes triangulated by it
            fixed = data.with_camera(state.camera)
            poses = tuple(board_pose(view.board, fixed.camera) for view in evidence.views)
            refined = replace(evidence, camera=fixed.camera, poses=poses)
            points = [refined.points(laser) for laser in range(len(evidence.names))]
        excess = variance_excess(fixed, state)
        covariance = planes_covariance(evidence.names, information, data, excess)
        sd = covariance.standard_deviations
        return PlaneSolution(
            planes=tuple(_planes_of(state, start)),
            poses=state.poses,
            camera=state.camera,
            corner_points=points,
            held_out=_held_out(points, fixed, state),
            covariance=covariance,
            excess=excess,
            disagreement=laser_disagreements(fixed, state),
            sheet_height_m=sheet_height_m(fixed, state, excess) if evidence.any_beside_print else None,
            bows={
                laser: LaserBow(per_rad=bow, sd_per_rad=sd[f"{evidence.names[laser]}.bow"])
                for laser, bow in enumerate([] if state.bow is None else state.bow[:, 0].tolist())
                if laser in shown
            },
        )
    except np.linalg.LinAlgError as error:
        finding = "corners and stripes contradict one another so far that no boards and planes fit them"
        raise DataError(
            "calibrate-planes", finding, "measure the board's sizes; check board and camera file"
        ) from error


def _planes_of(
    state: joint_adjustment.JointState, start: Sequence[plane_fit.FittedPlane]
) -> list[plane_fit.FittedPlane]:
    """The planes of a joint adjustment, with the condition of those that it started from; none has a bend of zero."""
    bends = state.bends
    return [
        plane_fit.FittedPlane(
            *plane_fit.oriented(normal, distance_m),
            plane.condition,
            None if bends is None or not bends.per_rad[laser] else bends.of(laser),
        )
        for laser, (normal, distance_m, plane) in enumerate(
            zip(state.normal, state.distance_m.tolist(), start, strict=True)
        )
    ]


def weighted_fit(
    evidence: StripeEvidence,
    start: Sequence[plane_fit.FittedPlane],
    free_camera: bool,
    bows: Mapping[int, LaserBow] = MappingProxyType({}),
) -> tuple[joint_adjustment.JointData, joint_adjustment.JointState]:
    """Data and result of the joint adjustment, repeated with corner standard deviations estimated from its residuals.

    The bends of the lasers in `bows` are estimated, too, from a start about the camera's centre.
    Outlying corners displace the board poses at the start of the adjustment, but not those of its robust result.
    """
    corner_px = corner_sigmas_px(evidence.views, evidence.poses, evidence.camera)
    data = joint_adjustment.joint_data(evidence.views, evidence.camera, corner_px, free_camera)
    data = replace(data, bent=tuple(bows))
    bow = np.zeros((len(start), len(BOW_PARAMETERS)))
    bow[list(bows), 0] = [each.per_rad for each in bows.values()]
    state = joint_adjustment.JointState(
        poses=tuple(evidence.poses),
        normal=np.stack([plane.normal for plane in start]),
        distance_m=np.array([plane.distance_m for plane in start]),
        camera=evidence.camera,
        bow=bow if bows else None,
    )
    state = joint_adjustment.joint_fit(data, state)
    for _ in range(_SIGMA_ROUNDS):
        corner_px = corner_sigmas_px(evidence.views, state.poses, state.camera)
        if np.all(corner_px > _SETTLED * data.corner_px):
            break
        data = replace(data, corner_px=corner_px)
        state = joint_adjustment.joint_fit(data, state)
    # Last, the standard deviations are widened by errors that a corner has in common to all views (print, bent board).
    free = int(joint_adjustment.free_parameters(evidence.camera).sum()) if free_camera else 0
    corner_px = with_shared_errors(data.corner_px, evidence.views, state.poses, state.camera, free)
    data = replace(data, corner_px=corner_px)
    return data, joint_adjustment.joint_fit(data, state)


def _held_out(
    points: Sequence[Sequence[plane_fit.Points]], data: joint_adjustment.JointData, state: joint_adjustment.JointState
) -> HeldOut:
    """The planes without each view in turn; lasers that are then undetermined do not take part in the adjustment."""
    by_view: list[list[plane_fit.FittedPlane | None]] = []
    for view in range(len(data.views)):
        determined = [plane_fit.determined_without(own, view) for own in points]
        if not any(determined):
            by_view.append([None] * len(determined))
            continue
        rest = data.without_view(view)
        for laser in np.flatnonzero(~np.array(determined)).tolist():
            rest = rest.without_laser(laser)
        poses = state.poses[:view] + state.poses[view + 1 :]
        others = joint_adjustment.joint_fit(rest, replace(state, poses=poses))
        bends = others.bends
        planes = zip(others.normal, others.distance_m.tolist(), determined, strict=True)
        by_view.append(
            [
                plane_fit.FittedPlane(normal, distance_m, np.nan, None if bends is None else bends.of(laser))
                if known
                else None
                for laser, (normal, distance_m, known) in enumerate(planes)
            ]
        )
    return list(zip(*by_view, strict=True))
