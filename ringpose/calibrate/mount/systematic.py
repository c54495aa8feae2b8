"""The part of the robot's error that depends systematically on its pose (ringpose-method(7), section 13).

Wrong joint angles and lengths of links turn and move the tool by amounts that change slowly with the robot's pose. What
they have in common in all views is not seen, as mount and board take it up, and does not average out. How much that is
beside what is seen depends on where the joints' axes are: the errors of all views have the covariance

    cov(e_i, e_j) = s_a^2 A_ij + s_l^2 L_ij + diag(s_r^2, s_t^2) [i = j]

with the fields A of angles and L of lengths (`arms`), averaged over the arms that may have these poses, and an
independent error (repeatability).

Few views do not show whether an error is of this kind. So it is weighed against errors that are independent in each
view, by the evidence of both (restricted likelihoods with priors of the ratios, integrated by Laplace's method); the
covariance is the mean of both. The estimate itself does not change.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ringpose.calibrate.mount.adjustment import (
    MountSolution,
    RobotSigmas,
)
from ringpose.calibrate.mount.arms import error_fields
from ringpose.calibrate.mount.stations import Station
from ringpose.geometry.least_squares import covariance_of_free
from ringpose.geometry.rotations import skew
from ringpose.types.arrays import Array, Float64

RATIO, RATIO_FACTOR = 10.0, 2.0
"""Prior of the systematic part over the repeatability, and its standard deviation as a factor: calibrated robots have a
few, others up to 32 (Slamani, Nubiola and Bonev 2012). The factor is also that between translations by lengths and
those by angles. With it doubled few views do not tell errors of both kinds apart; with half of the ratio an arm that
only repeats badly does not show it."""

USUAL_RAD, USUAL_M, USUAL_FACTOR = 5e-4, 3e-4, 10.0
"""Prior of a robot's error about and along each axis, known by this factor."""

PRIOR_PROBABILITY = 0.5
"""That the error is systematic, before the views are looked at. With 0.9, the mean NEES of the mount by 12 views of an
arm that only repeats badly falls from 0.8 to 0.6, and by 8 views with systematic errors it falls by 0.05."""

POINTS, WIDER = 64, 1.2
"""Points by which a posterior is integrated, drawn from a normal density that is wider by this factor."""

_ITERATIONS = 40


class SystematicError(NamedTuple):
    """What the views show about the systematic part."""

    probability: float
    """That the error depends on the robot's pose; else it is independent in each view."""
    repeatability: RobotSigmas
    systematic: RobotSigmas
    """Standard deviations of the errors of the tool about and along each axis, widened by the uncertainty of their
    estimate; both if there is a systematic part."""
    covariance: Float64[Array, "common common"]
    """Of mount, board and what else is common, if there is one: with the part that all views have in common."""
    pose_covariance: Float64[Array, "6 6"]
    """Of the camera at another pose of the robot (`camera_errors`), if there is one."""


def systematic_error(solution: MountSolution, stations: Sequence[Station], eye_to_hand: bool) -> SystematicError:
    """The systematic part of the robot's error, and how probable it is."""
    views = len(stations)
    design = solution.numbers.wrt_common.reshape(6 * views, -1)
    known = solution.prior + solution.numbers.camera_information.sum(axis=0)
    wrt_error = solution.numbers.wrt_error
    rotation = np.array([station.base_from_tool.rotation for station in stations])
    fields = error_fields(rotation, np.array([station.base_from_tool.translation_m for station in stations]))
    errors = (*_independent(views), *fields)
    parts = tuple(_seen(wrt_error, each) for each in errors)
    own, z = _diagonal(solution.numbers.covariance), solution.numbers.z.ravel()

    independent = 2.0 * np.log(np.array(solution.sigmas))
    moved_m2 = float(np.einsum("iiaa->a", fields.angles)[3:].mean()) / views
    without = _posterior(independent, _Model(own, parts[:2], design, known, z, _prior(2, moved_m2)))
    start = np.append(independent - 2.0 * np.log(RATIO), independent)
    with_field = _posterior(start, _Model(own, parts, design, known, z, _prior(4, moved_m2)))
    odds = (1.0 / PRIOR_PROBABILITY - 1.0) * np.exp(without.log_evidence - with_field.log_evidence)

    variances = with_field.variances
    total = own + sum(variance * part for variance, part in zip(variances.tolist(), parts, strict=True))
    gain = solution.covariance @ design.T @ _diagonal(solution.weights)
    covariance = gain @ total @ gain.T + solution.covariance @ known @ solution.covariance
    wrt_robot, wrt_mount = camera_errors(solution, stations, eye_to_hand)
    of_field = sum(variance * field for variance, field in zip(variances[2:].tolist(), fields, strict=True))
    of_pose = of_field[range(views), range(views)] + np.diag(np.repeat(variances[:2], 3))
    with_mount = np.einsum("ijab,jcb->iajc", of_field, wrt_error).reshape(views, 6, -1) @ gain[:6].T
    both = wrt_robot @ with_mount @ wrt_mount.swapaxes(1, 2)
    pose_covariance = (
        wrt_robot @ of_pose @ wrt_robot.swapaxes(1, 2) + both + both.swapaxes(1, 2)
        + wrt_mount @ covariance[:6, :6] @ wrt_mount.swapaxes(1, 2)
    ).mean(axis=0)  # fmt: skip
    sds = np.sqrt(variances)
    return SystematicError(
        probability=float(1.0 / (1.0 + odds)),
        repeatability=RobotSigmas(*sds[:2].tolist()),
        systematic=RobotSigmas(float(sds[2]), float(np.sqrt(variances[3] + moved_m2 * variances[2]))),
        covariance=covariance,
        pose_covariance=pose_covariance,
    )


def camera_errors(
    solution: MountSolution, stations: Sequence[Station], eye_to_hand: bool
) -> tuple[Float64[Array, "view 6 6"], Float64[Array, "view 6 6"]]:
    """Error of the camera in the frame that needs the robot's pose, by those of the robot and of the mount, at views.

    As rotation vector and translation of the camera, along the axes of the tool: base_from_camera of a camera on the
    tool, tool_from_camera of one beside the robot. The error of the mount is that of its estimate, less the truth.
    """
    mount = solution.state.mount
    wrt_robot, wrt_mount = np.zeros((len(stations), 6, 6)), np.zeros((len(stations), 6, 6))
    for view, station in enumerate(stations):
        tool_from_camera = station.base_from_tool.inverse().after(mount) if eye_to_hand else mount
        at_camera = np.eye(6)
        at_camera[3:, :3] = -skew(tool_from_camera.translation_m)
        wrt_robot[view] = -at_camera if eye_to_hand else at_camera
        wrt_mount[view] = -np.kron(np.eye(2), station.base_from_tool.rotation.T if eye_to_hand else np.eye(3))
    return wrt_robot, wrt_mount


class _Model(NamedTuple):
    """z = design x + noise of the covariance own + sum of variance times part; `known`: information about x."""

    own: Float64[Array, "row row"]
    parts: tuple[Float64[Array, "row row"], ...]
    """Two of independent errors, of rotation and translation; then two of a field."""
    design: Float64[Array, "row common"]
    known: Float64[Array, "common common"]
    z: Float64[Array, "row"]
    prior: tuple[Float64[Array, "part"], Float64[Array, "part part"]]
    """Mean and precision of the logarithms of the variances."""


def _prior(parts: int, moved_m2: float) -> tuple[Float64[Array, "part"], Float64[Array, "part part"]]:
    """The usual error of a robot, known by a factor of 10, and ratios of its parts, known by `RATIO_FACTOR`.

    The ratios are those of angles over repeated rotations, lengths over repeated translations, and translations by
    lengths over those by angles, which are half of the error of a pose each (`moved_m2`: the latter of a unit field).
    """
    usual, wide, narrow = (
        2.0 * np.log([USUAL_RAD, USUAL_M]),
        *((2.0 * np.log(factor)) ** -2 for factor in (USUAL_FACTOR, RATIO_FACTOR)),
    )
    if parts == 2:
        return usual, wide * np.eye(2)
    rows = np.array([[-1.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 1.0], [0.0, 0.0, -1.0, 1.0], [0.0, 0.0, 1.0, 0.0]])
    ratio = 2.0 * np.log(RATIO)
    expected = np.array([ratio, ratio - np.log(2.0), np.log(moved_m2), usual[0]])
    return np.linalg.solve(rows, expected), rows.T @ np.diag([narrow, narrow, narrow, wide]) @ rows


class _Posterior(NamedTuple):
    """What the views show about the variances of a model."""

    log_evidence: float
    variances: Float64[Array, "part"]
    """Their means."""


def _posterior(start: Float64[Array, "part"], model: _Model) -> _Posterior:
    """By Laplace's method, corrected by points that are drawn from it (importance sampling)."""
    from scipy.special import ndtri
    from scipy.stats import qmc

    mode, information = _most_likely(start, model)
    root = np.linalg.inv(np.linalg.cholesky(information)).T
    drawn = ndtri(qmc.Sobol(len(mode), rng=0).random(POINTS)) * WIDER
    logarithms = mode + drawn @ root.T
    log_weight = np.array([_log_density(each, model) for each in logarithms])
    log_weight += 0.5 * np.sum((drawn / WIDER) ** 2, axis=1)
    largest = float(log_weight.max())
    weight = np.exp(log_weight - largest)
    volume = len(mode) * np.log(WIDER) - 0.5 * np.linalg.slogdet(information)[1]
    return _Posterior(largest + float(np.log(weight.mean()) + volume), weight @ np.exp(logarithms) / weight.sum())


def _log_density(logarithms: Float64[Array, "part"], model: _Model) -> float:
    """Of the logarithms of the variances of the parts, beside the noise of the corners; but for a constant."""
    total = model.own + sum(
        variance * part for variance, part in zip(np.exp(logarithms).tolist(), model.parts, strict=True)
    )
    factor = np.linalg.cholesky(total)
    whitened = np.linalg.solve(factor, np.column_stack([model.design, model.z]))
    design, z = whitened[:, :-1], whitened[:, -1]
    information = design.T @ design + model.known
    free = np.diag(information) > 0.0
    information, gradient = information[np.ix_(free, free)], (design.T @ z)[free]
    scale = 1.0 / np.sqrt(np.diag(information))
    scaled = np.linalg.cholesky(information * np.outer(scale, scale))
    shown = np.linalg.solve(scaled, scale * gradient)
    determinants = np.log(np.diag(factor)).sum() + np.log(np.diag(scaled)).sum() - np.log(scale).sum()
    expected, precision = model.prior
    off = logarithms - expected
    return float(
        -determinants - 0.5 * (z @ z - shown @ shown) - 0.5 * off @ precision @ off
        + 0.5 * np.linalg.slogdet(precision)[1]
    )  # fmt: skip


def _most_likely(
    start: Float64[Array, "part"], model: _Model
) -> tuple[Float64[Array, "part"], Float64[Array, "part part"]]:
    """The logarithms of the highest density by Fisher scoring, and their information."""
    own, parts, design, known, z, (expected, precision) = model
    logarithms = start
    for _ in range(_ITERATIONS):
        scaled_parts = [variance * part for variance, part in zip(np.exp(logarithms).tolist(), parts, strict=True)]
        inverse = np.linalg.inv(own + sum(scaled_parts))
        weighted = inverse @ design
        projector = inverse - weighted @ covariance_of_free(design.T @ weighted + known) @ weighted.T
        rest = projector @ z
        scaled = [projector @ each for each in scaled_parts]
        gradient = [
            0.5 * (rest @ part @ rest - np.trace(each)) for part, each in zip(scaled_parts, scaled, strict=True)
        ]
        information = np.array([[0.5 * float((one * other.T).sum()) for other in scaled] for one in scaled]) + precision
        step = np.linalg.solve(information, np.array(gradient) - precision @ (logarithms - expected))
        if np.abs(step).max() < 0.02:
            break
        logarithms = logarithms + np.clip(step, -2.0, 2.0)
    return logarithms, information


def _independent(views: int) -> tuple[Float64[Array, "view view 6 6"], Float64[Array, "view view 6 6"]]:
    own = np.eye(views)[:, :, None, None]
    return own * _of_rotation(), own * _of_translation()


def _of_rotation() -> Float64[Array, "6 6"]:
    return np.diag([1.0, 1, 1, 0, 0, 0])


def _of_translation() -> Float64[Array, "6 6"]:
    return np.diag([0.0, 0, 0, 1, 1, 1])


def _seen(
    wrt_error: Float64[Array, "view 6 6"], covariance: Float64[Array, "view view 6 6"]
) -> Float64[Array, "row row"]:
    """Covariance of the corrections of all views, by that of the robot's errors."""
    seen = np.einsum("iab,ijbc,jdc->iajd", wrt_error, covariance, wrt_error, optimize=True)
    return seen.reshape(6 * len(wrt_error), -1)


def _diagonal(blocks: Float64[Array, "view 6 6"]) -> Float64[Array, "row row"]:
    views = len(blocks)
    matrix = np.zeros((views, 6, views, 6))
    matrix[range(views), :, range(views), :] = blocks
    return matrix.reshape(6 * views, 6 * views)
