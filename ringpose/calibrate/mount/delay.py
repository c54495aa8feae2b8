"""Whether the views of a moving robot determine the offset of its clock (ringpose-method(7), section 13).

A robot that halts at each view, or hardly moves, has the same pose at many delays. The least squares then follow the
noise of its poses, and their standard deviation is that of one side of the halt.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ringpose.calibrate.mount.adjustment import AT_BOUND, STAMP_BOUNDS_S, MountSolution
from ringpose.calibrate.mount.moving import MAX_DELAY_S, twists_between
from ringpose.calibrate.mount.stations import Station
from ringpose.geometry.least_squares import covariance_of_free
from ringpose.types.arrays import Array, Float64

_STEP_S = 0.04
"""Distance of the delays that are compared: a part of the shortest halt."""

_SIGMAS = 3.0
"""Standard deviations of a difference of two chi-squared by chance, from which one delay fits better than another."""

_MAX_WIDER = 1.5
"""Factor by which delays that fit as well may be farther away than the curvature of chi-squared expects."""


class OpenDelay(NamedTuple):
    """A delay that the views do not determine."""

    delay_s: float
    """The middle of the delays that fit."""
    sd_s: float
    """Standard deviation of a delay that is anywhere between them."""


def open_delay(solution: MountSolution, stations: Sequence[Station]) -> OpenDelay | None:
    """The delays that fit as well, if they are more than the standard deviation of the solution expects; else None.

    Poses at another delay have other errors of the robot, by which chi-squared differs although the robot rests.
    """
    if not solution.has_delay:
        return None
    degrees_of_freedom = 6 * len(stations) - 12
    by_chance = _SIGMAS * 2.0 * np.sqrt(degrees_of_freedom)
    delays_s = np.arange(-MAX_DELAY_S, MAX_DELAY_S + _STEP_S / 2, _STEP_S)
    chi2 = _chi2_at(delays_s, solution, stations)
    delay_s, sd_s = solution.state.delay_s, float(np.sqrt(solution.covariance[12, 12]))
    as_good = np.append(delays_s[chi2[:-1] < chi2[-1] + by_chance], delay_s)
    expected_s = max(_MAX_WIDER * np.sqrt(by_chance) * sd_s, _STEP_S)
    has_stamps = solution.stamp_sd_s < AT_BOUND * STAMP_BOUNDS_S[1]  # else any pose of a halt fits
    if np.abs(as_good - delay_s).max() < expected_s and has_stamps and _moves(solution, stations):
        return None
    first_s, last_s = float(as_good.min()), float(as_good.max())
    return OpenDelay((first_s + last_s) / 2.0, max((last_s - first_s) / np.sqrt(12.0), sd_s))


def _chi2_at(
    delays_s: Float64[Array, "delay"], solution: MountSolution, stations: Sequence[Station]
) -> Float64[Array, "all"]:
    """Least weighted sum of squares at each of the delays and, last, at that of the solution."""
    numbers, weights = solution.numbers, solution.weights
    design = np.delete(numbers.wrt_common, 12, axis=2)
    weighted = design.swapaxes(1, 2) @ weights
    known = np.delete(np.delete(solution.prior + numbers.camera_information.sum(axis=0), 12, axis=0), 12, axis=1)
    covariance = covariance_of_free((weighted @ design).sum(axis=0) + known)
    chi2, poses = [], [one.base_from_tool for one in stations]
    for delay_s in (*delays_s.tolist(), solution.state.delay_s):
        further = twists_between(poses, [one.at(delay_s).base_from_tool for one in stations])
        z = numbers.z - (numbers.wrt_error @ further[..., None])[..., 0]
        gradient = (weighted @ z[..., None]).sum(axis=0)[:, 0]
        chi2.append(float(np.einsum("vi,vij,vj->", z, weights, z) - gradient @ covariance @ gradient))
    return np.array(chi2)


def _moves(solution: MountSolution, stations: Sequence[Station]) -> bool:
    """Whether the tool moves around the views by more than the errors of two of its poses."""
    span_s = np.array([2.0 * one.sighting.motion.span_s if one.sighting is not None else 0.0 for one in stations])
    shift = np.array([one.twist for one in stations]) * span_s[:, None] / np.sqrt(solution.sigmas.variances)
    by_chance = 2.0 * (1.0 + _SIGMAS * np.sqrt(2.0 / shift.size))
    return bool(np.mean(shift**2) > by_chance)


def delayed_covariance(solution: MountSolution, stations: Sequence[Station], sd_s: float) -> Float64[Array, "12 12"]:
    """What a wrong delay adds to the covariance of X and Y of a solution in which it is held."""
    numbers = solution.numbers
    later = (numbers.wrt_error @ np.array([one.twist for one in stations])[..., None])[..., 0]
    weighted = numbers.wrt_common.swapaxes(1, 2) @ solution.weights
    shift = (solution.covariance @ (weighted @ later[..., None]).sum(axis=0)[:, 0])[:12] * sd_s
    return np.outer(shift, shift)
