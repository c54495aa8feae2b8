"""The part of the robot's error that depends systematically on its pose (ringpose-method(7), section 13).

Wrong joint angles and lengths of links turn and move the tool by amounts that change slowly with the robot's pose. What
they have in common in all views is no longer seen, as mount and board take it up, and does not average out. The error
of view i is a random field, half of it a twist that is fixed in the tool and half of it one that is fixed in the base,

    e_i = sqrt(1/2) u_i + sqrt(1/2) Ad_i v_i,    cov(u_i, u_j) = cov(v_i, v_j) = K_ij diag(S_r, S_t),

    K_ij = exp(-(angle_ij^2 + (distance_ij / reach)^2) / (2 CORRELATION_RAD^2)),

beside an independent one (repeatability). Ad_i takes a twist of the base at the robot's foot to the tool. The four
variances are those of the highest restricted likelihood, by Fisher scoring. The estimate itself does not change.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ringpose.calibrate.mount.adjustment import (
    ROTATION_BOUNDS_RAD,
    TRANSLATION_BOUNDS_M,
    MountSolution,
    RobotSigmas,
    Station,
    camera_from,
)
from ringpose.geometry.least_squares import covariance_of_free
from ringpose.geometry.rotations import skew
from ringpose.types.arrays import Array, Float64

CORRELATION_RAD = 1.15
"""Turn over which the error changes: errors act by sines and cosines of the joints' angles. With half of it the part
that all views have in common is taken for half as large, with twice for twice as large."""

MIN_GAIN = 3.0
"""Twice the gain in log likelihood from which the systematic part is taken to be there. Chance gives it once in ten (a
mixture of chi-squared of 0 to 2 degrees of freedom), which makes the covariance too large; doubled, more sessions of an
arm that has such errors are overlooked."""

_ITERATIONS = 30
_MAX_VARIANCE = 0.7
"""Variance of a logarithm of a variance up to which it is taken for Student's: then the covariance is tripled."""


class SystematicError(NamedTuple):
    """What the views show about the systematic part."""

    repeatability: RobotSigmas
    systematic: RobotSigmas
    """Standard deviations of the field, widened by the uncertainty of their estimate."""
    covariance: Float64[Array, "common common"]
    """Of mount, board and delay, with the part of the error that all views have in common."""
    robot: RobotSigmas
    """Standard deviations of a pose of the robot, with both parts."""


def systematic_error(solution: MountSolution, stations: Sequence[Station]) -> SystematicError | None:
    """The systematic part of the robot's error; None if the views do not show that there is one."""
    views = len(stations)
    design = solution.numbers.wrt_common.reshape(6 * views, -1)
    known = solution.prior + solution.numbers.camera_information.sum(axis=0)
    z, own, wrt_error = solution.numbers.z.ravel(), _diagonal(solution.numbers.covariance), solution.numbers.wrt_error
    parts = [_seen(wrt_error, each) for each in (*_independent(views), *_fields(stations))]

    independent = 2.0 * np.log(np.array(solution.sigmas))
    without = _Fit.of(independent, own, parts[:2], design, known, z)
    # the start shares the error between both parts
    with_field = _most_likely(np.append(independent - 1.0, independent + 1.0), own, parts, design, known, z)
    if with_field.minus_two_log_likelihood > without.minus_two_log_likelihood - MIN_GAIN:
        return None
    variances = np.exp(with_field.logarithms)
    spread = np.minimum(np.diag(np.linalg.inv(with_field.information))[2:], _MAX_VARIANCE)
    variances[2:] /= 1.0 - spread  # Student's variance over the normal one, of 2 / spread degrees of freedom
    places_m = [station.base_from_tool.translation_m for station in stations]
    reach_m2 = float(np.mean([place_m @ place_m for place_m in places_m]))
    # what displaces the tool turns it, too: an angle of a joint acts over the reach at most; the other half are lengths
    variances[2] = max(variances[2], variances[3] / (2.0 * reach_m2))
    total = own + sum(variance * part for variance, part in zip(variances.tolist(), parts, strict=True))
    gain = solution.covariance @ design.T @ _diagonal(solution.weights)
    covariance = gain @ total @ gain.T + solution.covariance @ known @ solution.covariance
    common, sds = camera_from(solution.has_delay), np.sqrt(variances)
    # half of the turns are those of the base, at the end of the reach, two of three of them across it
    rotation, translation = variances[0] + variances[2], variances[1] + variances[3] + variances[2] * reach_m2 / 3.0
    return SystematicError(
        repeatability=RobotSigmas(*sds[:2].tolist()),
        systematic=RobotSigmas(*sds[2:].tolist()),
        covariance=covariance[:common, :common],
        robot=RobotSigmas(float(np.sqrt(rotation)), float(np.sqrt(translation))),
    )


class _Fit(NamedTuple):
    """Restricted likelihood of variances, with its derivatives by their logarithms."""

    logarithms: Float64[Array, "part"]
    minus_two_log_likelihood: float
    gradient: Float64[Array, "part"]
    information: Float64[Array, "part part"]

    @classmethod
    def of(
        cls, logarithms: Float64[Array, "part"], own: Float64[Array, "row row"],
        parts: Sequence[Float64[Array, "row row"]], design: Float64[Array, "row common"],
        known: Float64[Array, "common common"], z: Float64[Array, "row"],
    ) -> "_Fit":  # fmt: skip
        """At these logarithms of the variances of the parts, beside the noise of the corners."""
        variances = np.exp(logarithms)
        total = own + sum(variance * part for variance, part in zip(variances.tolist(), parts, strict=True))
        inverse = np.linalg.inv(total)
        weighted = inverse @ design
        covariance = covariance_of_free(design.T @ weighted + known)
        projector = inverse - weighted @ covariance @ weighted.T
        rest = projector @ z
        scaled = [projector @ (variance * part) for variance, part in zip(variances.tolist(), parts, strict=True)]
        gradient = [
            0.5 * (rest @ (variance * part) @ rest - np.trace(each))
            for variance, part, each in zip(variances.tolist(), parts, scaled, strict=True)
        ]
        information = [[0.5 * float((one * other.T).sum()) for other in scaled] for one in scaled]
        free = np.diag(covariance) > 0.0
        determinants = np.linalg.slogdet(total)[1] - np.linalg.slogdet(covariance[np.ix_(free, free)])[1]
        # a weak prior, of a variance of 20 of each logarithm, for what the views do not determine
        return cls(
            logarithms,
            float(determinants + z @ rest),
            np.array(gradient),
            np.array(information) + 0.05 * np.eye(len(parts)),
        )


def _most_likely(
    start: Float64[Array, "part"], own: Float64[Array, "row row"], parts: Sequence[Float64[Array, "row row"]],
    design: Float64[Array, "row common"], known: Float64[Array, "common common"], z: Float64[Array, "row"],
) -> _Fit:  # fmt: skip
    """The variances of the highest restricted likelihood within the bounds of the robot's error."""
    lower = 2.0 * np.log(np.tile([ROTATION_BOUNDS_RAD[0], TRANSLATION_BOUNDS_M[0]], len(parts) // 2))
    fit = _Fit.of(start, own, parts, design, known, z)
    for _ in range(_ITERATIONS):
        step = np.clip(np.linalg.solve(fit.information, fit.gradient), -2.0, 2.0)
        moved = np.maximum(fit.logarithms + step, lower)
        if np.abs(moved - fit.logarithms).max() < 0.02:
            break
        fit = _Fit.of(moved, own, parts, design, known, z)
    return fit


def _independent(views: int) -> tuple[Float64[Array, "view view 6 6"], Float64[Array, "view view 6 6"]]:
    own = np.eye(views)[:, :, None, None]
    return own * _of_rotation(), own * _of_translation()


def _of_rotation() -> Float64[Array, "6 6"]:
    return np.diag([1.0, 1, 1, 0, 0, 0])


def _of_translation() -> Float64[Array, "6 6"]:
    return np.diag([0.0, 0, 0, 1, 1, 1])


def _fields(stations: Sequence[Station]) -> tuple[Float64[Array, "view view 6 6"], Float64[Array, "view view 6 6"]]:
    """Covariances of the errors of two views in a field of unit variance, of rotation and of translation."""
    rotation = np.array([station.base_from_tool.rotation for station in stations])
    position_m = np.array([station.base_from_tool.translation_m for station in stations])
    reach_m = np.sqrt(np.mean(np.sum(position_m**2, axis=1)))
    cosine = (np.einsum("iab,jab->ij", rotation, rotation) - 1.0) / 2.0
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    distance = np.linalg.norm(position_m[:, None] - position_m, axis=2) / reach_m
    correlation = np.exp(-0.5 * (angle**2 + distance**2) / CORRELATION_RAD**2)[:, :, None, None]
    in_tool = np.zeros((len(stations), 6, 6))
    in_tool[:, :3, :3] = in_tool[:, 3:, 3:] = rotation.swapaxes(1, 2)
    in_tool[:, 3:, :3] = [-turn.T @ skew(place) for turn, place in zip(rotation, position_m, strict=True)]
    fields = [
        correlation * 0.5 * (each + np.einsum("iab,bc,jdc->ijad", in_tool, each, in_tool))
        for each in (_of_rotation(), _of_translation())
    ]
    return fields[0], fields[1]


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
