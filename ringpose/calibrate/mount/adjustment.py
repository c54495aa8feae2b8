"""Joint maximum likelihood of the mount, the board and the robot's errors (ringpose-method(7), section 13).

Each view shows the board at T_i = X^-1 G_i Y. G_i is the robot's pose with an error of its own: measured_i exp(eps_i),
eps_i = (rotation vector, translation) in the tool frame, normal with the standard deviations s_r (rad) and s_t (m). The
unknowns are X, Y, all eps_i, the two standard deviations and, if it is refined, the camera; the residuals are those of
the corners.

Within an iteration the corners of a view are six numbers: the correction z_i of its pose, with covariance C_i. Without
the eps_i they have the covariance V_i = C_i + D_i S D_i^T, and z_i = A_i x + noise: a linear model, whose restricted
likelihood (Patterson and Thompson 1971) gives s_r and s_t without the bias by the parameters that were estimated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ringpose.calibrate.boards.corner_errors import moderated_variances, view_equations
from ringpose.calibrate.boards.pose import board_pose
from ringpose.calibrate.camera.parameters import camera_with, parameters_of
from ringpose.calibrate.mount.closed_form import Transform, moving_from_fixed
from ringpose.calibrate.mount.moving import DELAY_PRIOR_S
from ringpose.calibrate.mount.stations import Station
from ringpose.calibrate.mount.stripes import NO_PLANES, Planes, equations_with_stripes
from ringpose.calibrate.mount.variances import ErrorModel, most_likely
from ringpose.geometry.camera_motion import left_jacobian
from ringpose.geometry.least_squares import covariance_of_free
from ringpose.geometry.ring import rotation_by
from ringpose.geometry.rotations import rotation_vector, skew
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.board import BoardPose
from ringpose.types.rig import Camera

PRIOR_ROTATION_RAD, PRIOR_TRANSLATION_M = float(np.radians(0.02)), 1e-4
"""A robot's error that is assumed where fewer than `MIN_FREE_VIEWS` views show it."""

PRIOR_FACTOR = 3.0
"""Standard deviation of that prior, as a factor: it is normal in the logarithm."""

MIN_FREE_VIEWS = 8
"""Views from which the robot's error is estimated from them alone."""

ROTATION_BOUNDS_RAD, TRANSLATION_BOUNDS_M = (1e-6, 0.05), (1e-6, 0.05)
"""Bounds of the estimated standard deviations: 1 um and 0.2 arc seconds are better than any robot."""

MIN_CORNER_PX = 0.01
"""Lower limit of the standard deviation of a corner's coordinate."""

STAMP_BOUNDS_S = (1e-5, 0.1)
"""Bounds of the standard deviation of the stamps of single images, about the delay."""

AT_BOUND = 0.9
"""Share of an upper bound from which it counts as reached: 45 mm or 2.6 degrees, or 90 ms."""

_ITERATIONS = 12
_MIN_STEP = 1e-3
"""Mahalanobis length of a step below which the iteration has converged."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MountState:
    """The unknowns of the adjustment."""

    mount: Transform
    """X: tool_from_camera, or base_from_camera of a camera that looks at the robot from outside."""
    board: Transform
    """Y: base_from_board, or tool_from_board."""
    true_poses: tuple[Transform, ...]
    """base_from_tool of each view, with the robot's error removed."""
    camera: Camera
    delay_s: float = 0.0
    """The robot's stamp less that of the camera, of a robot that moves."""
    planes: Planes = NO_PLANES
    """The light planes, if the stripes are adjusted, too."""


class RobotSigmas(NamedTuple):
    """Standard deviations of the robot's error, each axis."""

    rotation_rad: float
    translation_m: float

    @property
    def variances(self) -> Float64[Array, "6"]:
        """Variances of an eps_i."""
        return np.repeat([self.rotation_rad**2, self.translation_m**2], 3)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewNumbers:
    """The linear model of all views at a state: z = A x + D eps + noise of covariance C, as corrections of poses."""

    z: Float64[Array, "view 6"]
    covariance: Float64[Array, "view 6 6"]
    wrt_common: Float64[Array, "view 6 common"]
    """With respect to X, Y (rotation vector, translation, each in its frame), the delay if the robot moves, the light
    planes, and the camera's parameters if it is refined; 0 for those that are held."""
    wrt_error: Float64[Array, "view 6 6"]
    wrt_stamp: Float64[Array, "view 6"]
    """With respect to the stamp of the view; zero if the robot was at rest."""
    camera_information: Float64[Array, "view common common"]
    """Information about the light planes and the camera that does not depend on the pose."""
    camera_gradient: Float64[Array, "view common"]
    wrt_camera: Float64[Array, "view 6 parameter"]
    """With respect to all of the camera's parameters, also if they are held fixed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MountSolution:
    """The result of the adjustment."""

    state: MountState
    sigmas: RobotSigmas
    corner_px: Float64[Array, "view"]
    numbers: ViewNumbers
    information: Float64[Array, "view common common"]
    gradient: Float64[Array, "view common"]
    prior: Float64[Array, "common common"]
    pull: Float64[Array, "common"]
    """What the camera's prior adds to the gradient, with the opposite sign."""
    residual_rms_px: Float64[Array, "view"]
    boards: tuple[BoardPose, ...]
    """The board in the camera, by the state."""
    covariance: Float64[Array, "common common"]
    """Of X, Y (rotation vector, translation, each in its frame), delay, light planes and refined camera, by the
    likelihood."""
    has_delay: bool = False
    """Whether the delay is one of the unknowns."""
    stamp_sd_s: float = 0.0
    """Standard deviation of the stamps of single images about the delay, of a robot that moves."""

    @property
    def weights(self) -> Float64[Array, "view 6 6"]:
        """Inverse covariance of each view's correction."""
        return inverse_marginal(self.numbers, self.sigmas)


def adjusted_mount(
    stations: Sequence[Station],
    camera: Camera,
    start: tuple[Transform, Transform],
    *,
    eye_to_hand: bool = False,
    refine_camera: bool = False,
    poses: Sequence[BoardPose] = (),
    planes: Planes = NO_PLANES,
) -> MountSolution:
    """The mount by maximum likelihood over the corners, with the robot's errors as unknowns.

    With `planes`, the start of the light planes, these are unknowns, too, by the stripes of the stations; the camera
    has to be refined. The iteration is not that of `geometry.least_squares`: the variances of the robot's errors are
    estimated between its steps.
    """
    poses = poses or [board_pose(station.view, camera) for station in stations]
    corner_px = corner_sigmas(stations, poses, camera)
    has_delay = stations[0].has_delay
    state = MountState(
        mount=start[0], board=start[1], true_poses=tuple(one.base_from_tool for one in stations), camera=camera,
        delay_s=stations[0].delay_s, planes=planes,
    )  # fmt: skip
    free = _free(camera) if refine_camera else None
    # the robot's error starts large, so that the first iterations follow the corners and not the closed form
    sigmas, stamp_sd_s = RobotSigmas(1e-2, 1e-2), 0.0
    prior = _prior(camera, refine_camera, camera_from(has_delay) + planes.parameters, has_delay)
    for iteration in range(_ITERATIONS):
        numbers = view_numbers(stations, state, corner_px, eye_to_hand, free)
        if iteration and has_delay:
            sigmas, stamp_sd_s = moving_sigmas(numbers, prior, None if iteration == 1 else (sigmas, stamp_sd_s))
        elif iteration:
            sigmas = robot_sigmas(numbers, prior, None if iteration == 1 else sigmas)
        numbers = _with_stamps(numbers, stamp_sd_s)
        information, gradient = _normal_equations(numbers, sigmas)
        pull = prior @ _offset(state, camera, has_delay, len(prior))
        total, right = information.sum(axis=0) + prior, gradient.sum(axis=0) - pull
        step = covariance_of_free(total) @ right
        length = float(np.sqrt(max(step @ total @ step, 0.0)))
        if iteration > 1 and length < _MIN_STEP:
            break
        state, stations = _moved(state, stations, numbers, sigmas, stamp_sd_s, step)
    else:  # the last step is not in the linear model yet
        numbers = _with_stamps(view_numbers(stations, state, corner_px, eye_to_hand, free), stamp_sd_s)
    shown = list(zip(stations, _poses(state, eye_to_hand), strict=True))
    residuals = [view_equations(one.view, pose, state.camera, 1.0).residual for one, pose in shown]
    rms_px = np.array([np.sqrt(2.0 * np.mean(each**2)) for each in residuals])
    information, gradient = _normal_equations(numbers, sigmas)
    return MountSolution(
        state=state, sigmas=sigmas, corner_px=corner_px, numbers=numbers, information=information, gradient=gradient,
        prior=prior, pull=prior @ _offset(state, camera, has_delay, len(prior)),
        boards=tuple(pose for _, pose in shown), residual_rms_px=rms_px,
        covariance=covariance_of_free(information.sum(axis=0) + prior), has_delay=has_delay, stamp_sd_s=stamp_sd_s,
    )  # fmt: skip


def corner_sigmas(stations: Sequence[Station], poses: Sequence[BoardPose], camera: Camera) -> Float64[Array, "view"]:
    """Standard deviation of a corner's coordinate in each view, from the residuals at the view's own pose."""
    squares, rows = [], []
    for station, pose in zip(stations, poses, strict=True):
        residual = view_equations(station.view, pose, camera, 1.0).residual
        squares.append(float(residual @ residual))
        rows.append(float(len(residual)))
    variances = moderated_variances(np.array(squares), np.maximum(np.array(rows) - 6.0, 1.0))
    return np.maximum(np.sqrt(variances), MIN_CORNER_PX)


def _poses(state: MountState, eye_to_hand: bool) -> list[BoardPose]:
    """The board in the camera, by the state."""
    back = state.mount.inverse()
    poses = [back.after(moving_from_fixed(true, eye_to_hand).after(state.board)) for true in state.true_poses]
    return [
        BoardPose(name="", rotation=one.rotation, translation_m=one.translation_m, residual_rms_px=0.0) for one in poses
    ]


def view_numbers(
    stations: Sequence[Station],
    state: MountState,
    corner_px: Float64[Array, "view"],
    eye_to_hand: bool,
    free: Bool[Array, "parameter"] | None,
) -> ViewNumbers:
    """The linear model of the views at a state; `free`: which of the camera's parameters are refined, if any are."""
    first = camera_from(stations[0].has_delay)
    shared = state.planes.parameters
    count = first + (0 if free is None else shared + len(free))
    rows: list[tuple[Float64[Array, "..."], ...]] = []
    back = state.mount.rotation.T
    for station, pose, true, sigma in zip(
        stations, _poses(state, eye_to_hand), state.true_poses, corner_px.tolist(), strict=True
    ):
        equations = equations_with_stripes(station.view, station.stripes, pose, state.camera, state.planes, sigma)
        # OpenCV differentiates by the rotation vector; here a rotation is turned from the left
        by_turn = equations.wrt_pose[:, :3] @ np.linalg.inv(left_jacobian(rotation_vector(pose.rotation)))
        basis, triangle = np.linalg.qr(np.column_stack([by_turn, equations.wrt_pose[:, 3:]]))
        inverse = np.linalg.inv(triangle)
        wrt_camera = inverse @ (basis.T @ equations.wrt_camera)
        outside = equations.wrt_camera - basis @ (basis.T @ equations.wrt_camera)

        measured = station.base_from_tool
        error = np.append(
            rotation_vector(measured.rotation.T @ true.rotation),
            measured.rotation.T @ (true.translation_m - measured.translation_m),
        )
        robot = moving_from_fixed(true, eye_to_hand)
        middle = robot.after(state.board)  # M: the board in the frame in which the camera is at rest
        wrt_middle = np.kron(np.eye(2), back)
        wrt_mount = -wrt_middle.copy()
        wrt_mount[3:, :3] = back @ skew(middle.translation_m - state.mount.translation_m)
        wrt_board = wrt_middle @ np.kron(np.eye(2), robot.rotation)
        wrt_error = np.zeros((6, 6))
        if eye_to_hand:
            wrt_error[:3, :3], wrt_error[3:, 3:] = robot.rotation, robot.rotation
            wrt_error[3:, :3] = -robot.rotation @ skew(state.board.translation_m)
        else:
            wrt_error[:3, :3], wrt_error[3:, 3:] = -np.eye(3), -np.eye(3)
            wrt_error[3:, :3] = skew(middle.translation_m)
        wrt_error = wrt_middle @ wrt_error
        information, gradient = np.zeros((count, count)), np.zeros(count)
        common = np.zeros((6, count))
        common[:, :6], common[:, 6:12] = wrt_mount, wrt_board
        wrt_stamp = wrt_error @ station.twist  # a later pose is displaced like a wrong one
        common[:, 12:first] = wrt_stamp[:, None]
        if free is not None:
            outside[:, shared:] *= free
            common[:, first:] = wrt_camera * np.append(np.ones(shared), free)
            information[first:, first:], gradient[first:] = outside.T @ outside, outside.T @ equations.residual
        between = wrt_error * station.interpolation_sd
        z = inverse @ (basis.T @ equations.residual) + wrt_error @ error
        covariance = inverse @ inverse.T + between @ between.T
        rows.append((z, covariance, common, wrt_error, wrt_stamp, information, gradient, wrt_camera[:, shared:]))
    columns = [np.array(each) for each in zip(*rows, strict=True)]
    return ViewNumbers(
        z=columns[0], covariance=columns[1], wrt_common=columns[2], wrt_error=columns[3],
        wrt_stamp=columns[4], camera_information=columns[5], camera_gradient=columns[6], wrt_camera=columns[7],
    )  # fmt: skip


def _with_stamps(numbers: ViewNumbers, stamp_sd_s: float) -> ViewNumbers:
    """With the errors of the stamps of single images as part of the noise."""
    shift = stamp_sd_s * numbers.wrt_stamp
    return replace(numbers, covariance=numbers.covariance + shift[:, :, None] * shift[:, None])


def _marginal(numbers: ViewNumbers, sigmas: RobotSigmas) -> Float64[Array, "view 6 6"]:
    """V_i = C_i + D_i S D_i^T."""
    spread = numbers.wrt_error * sigmas.variances
    return numbers.covariance + spread @ numbers.wrt_error.swapaxes(1, 2)


def inverse_marginal(numbers: ViewNumbers, sigmas: RobotSigmas) -> Float64[Array, "view 6 6"]:
    """Inverse covariance of each view's correction, the robot's error included."""
    weights: Float64[Array, "view 6 6"] = np.linalg.inv(_marginal(numbers, sigmas))
    return weights


def _normal_equations(
    numbers: ViewNumbers, sigmas: RobotSigmas
) -> tuple[Float64[Array, "view common common"], Float64[Array, "view common"]]:
    weighted = numbers.wrt_common.swapaxes(1, 2) @ inverse_marginal(numbers, sigmas)
    information = weighted @ numbers.wrt_common + numbers.camera_information
    return information, (weighted @ numbers.z[..., None])[..., 0] + numbers.camera_gradient


def robot_sigmas(
    numbers: ViewNumbers, prior: Float64[Array, "common common"], start: RobotSigmas | None = None
) -> RobotSigmas:
    """The robot's error by restricted maximum likelihood within bounds; with few views by its prior, too."""
    return RobotSigmas(*_likeliest(numbers, prior, _USUAL_STARTS if start is None else [start]))


def moving_sigmas(
    numbers: ViewNumbers, prior: Float64[Array, "common common"], start: tuple[RobotSigmas, float] | None = None
) -> tuple[RobotSigmas, float]:
    """The same of a robot that moves, with the standard deviation of the stamps of single images."""
    starts = [(*one, 3e-4) for one in _USUAL_STARTS] if start is None else [(*start[0], start[1])]
    rotation_rad, translation_m, stamp_sd_s = _likeliest(numbers, prior, starts)
    return RobotSigmas(rotation_rad, translation_m), stamp_sd_s


_USUAL_STARTS = ((5e-4, 5e-4), (PRIOR_ROTATION_RAD, PRIOR_TRANSLATION_M))


def _likeliest(
    numbers: ViewNumbers, prior: Float64[Array, "common common"], starts: Sequence[Sequence[float]]
) -> list[float]:
    """The likeliest standard deviations from several starts: of the robot's error and, if given, of the stamps."""
    count = len(starts[0])
    errors = (numbers.wrt_error[:, :, :3], numbers.wrt_error[:, :, 3:], numbers.wrt_stamp[:, :, None])[:count]
    mean, precision = np.zeros(count), np.zeros((count, count))
    if len(numbers.z) < MIN_FREE_VIEWS:
        mean[:2] = 2.0 * np.log([PRIOR_ROTATION_RAD, PRIOR_TRANSLATION_M])
        precision[:2, :2] = (2.0 * np.log(PRIOR_FACTOR)) ** -2 * np.eye(2)
    model = ErrorModel(
        z=numbers.z, covariance=numbers.covariance, design=numbers.wrt_common, errors=errors,
        known=numbers.camera_information.sum(axis=0) + prior, gradient=numbers.camera_gradient.sum(axis=0),
        prior_mean=mean, prior_precision=precision,
    )  # fmt: skip
    lower, upper = 2.0 * np.log([ROTATION_BOUNDS_RAD, TRANSLATION_BOUNDS_M, STAMP_BOUNDS_S]).T[:, :count]
    found = [most_likely(model, 2.0 * np.log(start), (lower, upper)) for start in starts]
    sds: list[float] = np.exp(0.5 * max(found, key=lambda entry: entry[1].log_density)[0]).tolist()
    return sds


def camera_from(has_delay: bool) -> int:
    """Index of the first parameter of light planes and camera, behind X, Y and the delay of a robot that moves."""
    return 12 + has_delay


def _free(camera: Camera) -> Bool[Array, "parameter"]:
    """Which parameters of the camera are refined: those with a standard deviation above zero, or all without one."""
    count = len(parameters_of(camera))
    return np.ones(count, dtype=bool) if camera.covariance is None else np.diag(camera.covariance.data) > 0


def _prior(camera: Camera, refine_camera: bool, first: int, has_delay: bool) -> Float64[Array, "common common"]:
    """Information about the common parameters that does not come from the views: the delay's bounds, the camera.

    `first`: index of the camera's first parameter.
    """
    parameters = len(parameters_of(camera)) if refine_camera else 0
    prior = np.zeros((first + parameters, first + parameters))
    if has_delay:
        prior[12, 12] = DELAY_PRIOR_S**-2
    if refine_camera and camera.covariance is not None:
        prior[first:, first:] = covariance_of_free(camera.covariance.data)
    return prior


def _offset(state: MountState, given: Camera, has_delay: bool, parameters: int) -> Float64[Array, "common"]:
    """How far the state is from what the prior expects."""
    offset, first = np.zeros(parameters), camera_from(has_delay) + state.planes.parameters
    offset[12 : camera_from(has_delay)] = state.delay_s
    if parameters > first:
        offset[first:] = parameters_of(state.camera) - parameters_of(given)
    return offset


def _moved(
    state: MountState, stations: Sequence[Station], numbers: ViewNumbers, sigmas: RobotSigmas, stamp_sd_s: float,
    step: Float64[Array, "common"],
) -> tuple[MountState, list[Station]]:  # fmt: skip
    """State and stations after a step of the common parameters, with the most likely error of each pose."""
    rest = numbers.z - numbers.wrt_common @ step
    by_stamp = stamp_sd_s * np.array([station.twist for station in stations])
    spread = np.diag(sigmas.variances) + by_stamp[:, :, None] * by_stamp[:, None]
    gain = spread @ numbers.wrt_error.swapaxes(1, 2) @ inverse_marginal(numbers, sigmas)
    errors = (gain @ rest[..., None])[..., 0]
    first = camera_from(stations[0].has_delay)
    delay_s = state.delay_s + float(step[12:first].sum())
    stations = [station.at(delay_s) for station in stations]
    true_poses = tuple(
        Transform(
            one.base_from_tool.rotation @ rotation_by(error[:3]),
            one.base_from_tool.translation_m + one.base_from_tool.rotation @ error[3:],
        )
        for one, error in zip(stations, errors, strict=True)
    )
    last = first + state.planes.parameters
    refined = len(step) > last
    camera = camera_with(parameters_of(state.camera) + step[last:], state.camera) if refined else state.camera
    moved_state = MountState(
        mount=_turned(state.mount, step[:6]), board=_turned(state.board, step[6:12]), true_poses=true_poses,
        camera=camera, delay_s=delay_s, planes=state.planes.moved(step[first:last]),
    )  # fmt: skip
    return moved_state, stations


def _turned(transform: Transform, step: Float64[Array, "6"]) -> Transform:
    return Transform(rotation_by(step[:3]) @ transform.rotation, transform.translation_m + step[3:])
