"""What the views say about a mount when each is left out: covariance, held-out errors, wrong views, a slipped board."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ringpose.calibrate.mount.adjustment import (
    MIN_FREE_VIEWS,
    MountSolution,
    ViewNumbers,
    camera_from,
    inverse_marginal,
    robot_sigmas,
)
from ringpose.calibrate.mount.stations import Station
from ringpose.calibrate.mount.systematic import SystematicError, camera_errors
from ringpose.geometry.least_squares import covariance_of_free
from ringpose.types.arrays import Array, Bool, Float64

MIN_VIEWS = 3
"""Two views have one rotation, which leaves the translation along its axis open."""

CHANCE = 1e-7
"""Probability at which a view, or a slip of the board, is accepted as wrong by chance."""


MAX_USUAL_CHANCE = 0.05
"""Probability above which a reduction of chi-squared is not looked into: with many views it needs no further test."""

TRIED = 2
"""Explanations of each kind that are tried."""


class LeftOut(NamedTuple):
    """The solution without each view in turn, as steps from that of all views."""

    step: Float64[Array, "view common"]
    covariance: Float64[Array, "view common common"]
    distance_m: Float64[Array, "view"]
    """Distance of the board's middle from where the other views predict it."""
    angle_rad: Float64[Array, "view"]


def left_out(solution: MountSolution, stations: Sequence[Station]) -> LeftOut:
    """One Gauss-Newton step without each view."""
    numbers = solution.numbers
    information = solution.information.sum(axis=0) + solution.prior
    gradient = solution.gradient.sum(axis=0) - solution.pull
    steps, covariances, distances_m, angles_rad = [], [], [], []
    for view, station in enumerate(stations):
        covariance = covariance_of_free(information - solution.information[view])
        step = covariance @ (gradient - solution.gradient[view])
        rest = numbers.z[view] - numbers.wrt_common[view] @ step
        middle = solution.boards[view].rotation @ station.view.points_board_m.mean(axis=0)
        steps.append(step)
        covariances.append(covariance)
        distances_m.append(float(np.linalg.norm(rest[3:] + np.cross(rest[:3], middle))))
        angles_rad.append(float(np.linalg.norm(rest[:3])))
    return LeftOut(np.array(steps), np.array(covariances), np.array(distances_m), np.array(angles_rad))


class Validated(NamedTuple):
    """The covariance of a solution as far as its views support it."""

    covariance: Float64[Array, "common common"]
    """Of X, Y, delay."""
    pose_covariance: Float64[Array, "6 6"]
    """Of the camera at another pose of the robot like those of the views (`camera_errors`)."""
    disagreement: tuple[float, float]
    """Factors by which the views disagree more about rotation and translation of X than their likelihood explains."""


def validated_covariance(
    solution: MountSolution,
    stations: Sequence[Station],
    without: LeftOut,
    camera_covariance: Float64[Array, "parameter parameter"] | None,
    systematic: SystematicError,
    eye_to_hand: bool,
) -> Validated:
    """The covariance of the likelihood, widened where views left out disagree, with a systematic error of the robot.

    The factors of disagreement, of rotation and translation, are those between the jackknife by views and its
    expectation, the difference of the covariances with and without a view. They widen the covariance where they are
    larger than by Student's distribution, which the uncertainty of the robot's standard deviations makes of normal
    errors. This and the covariance with a systematic error of the robot, which leaving out views does not show, are
    averaged by their probabilities. The covariance of a camera that is held fixed is propagated.
    """
    views = len(solution.numbers.z)
    common = camera_from(solution.has_delay)
    covariance = solution.covariance[:common, :common]
    blocks = [slice(first, min(first + 3, common)) for first in range(0, common, 3)]
    factors = []
    for block in (*blocks[:2], *blocks[4:]):
        inner = np.linalg.inv(covariance[block, block])
        jackknife = sum(float(step[block] @ inner @ step[block]) for step in without.step)
        expected = sum(
            float(np.trace(inner @ (fewer[block, block] - covariance[block, block]))) for fewer in without.covariance
        )
        factors.append(jackknife / max(expected, 1e-12))
    by_sigmas = [student_factor(views)] * 4 + [stamp_factor(views)] * (common > 12)
    widening = np.sqrt(np.repeat(np.maximum(factors[:2] * 2 + factors[2:], by_sigmas), 3)[:common])
    independent = covariance * np.outer(widening, widening)
    share = systematic.probability
    total = (1.0 - share) * independent + share * systematic.covariance[:common, :common]
    of_camera = np.zeros((6, 6))
    if camera_covariance is not None and len(solution.covariance) == common:
        weighted = solution.numbers.wrt_common.swapaxes(1, 2) @ solution.weights
        influence = covariance @ (weighted @ solution.numbers.wrt_camera).sum(axis=0)
        by_camera = influence @ camera_covariance @ influence.T
        total, of_camera = total + by_camera, by_camera[:6, :6]
    wrt_robot, wrt_mount = camera_errors(solution, stations, eye_to_hand)
    robot = wrt_robot * student_factor(views) * solution.sigmas.variances @ wrt_robot.swapaxes(1, 2)
    by_mount = (1.0 - share) * independent[:6, :6] + of_camera
    pose_covariance = (
        (1.0 - share) * robot + wrt_mount @ by_mount @ wrt_mount.swapaxes(1, 2)
    ).mean(axis=0) + share * systematic.pose_covariance  # fmt: skip
    return Validated(total, pose_covariance, (factors[0], factors[1]))


def student_factor(views: int) -> float:
    """Factor by which variances widen because the robot's standard deviations are estimated: Student's over normal."""
    degrees_of_freedom = 3 * views - 6 + (views < MIN_FREE_VIEWS)
    return degrees_of_freedom / (degrees_of_freedom - 2)


def stamp_factor(views: int) -> float:
    """The same of the delay, whose stamps have one error a view."""
    return (views - 1) / max(views - 3, 1)


class WrongViews(NamedTuple):
    """What is wrong with some of the views."""

    views: tuple[int, ...]
    """The views that would be left out."""
    slipped: bool
    """Whether the board was moved, and not one pose is wrong."""


def wrong_views(solution: MountSolution) -> WrongViews | None:
    """One view with another pose than the robot reports, or a board that was moved between two views; else None.

    Either explanation has six parameters more. Those that reduce chi-squared most are tried with the robot's error
    estimated anew, which a wrong view has enlarged; the most significant one is taken if an F test accepts it.
    """
    numbers, weights = solution.numbers, solution.weights
    views = len(numbers.z)
    if views <= MIN_VIEWS:
        return None
    explanations = [WrongViews((view,), slipped=False) for view in range(views)]
    explanations += [WrongViews(_fewer(np.arange(views) >= first), slipped=True) for first in range(2, views - 1)]
    tests = len(explanations)  # the probability that one of them seems significant by chance is so many times larger
    degrees_of_freedom = 6 * views - 18  # six of mount, board and explanation each
    before = _chi2(numbers, weights, solution.prior)
    chi2 = [_chi2(_with(numbers, explanation), weights, solution.prior) for explanation in explanations]
    if views >= MIN_FREE_VIEWS and tests * _chance(before, min(chi2), degrees_of_freedom) > MAX_USUAL_CHANCE:
        return None
    ranked = [explanations[index] for index in np.argsort(chi2, kind="stable")]
    tried = [explanation for explanation in ranked if not explanation.slipped][:TRIED]
    tried += [explanation for explanation in ranked if explanation.slipped][:TRIED]
    wrong = []
    for explanation in tried:
        model = _with(numbers, explanation)
        sigmas = robot_sigmas(model, _padded(solution.prior, model))
        smaller = inverse_marginal(numbers, sigmas)  # weights by the robot's error that the explanation leaves
        chi2_without, chi2_with = (_chi2(views_of, smaller, solution.prior) for views_of in (numbers, model))
        chance = _chance(chi2_without, chi2_with, degrees_of_freedom)
        wrong.append((chance, sigmas.translation_m, explanation))
    chance, _, best = min(wrong, key=lambda entry: entry[:2])
    return best if tests * chance < CHANCE and views - len(best.views) >= MIN_VIEWS else None


def _fewer(later: Bool[Array, "view"]) -> tuple[int, ...]:
    """The views on that side of a slip that has fewer."""
    return tuple(np.flatnonzero(later if 2 * later.sum() <= len(later) else ~later).tolist())


def _with(numbers: ViewNumbers, explanation: WrongViews) -> ViewNumbers:
    """The model with a board of its own for the views of an explanation; one view then determines nothing else."""
    chosen = np.isin(np.arange(len(numbers.z)), explanation.views)[:, None, None]
    moved = np.where(chosen, numbers.wrt_common[:, :, 6:12], 0.0)
    common = numbers.wrt_common.shape[2]
    information = np.pad(numbers.camera_information, ((0, 0), (0, 6), (0, 6)))
    return replace(
        numbers, wrt_common=np.concatenate([numbers.wrt_common, moved], axis=2), camera_information=information,
        camera_gradient=np.pad(numbers.camera_gradient, ((0, 0), (0, information.shape[1] - common))),
    )  # fmt: skip


def _padded(prior: Float64[Array, "common common"], numbers: ViewNumbers) -> Float64[Array, "more more"]:
    """The prior of the first of the parameters."""
    more = numbers.wrt_common.shape[2] - len(prior)
    return np.pad(prior, ((0, more), (0, more)))


def _chance(before: float, after: float, degrees_of_freedom: int) -> float:
    """Probability that six parameters reduce chi-squared so much by chance."""
    from scipy.stats import f as f_distribution

    ratio = (before - after) / 6 / max(after / degrees_of_freedom, 1e-12)
    return float(f_distribution.sf(ratio, 6, degrees_of_freedom))


def _chi2(numbers: ViewNumbers, weights: Float64[Array, "view 6 6"], prior: Float64[Array, "common common"]) -> float:
    """Least weighted sum of squares of the views' corrections."""
    design = numbers.wrt_common
    weighted = design.swapaxes(1, 2) @ weights
    information = (weighted @ design + numbers.camera_information).sum(axis=0) + _padded(prior, numbers)
    gradient = ((weighted @ numbers.z[..., None])[..., 0] + numbers.camera_gradient).sum(axis=0)
    rest = numbers.z - design @ (covariance_of_free(information) @ gradient)
    return float(np.einsum("vi,vij,vj->", rest, weights, rest))


def board_scale(solution: MountSolution) -> tuple[float, float]:
    """By what share the board is larger than its file gives, by the robot's motions, and its standard deviation."""
    numbers, weights = solution.numbers, solution.weights
    column = np.zeros((len(numbers.z), 6, 1))
    column[:, 3:, 0] = [pose.translation_m for pose in solution.boards]
    design = np.concatenate([numbers.wrt_common, column], axis=2)
    weighted = design.swapaxes(1, 2) @ weights
    information = (weighted @ design).sum(axis=0)
    information[:-1, :-1] += solution.prior + numbers.camera_information.sum(axis=0)
    gradient = (weighted @ numbers.z[..., None]).sum(axis=0)[:, 0]
    gradient[:-1] += numbers.camera_gradient.sum(axis=0) - solution.pull
    covariance = covariance_of_free(information)
    share = float((covariance @ gradient)[-1])
    return -share, float(np.sqrt(covariance[-1, -1]))
