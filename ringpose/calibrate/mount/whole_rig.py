"""Camera, light planes and mount from one session, separately and jointly (ringpose-method(7), section 13).

The separate solution is that of the three commands: the camera of the corners, planes with this camera, the mount with
this camera. The joint one adjusts all of them at once by corners, stripes and robot poses: a stripe on a board whose
place in the base is common to all views ties camera and planes to the mount. Both are computed without each view in
turn. What they then predict of it decides: how far its stripe points, taken to the base by mount and robot pose, are
from the face of the board there, and how far its corners from where they are seen.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ringpose.calibrate.acceptance import marker_size_findings
from ringpose.calibrate.boards.pose import board_pose, residuals
from ringpose.calibrate.camera.bundle_adjustment import camera_solution
from ringpose.calibrate.camera.parameters import CameraModel, parameter_names
from ringpose.calibrate.camera.validation import used_views
from ringpose.calibrate.mount.adjustment import MountSolution, adjusted_mount, camera_from
from ringpose.calibrate.mount.closed_form import Transform, moving_from_fixed
from ringpose.calibrate.mount.pipeline import MountCalibration
from ringpose.calibrate.mount.stations import Station
from ringpose.calibrate.mount.stripes import Planes, Stripes
from ringpose.calibrate.mount.systematic import systematic_error
from ringpose.calibrate.mount.validation import board_scale, left_out, validated_covariance
from ringpose.calibrate.planes.evidence import StripeEvidence
from ringpose.calibrate.planes.joint_adjustment import joint_data
from ringpose.calibrate.planes.pipeline import weighted_fit
from ringpose.calibrate.planes.plane_fit import FittedPlane, determined_without
from ringpose.calibrate.planes.quality import PlanesAssessment, planes_verdict
from ringpose.errors import DataError
from ringpose.geometry.rays import rays
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose
from ringpose.types.calibration import CameraAssessment
from ringpose.types.rig import Camera, ParameterCovariance, laser_parameters

DIFFUSE = 1e6
"""Factor of the camera's covariance as prior of the joint solution: it comes from the same views, and counts for
nothing."""


class Prediction(NamedTuple):
    """A whole rig by some of the views."""

    camera: Camera
    planes: Planes
    mount: Transform
    board: Transform


class HeldOutErrors(NamedTuple):
    """What the other views predict of each view; NaN where they do not determine it."""

    stripes_m: Float64[Array, "view"]
    """Root mean square distance of the view's stripe points in the base from the face of the board there."""
    corners_px: Float64[Array, "view"]
    """Root mean square distance of the view's corners from where they are seen."""

    @property
    def rms_m(self) -> float:
        """Over all views; NaN if there is none."""
        return _rms(self.stripes_m)

    @property
    def rms_px(self) -> float:
        """Over all views; NaN if there is none."""
        return _rms(self.corners_px)


def _rms(values: Float64[Array, "view"]) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WholeRig:
    """The better one of both solutions, and the held-out errors of both."""

    camera: CameraAssessment
    """Of the corners alone."""
    planes: PlanesAssessment
    mount: MountCalibration
    is_joint: bool
    """Which solution `planes` and `mount` are."""
    separate: HeldOutErrors
    joint: HeldOutErrors


def whole_rig(
    camera: CameraAssessment,
    planes: PlanesAssessment,
    evidence: StripeEvidence,
    mount: MountCalibration,
) -> WholeRig:
    """The better one of the separate solution, which is given, and the joint one."""
    stations = _with_stripes(mount.stations, evidence, planes.calibration.excess)
    jointly = _joint(stations, camera.calibration.camera, planes, mount)
    without_one = _separate_without(camera, evidence, planes, mount)
    separate = _held_out(mount, stations, evidence, without_one)
    joint = _held_out(mount, stations, evidence, lambda index: _joint_without(stations, jointly, camera, mount, index))
    is_joint = joint.rms_m < separate.rms_m
    if is_joint:
        mount = _joint_mount(mount, jointly, stations)
    return WholeRig(
        camera=camera,
        planes=_joint_planes(planes, mount, evidence) if is_joint else planes,
        mount=mount,
        is_joint=is_joint,
        separate=separate,
        joint=joint,
    )


def _with_stripes(stations: Sequence[Station], evidence: StripeEvidence, excess: float) -> list[Station]:
    """The stations with the stripes that are used; their errors are enlarged where boards and stripes disagree."""
    corner_px = np.ones(len(evidence.views))  # not used for the stripes' standard deviations
    data = joint_data(evidence.views, evidence.camera, corner_px)
    stripes = {
        view.board.name: Stripes(view.stripes_px, np.sqrt(excess) * center_px)
        for view, center_px in zip(evidence.views, data.center_px, strict=True)
    }
    return [replace(station, stripes=stripes.get(station.name)) for station in stations]


def _joint(
    stations: Sequence[Station], camera: Camera, planes: PlanesAssessment, mount: MountCalibration
) -> MountSolution:
    own = planes.calibration.planes
    state = mount.solution.state
    return adjusted_mount(
        stations, _diffuse(camera), (state.mount, state.board), eye_to_hand=mount.eye_to_hand, refine_camera=True,
        poses=mount.solution.boards, planes=Planes(own.normal, own.distance_m),
    )  # fmt: skip


def _diffuse(camera: Camera) -> Camera:
    known = camera.covariance
    return camera if known is None else replace(camera, covariance=replace(known, data=DIFFUSE * known.data))


def _joint_without(
    stations: Sequence[Station], whole: MountSolution, camera: CameraAssessment, mount: MountCalibration, index: int
) -> Prediction:
    """The joint solution without a view."""
    state = whole.state
    covariance = camera.calibration.camera.covariance
    solution = adjusted_mount(
        [*stations[:index], *stations[index + 1 :]], _diffuse(replace(state.camera, covariance=covariance)),
        (state.mount, state.board), eye_to_hand=mount.eye_to_hand, refine_camera=True,
        poses=[*whole.boards[:index], *whole.boards[index + 1 :]], planes=state.planes,
    )  # fmt: skip
    others = solution.state
    return Prediction(others.camera, others.planes, others.mount, others.board)


def _separate_without(
    camera: CameraAssessment, evidence: StripeEvidence, planes: PlanesAssessment, mount: MountCalibration
) -> Callable[[int], Prediction]:  # fmt: skip
    """The function that gives the separate solution without a view of the mount."""
    corners, model = used_views(camera.calibration), _model_of(camera.calibration.camera)
    state, stations = mount.solution.state, mount.stations
    start = [FittedPlane(laser.normal, laser.distance_m, laser.condition) for laser in planes.calibration.lasers]

    def solved(index: int) -> Prediction:
        name = stations[index].name
        boards = [view for view in corners if view.name != name]
        own = camera_solution(boards, camera.calibration.camera, model).camera
        kept = [number for number, view in enumerate(evidence.views) if view.board.name != name]
        rest = evidence.only(kept)
        rest = replace(rest, camera=own, poses=tuple(board_pose(view.board, own) for view in rest.views))
        _, fitted = weighted_fit(rest, start, False)
        others = [*stations[:index], *stations[index + 1 :]]
        found = adjusted_mount(others, own, (state.mount, state.board), eye_to_hand=mount.eye_to_hand).state
        return Prediction(own, Planes(fitted.normal, fitted.distance_m), found.mount, found.board)

    return solved


def _model_of(camera: Camera) -> CameraModel:
    """The model by which a camera was calibrated."""
    deviations = {} if camera.covariance is None else camera.covariance.standard_deviations
    held = {name for name, sd in deviations.items() if sd == 0.0}
    return CameraModel(
        distortion_model=camera.distortion_model, fix_k3="k3" in held, zero_tangential={"p1", "p2"} <= held
    )


def _held_out(
    mount: MountCalibration, stations: Sequence[Station], evidence: StripeEvidence,
    without: Callable[[int], Prediction],
) -> HeldOutErrors:  # fmt: skip
    """The errors of each view by the solution without it."""
    points = [evidence.points(laser) for laser in range(len(evidence.names))]
    places = {view.board.name: index for index, view in enumerate(evidence.views)}
    stripes_m, corners_px = np.full(len(stations), np.nan), np.full(len(stations), np.nan)
    for index, station in enumerate(stations):
        if not np.isfinite(mount.without.distance_m[index]):
            continue
        place = places.get(station.name)
        lasers = [own for own, each in enumerate(points) if place is not None and determined_without(each, place)]
        try:
            prediction = without(index)
        except (DataError, np.linalg.LinAlgError):
            continue
        stripes_m[index], corners_px[index] = _errors(station, lasers, prediction, mount.eye_to_hand)
    return HeldOutErrors(stripes_m, corners_px)


def _errors(station: Station, lasers: Sequence[int], rig: Prediction, eye_to_hand: bool) -> tuple[float, float]:
    """Distance (m) of a view's stripe points from the face of the board, and of its corners (px), both predicted."""
    robot = moving_from_fixed(station.base_from_tool, eye_to_hand)
    expected = rig.mount.inverse().after(robot.after(rig.board))
    pose = BoardPose(
        name=station.name, rotation=expected.rotation, translation_m=expected.translation_m, residual_rms_px=0.0
    )
    corner_px = residuals(station.view, pose, rig.camera)
    board_from_camera = expected.inverse()
    heights_m = [np.empty(0)]
    for laser in lasers if station.stripes is not None else ():
        ray = rays(station.stripes.points_px[laser], rig.camera) if station.stripes is not None else np.empty((0, 3))
        points = ray * (rig.planes.distance_m[laser] / (ray @ rig.planes.normal[laser]))[:, None]
        heights_m.append(points @ board_from_camera.rotation[2] + board_from_camera.translation_m[2])
    every = np.concatenate(heights_m)
    height_m = float(np.sqrt(np.mean(every**2))) if len(every) else float("nan")
    return height_m, float(np.sqrt(np.mean(np.sum(corner_px**2, axis=1))))


def _joint_mount(mount: MountCalibration, solution: MountSolution, stations: Sequence[Station]) -> MountCalibration:
    without = left_out(solution, stations)
    systematic = systematic_error(solution, stations, mount.eye_to_hand)
    validated = validated_covariance(solution, stations, without, None, systematic, mount.eye_to_hand)
    known = np.isfinite(mount.without.distance_m)
    without = without._replace(
        distance_m=np.where(known, without.distance_m, np.nan), angle_rad=np.where(known, without.angle_rad, np.nan)
    )
    return replace(
        mount, stations=tuple(stations), solution=solution, covariance=validated.covariance,
        pose_covariance=validated.pose_covariance, systematic=systematic, disagreement=validated.disagreement,
        without=without, board_scale=board_scale(solution),
    )  # fmt: skip


def _joint_planes(planes: PlanesAssessment, mount: MountCalibration, evidence: StripeEvidence) -> PlanesAssessment:
    """Camera and planes of the joint solution, their covariance with the robot's error that all views have in common.

    Residuals and held-out errors of each view are those of the separate solution.
    """
    solution, systematic = mount.solution, mount.systematic
    state = solution.state
    share, first = systematic.probability, camera_from(solution.has_delay)
    covariance = ((1.0 - share) * solution.covariance + share * systematic.covariance)[first:, first:]
    camera_first = np.roll(np.arange(len(covariance)), len(covariance) - state.planes.parameters)
    names = parameter_names(state.camera.distortion_model) + laser_parameters(evidence.names)
    own = planes.calibration
    pairs = zip(own.lasers, state.planes.normal, state.planes.distance_m.tolist(), strict=True)
    calibration = replace(
        own,
        camera=state.camera,
        planes=replace(own.planes, normal=state.planes.normal, distance_m=state.planes.distance_m),
        covariance=ParameterCovariance(parameters=names, data=covariance[np.ix_(camera_first, camera_first)]),
        method="joint with the mount",
        lasers=tuple(replace(laser, normal=normal, distance_m=distance_m) for laser, normal, distance_m in pairs),
    )
    board = marker_size_findings([view.board for view in evidence.views])
    return replace(planes, calibration=calibration, verdict=planes_verdict(calibration, (), board, None))
