"""One answer against one truth: an outcome and the errors."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from ringpose.bench.answer import Answer
from ringpose.bench.arc import outside_arc
from ringpose.bench.errors import distance_to_circle_m, mahalanobis_squared, tilt_error_rad
from ringpose.geometry.rotations import angle_between
from ringpose.types.arrays import Array, Float64
from ringpose.types.camera import Camera
from ringpose.types.ring_pose import PoseFlag, RingPose
from ringpose.types.truth import Truth

WRONG_SIGMAS = 5.0
"""A centre farther off than this, in its own standard deviations and without a flag, is a wrong pose."""

CENTER_FLAGS = PoseFlag.CENTER_WEAK | PoseFlag.DAMPED
"""What warns of the centre."""


class Outcome(StrEnum):
    """What became of a shot."""

    OK = "ok"
    DEGRADED = "degraded"
    """A pose with a flag."""
    MISSED = "missed"
    """No pose where six break points are to be had."""
    PARTIAL = "partial"
    """Fewer break points are to be had: normal and grasp point are scored, and no pose is no miss."""
    PARTIAL_NONE = "partial_none"
    NO_TARGET = "no_target"
    """Nothing there, and no pose."""
    WRONG = "wrong"
    """A pose of nothing, a centre that is off by more than it admits, a grasp point where nothing was measured."""
    LOST = "lost"
    """No line at all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """One shot, one method."""

    shot: str
    method: str
    outcome: Outcome
    groups: Mapping[str, str | float | int | bool] = field(default_factory=dict)
    errors: Mapping[str, float] = field(default_factory=dict)
    """By the names of `QUANTITIES`; what cannot be compared is not there."""


QUANTITIES = (
    "center_x_m",
    "center_y_m",
    "center_z_m",
    "center_m",
    "normal_rad",
    "radius_inner_m",
    "radius_outer_m",
    "grasp_m",
    "center_nees",
    "normal_nees",
)
"""Errors: centre along the camera's axes and as a vector, angle of the normal, radii, distance of the grasp point from
the true mid-band circle; squared error in standard deviations, by degree of freedom."""


def score(truth: Truth, answer: Answer | None, method: str, camera: Camera | None) -> Score:
    """An answer (None for a shot without a line) against the truth; without the camera the arc goes unchecked."""
    errors = {} if answer is None or answer.pose is None else _errors(truth, answer.pose)
    return Score(
        shot=truth.shot,
        method=method,
        outcome=_outcome(truth, answer, errors, camera),
        groups=truth.groups,
        errors=errors,
    )


def _outcome(truth: Truth, answer: Answer | None, errors: Mapping[str, float], camera: Camera | None) -> Outcome:
    if answer is None:
        return Outcome.LOST
    if answer.pose is None:
        return {"pose": Outcome.MISSED, "partial": Outcome.PARTIAL_NONE, "no_target": Outcome.NO_TARGET}[truth.expect]
    if _is_wrong(truth, answer.pose, errors, camera):
        return Outcome.WRONG
    if truth.expect == "partial":
        return Outcome.PARTIAL
    return Outcome.DEGRADED if answer.pose.flags else Outcome.OK


def _is_wrong(truth: Truth, pose: RingPose, errors: Mapping[str, float], camera: Camera | None) -> bool:
    if truth.expect == "no_target":
        return True
    if errors.get("center_nees", 0.0) * 3 > WRONG_SIGMAS**2 and not pose.flags & CENTER_FLAGS:
        return True
    return camera is not None and _known(pose.grasp_m) and outside_arc(pose.grasp_m, truth, camera)


def _errors(truth: Truth, pose: RingPose) -> dict[str, float]:
    if truth.expect == "no_target":
        return {}
    errors = {**_normal_errors(truth, pose), **_grasp_errors(truth, pose)}
    if truth.expect == "pose":
        errors |= {**_center_errors(truth, pose), **_radius_errors(truth, pose)}
    return errors


def _center_errors(truth: Truth, pose: RingPose) -> dict[str, float]:
    if truth.center_m is None or not _known(pose.center_m):
        return {}
    error = pose.center_m - truth.center_m
    errors = {f"center_{axis}_m": float(part) for axis, part in zip("xyz", error, strict=True)}
    errors["center_m"] = float(np.linalg.norm(error))
    if pose.covariance_center_m2 is not None:
        errors["center_nees"] = mahalanobis_squared(error, pose.covariance_center_m2) / 3
    return errors


def _normal_errors(truth: Truth, pose: RingPose) -> dict[str, float]:
    if truth.normal is None or not _known(pose.normal):
        return {}
    errors = {"normal_rad": float(angle_between(pose.normal[None], truth.normal[None])[0])}
    if pose.covariance is not None:
        tilt_rad = tilt_error_rad(pose.normal, truth.normal)
        errors["normal_nees"] = mahalanobis_squared(tilt_rad, pose.covariance[:2, :2]) / 2
    return errors


def _radius_errors(truth: Truth, pose: RingPose) -> dict[str, float]:
    pairs = {
        "radius_inner_m": (pose.radius_inner_m, truth.radius_inner_m),
        "radius_outer_m": (pose.radius_outer_m, truth.radius_outer_m),
    }
    return {name: said - true for name, (said, true) in pairs.items() if true is not None and math.isfinite(said)}


def _grasp_errors(truth: Truth, pose: RingPose) -> dict[str, float]:
    if truth.center_m is None or truth.normal is None or not _known(pose.grasp_m):
        return {}
    if truth.radius_inner_m is None or truth.radius_outer_m is None:
        return {}
    middle_m = (truth.radius_inner_m + truth.radius_outer_m) / 2
    return {"grasp_m": distance_to_circle_m(pose.grasp_m, truth.center_m, truth.normal, middle_m)}


def _known(vector: Float64[Array, "3"]) -> bool:
    return bool(np.isfinite(vector).all())
