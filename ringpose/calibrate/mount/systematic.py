"""The part of the robot's error that depends systematically on its pose (ringpose-method(7), section 13).

Wrong joint angles and lengths of links turn and move the tool by amounts that change slowly with the robot's pose. What
they have in common in all views is no longer seen, as mount and board take it up, and does not average out. The error
of view i is a random field, half of it a twist that is fixed in the tool and half of it one that is fixed in the base,

    e_i = sqrt(1/2) u_i + sqrt(1/2) Ad_i v_i,    cov(u_i, u_j) = cov(v_i, v_j) = K_ij diag(S_r, S_t),

    K_ij = 1 / (1 + (angle_ij^2 + (distance_ij / reach)^2) / 2),

beside an independent one (repeatability). Ad_i takes a twist of the base at the robot's foot to the tool. An error of a
joint's angle or of a link acts by the sine and cosine of the joints' angles: over an angle a it changes as cos(a) does,
which is 1 - a^2 / 2 near 0, as K is. Further away K falls slowly, since parts of the error change with one joint only,
or not at all. There is no length to be tuned.

Few views do not show whether an error is of this kind. So the field, with a repeatability that is smaller by a ratio of
which there is a prior, is weighed against errors that are independent in each view, by the evidence of both (restricted
likelihoods, integrated by Laplace's method); the covariance is the mean of both. The estimate itself does not change.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ringpose.calibrate.mount.adjustment import (
    ROTATION_BOUNDS_RAD,
    TRANSLATION_BOUNDS_M,
    MountSolution,
    RobotSigmas,
)
from ringpose.calibrate.mount.stations import Station
from ringpose.geometry.least_squares import covariance_of_free
from ringpose.geometry.rotations import skew
from ringpose.types.arrays import Array, Float64

RATIO, RATIO_FACTOR = 15.0, 2.0
"""Prior of the systematic part over the repeatability, and its standard deviation as a factor. Slamani, Nubiola and
Bonev (2012) found 17 to 32 before a calibration of the robot; calibrated robots have a few. With the factor doubled few
views do not tell errors of both kinds apart; with half of the ratio an arm that only repeats badly does not show it."""

PRIOR_PROBABILITY = 0.9
"""That the error is systematic, before the views are looked at: a robot whose error is its repeatability alone is the
exception. With one half, the mean NEES of the mount by eight views with systematic errors is 1.3 instead of 1.1; with
0.99, it is too small up to twenty views where the errors are independent."""

_ITERATIONS = 40
_MAX_VARIANCE = 0.7
"""Variance of a logarithm of a variance up to which it is taken for Student's: then the covariance is tripled."""


class SystematicError(NamedTuple):
    """What the views show about the systematic part."""

    probability: float
    """That the error depends on the robot's pose; else it is independent in each view."""
    repeatability: RobotSigmas
    systematic: RobotSigmas
    """Standard deviations of the field, widened by the uncertainty of their estimate; both if there is one."""
    covariance: Float64[Array, "common common"]
    """Of mount, board and what else is common, if there is a field: with the part that all views have in common."""
    robot: RobotSigmas
    """Standard deviations of a pose of the robot, with both parts, if there is a field."""


def systematic_error(solution: MountSolution, stations: Sequence[Station]) -> SystematicError:
    """The systematic part of the robot's error, and how probable it is."""
    views = len(stations)
    design = solution.numbers.wrt_common.reshape(6 * views, -1)
    known = solution.prior + solution.numbers.camera_information.sum(axis=0)
    wrt_error = solution.numbers.wrt_error
    parts = tuple(_seen(wrt_error, each) for each in (*_independent(views), *_fields(stations)))
    own, z = _diagonal(solution.numbers.covariance), solution.numbers.z.ravel()

    independent = 2.0 * np.log(np.array(solution.sigmas))
    without = _most_likely(independent, _Model(own, parts[:2], design, known, z))
    with_field = _most_likely(
        np.append(independent - 2.0 * np.log(RATIO), independent), _Model(own, parts, design, known, z)
    )
    odds = (1.0 / PRIOR_PROBABILITY - 1.0) * np.exp(np.clip(with_field.evidence - without.evidence, -100.0, 100.0) / 2)

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
    sds = np.sqrt(variances)
    # half of the turns are those of the base, at the end of the reach, two of three of them across it
    rotation, translation = variances[0] + variances[2], variances[1] + variances[3] + variances[2] * reach_m2 / 3.0
    return SystematicError(
        probability=float(1.0 / (1.0 + odds)),
        repeatability=RobotSigmas(*sds[:2].tolist()),
        systematic=RobotSigmas(*sds[2:].tolist()),
        covariance=covariance,
        robot=RobotSigmas(float(np.sqrt(rotation)), float(np.sqrt(translation))),
    )


class _Model(NamedTuple):
    """z = design x + noise of the covariance own + sum of variance times part; `known`: information about x."""

    own: Float64[Array, "row row"]
    parts: tuple[Float64[Array, "row row"], ...]
    """Two of independent errors, of rotation and translation; then two of a field."""
    design: Float64[Array, "row common"]
    known: Float64[Array, "common common"]
    z: Float64[Array, "row"]


class _Fit(NamedTuple):
    """Posterior density of the variances, with its derivatives by their logarithms."""

    logarithms: Float64[Array, "part"]
    minus_two_log_density: float
    gradient: Float64[Array, "part"]
    information: Float64[Array, "part part"]

    @classmethod
    def of(cls, logarithms: Float64[Array, "part"], model: _Model) -> "_Fit":
        """At these logarithms of the variances of the parts, beside the noise of the corners."""
        own, parts, design, known, z = model
        scaled_parts = [variance * part for variance, part in zip(np.exp(logarithms).tolist(), parts, strict=True)]
        total = own + sum(scaled_parts)
        inverse = np.linalg.inv(total)
        weighted = inverse @ design
        covariance = covariance_of_free(design.T @ weighted + known)
        projector = inverse - weighted @ covariance @ weighted.T
        rest = projector @ z
        scaled = [projector @ each for each in scaled_parts]
        gradient = [
            0.5 * (rest @ part @ rest - np.trace(each)) for part, each in zip(scaled_parts, scaled, strict=True)
        ]
        information = [[0.5 * float((one * other.T).sum()) for other in scaled] for one in scaled]
        free = np.diag(covariance) > 0.0
        determinants = np.linalg.slogdet(total)[1] - np.linalg.slogdet(covariance[np.ix_(free, free)])[1]
        ratios, precision = _ratios(len(parts))
        off = ratios @ logarithms - 2.0 * np.log(RATIO)
        # a weak prior, of a variance of 20 of each logarithm, for what the views do not determine
        return cls(
            logarithms,
            float(determinants + z @ rest + precision * off @ off),
            np.array(gradient) - precision * ratios.T @ off,
            np.array(information) + 0.05 * np.eye(len(parts)) + precision * ratios.T @ ratios,
        )

    @property
    def evidence(self) -> float:
        """Minus twice the logarithm of the density's integral, but for the constant that all models have."""
        ratios, precision = _ratios(len(self.logarithms))
        determinant = float(np.linalg.slogdet(self.information)[1])
        return self.minus_two_log_density + determinant - len(ratios) * float(np.log(precision))


def _ratios(parts: int) -> tuple[Float64[Array, "ratio part"], float]:
    """Rows that give the logarithms of field over repeatability of the variances, and the precision of their prior."""
    ratios = np.zeros((0, parts)) if parts == 2 else np.column_stack([-np.eye(2), np.eye(2)])
    return ratios, float(1.0 / (2.0 * np.log(RATIO_FACTOR)) ** 2)


def _most_likely(start: Float64[Array, "part"], model: _Model) -> _Fit:
    """The variances of the highest density within the bounds of the robot's error, by Fisher scoring."""
    lower = 2.0 * np.log(np.tile([ROTATION_BOUNDS_RAD[0], TRANSLATION_BOUNDS_M[0]], len(start) // 2))
    fit = _Fit.of(start, model)
    for _ in range(_ITERATIONS):
        step = np.clip(np.linalg.solve(fit.information, fit.gradient), -2.0, 2.0)
        moved = np.maximum(fit.logarithms + step, lower)
        if np.abs(moved - fit.logarithms).max() < 0.02:
            break
        fit = _Fit.of(moved, model)
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
    correlation = (1.0 / (1.0 + 0.5 * (angle**2 + distance**2)))[:, :, None, None]
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
