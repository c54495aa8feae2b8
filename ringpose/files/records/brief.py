"""Brief records: numbers with the digits that their errors justify.

A value is rounded by its standard deviation given all other values, since those of a pose depend on each other: centre
and radius, each known to millimetres, state the place of the ring's edge to a hundredth of one.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ringpose.types.arrays import Array, Float64

SHARE = 0.1
"""Step of rounding in standard deviations. Ten times as much would move a value by half a standard deviation."""

VARIANCE_ERROR = 0.05
"""Largest relative change of the variance of any combination of values, by which its standard deviation changes by half
as much."""

DIGITS = 3
"""Of numbers that are no estimates: durations, residuals, ratios."""

UNIT_DECIMALS = 7
"""Of a unit vector, whose length readers check to 1e-6."""

_TILTS, _LENGTHS = slice(0, 2), slice(2, 7)
"""Of the seven parameters of a pose."""

_OTHERS = ("latency_s", "stage_s", "rig_health", "test_ratio", "age_s", "process_noise", "capture_probability")


def rounded(record: Mapping[str, Any]) -> dict[str, Any]:
    """The record of a pose line or of a line of a track with rounded numbers; what has no covariance is unchanged."""
    rounded = dict(record) | {key: _significant(record[key]) for key in _OTHERS if key in record}
    pose, velocity = record["pose"], record["velocity"]
    if pose is None or pose["covariance"] is None or pose["covariance"]["full"] is None:
        return rounded
    sigmas = _given_the_others(_array(pose["covariance"]["full"]))
    length, angle = _decimals(sigmas[_LENGTHS]), _decimals(sigmas[_TILTS])
    rounded["pose"] = _pose(pose, length, angle)
    if velocity is not None:
        of_velocity = _given_the_others(_array(velocity["covariance"]))
        speed = _decimals(of_velocity[:3])
        rounded["velocity"] = {
            "center_m_s": _fixed(velocity["center_m_s"], speed),
            "rate_rad_s": _fixed(velocity["rate_rad_s"], _decimals(of_velocity[3:])),
            "covariance": _covariance(velocity["covariance"]),
        }
        if record.get("grasp") is not None:
            grasp = record["grasp"]
            rounded["grasp"] = {
                "point_m": _fixed(grasp["point_m"], length),
                "velocity_m_s": _fixed(grasp["velocity_m_s"], speed),
                "covariance": _covariance(grasp["covariance"]),
            }
    if record.get("next") is not None:
        following = record["next"]
        rounded["next"] = following | {
            "grasp_m": _fixed(following["grasp_m"], length),
            "normal": _fixed(following["normal"], max(UNIT_DECIMALS, angle)),
            "covariance": _covariance(following["covariance"]),
        }
    if "hypotheses" in record:
        rounded["hypotheses"] = [
            each | {"weight": _significant(each["weight"]), "center_m": _fixed(each["center_m"], length)}
            for each in record["hypotheses"]
        ]
    return rounded


def _pose(pose: Mapping[str, Any], length: int, angle: int) -> dict[str, Any]:
    lengths = ("center_m", "radius_inner_m", "radius_outer_m", "grasp_m")
    return {
        **pose,
        **{key: _fixed(pose[key], length) for key in lengths},
        **{key: _fixed(pose[key], angle) for key in ("pitch_rad", "yaw_rad")},
        **{key: _significant(pose[key]) for key in ("residual_rms_px", "condition_number")},
        "normal": _fixed(pose["normal"], max(UNIT_DECIMALS, angle)),
        "covariance": {key: _covariance(each) for key, each in pose["covariance"].items()},
    }


def _array(values: Any) -> Float64[Array, "..."]:
    """The numbers as an array, null as NaN."""
    return np.array(values, dtype=np.float64)


def _known(covariance: Float64[Array, "n n"]) -> Any:
    """Rows and columns of what is determined."""
    known = np.isfinite(np.diag(covariance))
    return np.ix_(known, known)


def _given_the_others(covariance: Float64[Array, "n n"]) -> Float64[Array, "n"]:
    """Standard deviation of each value given all others; NaN for what is not determined."""
    sigmas = np.sqrt(np.diag(covariance))
    known = np.isfinite(sigmas)
    scaled = covariance[_known(covariance)] / np.outer(sigmas[known], sigmas[known])
    sigmas[known] /= np.sqrt(np.diag(np.linalg.pinv(scaled, rcond=1e-14, hermitian=True)))
    return sigmas


def _decimals(sigmas: Float64[Array, "n"]) -> int:
    """Decimals of values with these standard deviations; those of a double without one."""
    finite = sigmas[np.isfinite(sigmas) & (sigmas > 0)]
    return math.ceil(-math.log10(SHARE * finite.min())) if finite.size else 17


def _fixed(value: Any, decimals: int) -> Any:
    """A number, or a list of numbers, with so many decimals; null stays null."""
    if isinstance(value, Iterable):
        return [_fixed(each, decimals) for each in value]
    return None if value is None or not math.isfinite(value) else round(float(value), decimals)


def _significant(value: Any, digits: int = DIGITS) -> Any:
    """Numbers with so many significant digits, in lists and mappings, too."""
    if isinstance(value, Mapping):
        return {key: _significant(each, digits) for key, each in value.items()}
    if isinstance(value, Iterable):
        return [_significant(each, digits) for each in value]
    return None if value is None or not math.isfinite(value) else float(f"{value:.{digits}g}")


def _covariance(values: Any) -> Any:
    """A covariance with the fewest digits that keep the variance of each combination of values."""
    if values is None:
        return None
    exact = _array(values)
    known = _known(exact)
    try:
        root = np.linalg.cholesky(exact[known])
    except np.linalg.LinAlgError:  # singular: any rounding would make it indefinite
        return values
    for digits in range(2, 17):
        shorter = _array(_significant(exact.tolist(), digits))
        inner = np.linalg.solve(root, shorter[known])
        ratios = np.linalg.eigvalsh(np.linalg.solve(root, inner.T))
        if np.abs(ratios - 1.0).max(initial=0.0) < VARIANCE_ERROR:
            return _significant(exact.tolist(), digits)
    return values
