"""Pose estimates compared with the truth: errors, and a judgement of each quantity that a pose reports."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import partial
from types import MappingProxyType
from typing import Annotated, Literal

import numpy as np

from ringpose.bench.assumptions import StatedAssumptions, assumptions_of
from ringpose.errors import DataError
from ringpose.estimate import pose_errors
from ringpose.geometry.rotations import angle_between, tilt_basis
from ringpose.measure.status import flags_forbidding
from ringpose.types.arrays import Array, Float64
from ringpose.types.options import PoseFrame
from ringpose.types.pose import PoseFlag, PoseLine, RingPose, Status
from ringpose.types.protection import WRONG_SIGMAS
from ringpose.types.record import Key
from ringpose.types.rig import Camera
from ringpose.types.truth import Truth

Value = str | float | int | bool
"""Value of a group."""

GROSS_SIGMAS = 6.0
"""Among very many quantities a few exceed `WRONG_SIGMAS` by chance; none exceeds this."""

JUDGED = MappingProxyType({"center": 3, "normal": 2, "grasp": 2, "radius_inner": 1, "radius_outer": 1, "velocity": 5})
"""The quantities that are judged, with their degrees of freedom.

Those of the grasp point are along the normal and radial, those of the velocity the centre's and two rates.
"""

AXES = MappingProxyType({"center": ("x", "y", "z"), "grasp": ("normal", "radial")})
"""Axes of quantities, whose distances are computed, too."""

WITH_NEES = ("center", "normal", "velocity")

FLAGS_OF_QUANTITY: Mapping[str, PoseFlag] = MappingProxyType(
    {
        name: flags_forbidding(name.removesuffix("_inner").removesuffix("_outer"))
        for name in ("center", "normal", "grasp", "radius_inner", "radius_outer", "velocity")
    }
)
"""The flags that name each quantity."""

QUANTITIES = (
    "center_x_m",
    "center_y_m",
    "center_z_m",
    "center_m",
    "normal_rad",
    "radius_inner_m",
    "radius_outer_m",
    "grasp_m",
    "velocity_m_s",
    "rate_rad_s",
    "center_nees",
    "normal_nees",
    "velocity_nees",
)
"""Errors: centre along the camera's axes and as a vector, angle of the normal, radii, distance of the grasp point from
the true mid-band circle, velocity of the centre, angular velocity across the normal; normalised squared errors (NEES),
by degree of freedom."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseEstimate:
    """The pose line of a shot by one method, in the camera frame, to be compared with the truth."""

    line: PoseLine
    shot: str
    """Name of the shot in the truth."""
    method: str
    """Empty if a record without a pose does not contain it."""
    status: Status
    """Status of the record, which may have flags that are not known."""

    @property
    def stamp_s(self) -> float:
        """The instant at which the pose holds, by default that of the shot; NaN if unknown."""
        return self.line.stamp_s if math.isnan(self.line.pose_stamp_s) else self.line.pose_stamp_s


class Outcome(StrEnum):
    """Outcome of a shot: what a method gives, compared with what the truth expects."""

    OK = "ok"
    DEGRADED = "degraded"
    """A pose whose status is `degraded`."""
    MISSED = "missed"
    """No pose although six break points are visible."""
    PARTIAL = "partial"
    """A pose from fewer visible break points: only the normal and the grasp point are scored."""
    PARTIAL_NONE = "partial_none"
    """No pose with fewer visible break points, which does not count as missed."""
    NO_TARGET = "no_target"
    """No pose, and no ring in the image."""
    WRONG = "wrong"
    """A pose with at least one wrong quantity."""
    LOST = "lost"
    """No pose record for this shot."""


class Judgement(StrEnum):
    """The result of comparing a reported quantity with the truth."""

    CORRECT = "correct"
    WRONG = "wrong"
    FLAGGED = "flagged"
    """Not judged, because a flag of the record applies to it."""
    NO_COVARIANCE = "no_covariance"
    """Not judged, because it is reported without a covariance."""


PROTECTED = ("grasp_normal_m", "grasp_radial_m", "normal_rad", "center_x_m", "center_y_m", "center_z_m")
"""The quantities that have a protection level."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Level:
    """The error of a quantity beside its protection level."""

    error: Annotated[float, Key("Absolute error; null where there is no ring.", null=math.inf, least=0.0)]
    level: Annotated[float, Key("Protection level; null if it is unavailable.", null=math.inf, least=0.0)]

    @property
    def is_misleading(self) -> bool:
        """Whether the error exceeds the level."""
        return self.error > self.level


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """The comparison of one shot with the truth, for one method."""

    shot: Annotated[str, Key("Name of the shot.")]
    method: Annotated[str, Key("The method; empty if no record names it.", blank=True)]
    outcome: Annotated[Outcome, Key("What the method gives, compared with what the truth expects.")]
    status: Annotated[
        Literal["ok", "degraded", "none", "lost"], Key("Status of the pose record; `lost` if there is none.")
    ]
    has_target: Annotated[bool, Key("Whether a ring is visible.", needed=True)] = True
    groups: Annotated[Mapping[str, Value], Key("The groups of the truth.", needed=True)] = field(default_factory=dict)
    errors: Annotated[
        Mapping[str, float], Key("Errors by quantity, without those that cannot be compared.", needed=True)
    ] = field(default_factory=dict)
    """By the names of `QUANTITIES`."""
    judgements: Annotated[
        Mapping[str, Judgement], Key("Judgements of the quantities that the pose reports.", needed=True)
    ] = field(default_factory=dict)
    """By the names of `JUDGED`."""
    distances: Annotated[
        Mapping[str, float],
        Key("Mahalanobis distances from the truth, of the quantities with a covariance.", needed=True),
    ] = field(default_factory=dict)
    """By the names of `JUDGED`, and of the axes in `AXES`."""
    levels: Annotated[
        Mapping[str, Level],
        Key("Errors beside their protection levels, of a line that has these.", added=True),
    ] = field(default_factory=dict)
    """By the names of `PROTECTED`."""
    gross: Annotated[
        tuple[str, ...],
        Key(
            "Wrong quantities that chance cannot explain: far beyond the limit, a grasp point off the rim or outside "
            "the arc, a pose where there is no ring.",
            needed=True,
        ),
    ] = ()
    """Beyond `GROSS_SIGMAS`."""
    assumptions: Annotated[
        StatedAssumptions | None, Key("What the pose assumes; null for one that is not compared by it.")
    ] = None
    latency_s: Annotated[float | None, Key("Time from the image to the pose.", least=0.0)] = None
    rig: Annotated[str, Key("Hash of the rig file; null if the record does not name it.", null="")] = ""

    @property
    def wrong(self) -> tuple[str, ...]:
        """Names of the wrong quantities."""
        return tuple(name for name, judgement in self.judgements.items() if judgement is Judgement.WRONG)


@dataclass(frozen=True, slots=True, kw_only=True)
class Matching:
    """The assignment of pose records to truths by the names of their shots."""

    truths: Annotated[int, Key("Shots of the truth.", least=0)]
    matched: Annotated[int, Key("Shots of the truth that have a record.", least=0)]
    without_truth: Annotated[tuple[str, ...], Key("Shots that have a record but no truth, each once.")]
    repeated: Annotated[
        tuple[str, ...], Key("Shots with more than one record of one method, of which the last is scored.")
    ]
    unsorted: Annotated[
        bool, Key("Whether the shots are in another order than in the truth, which has no effect on the scores.")
    ]


def estimate_of(line: PoseLine, place: str) -> PoseEstimate:
    """The estimate in a pose record; DataError unless it is in the camera frame, like the truth."""
    if line.pose is not None and line.frame is not PoseFrame.CAMERA:
        raise DataError(place, f"is in the {line.frame} frame", "give poses in the camera frame")
    method = line.pose.method if line.pose else ""
    return PoseEstimate(line=line, shot=line.shot, method=method, status=line.status)


def named_by_stamp(estimates: Iterable[PoseEstimate], truths: Iterable[Truth]) -> list[PoseEstimate]:
    """Estimates of a track, each renamed to the shot of the truth that is nearest in time.

    If several estimates are nearest to one truth, only the nearest is kept. An estimate that is more than
    `MAX_PROPAGATION_S` from all truths keeps its name.
    """
    dated = [truth for truth in truths if truth.stamp_s is not None]
    stamps_s = np.array([truth.stamp_s for truth in dated])
    kept: dict[str, tuple[float, PoseEstimate]] = {}
    for estimate in estimates:
        apart_s, shot = 0.0, estimate.shot
        if len(dated):
            away_s = np.abs(stamps_s - estimate.stamp_s)
            nearest = int(np.argmin(away_s))
            if away_s[nearest] <= pose_errors.MAX_PROPAGATION_S:
                apart_s, shot = float(away_s[nearest]), dated[nearest].shot
        if shot not in kept or apart_s < kept[shot][0]:
            kept[shot] = (apart_s, replace(estimate, shot=shot))
    return [estimate for _, estimate in kept.values()]


def scores(estimates: Iterable[PoseEstimate], truths: Sequence[Truth], camera: Camera | None) -> list[Score]:
    """A score for each method and shot of the truth, in the order of the truth; a shot without a record is `lost`.

    A record without a method, since it has no pose, counts for all methods.
    """
    every = list(estimates)
    methods = list(dict.fromkeys(estimate.method for estimate in every if estimate.method)) or [""]
    judged = []
    for method in methods:
        by_shot = {estimate.shot: estimate for estimate in every if estimate.method in (method, "")}
        judged += [score(truth, by_shot.get(truth.shot), method, camera) for truth in truths]
    return judged


def matching(estimates: Sequence[PoseEstimate], truths: Iterable[Truth]) -> Matching:
    """The assignment of pose records to truths by the names of their shots."""
    place = {truth.shot: number for number, truth in enumerate(truths)}
    lines = Counter((estimate.method, estimate.shot) for estimate in estimates)
    shots = list(dict.fromkeys(estimate.shot for estimate in estimates))
    places = [place[shot] for shot in shots if shot in place]
    return Matching(
        truths=len(place),
        matched=len(places),
        without_truth=tuple(shot for shot in shots if shot not in place),
        repeated=tuple(dict.fromkeys(shot for (_, shot), count in lines.items() if count > 1)),
        unsorted=places != sorted(places),
    )


def score(truth: Truth, estimate: PoseEstimate | None, method: str, camera: Camera | None) -> Score:
    """Score of an estimate (None for a shot without a record).

    Without the camera it is not checked whether the grasp point lies on the arc that the stripes span.
    """
    has_target = truth.expect != "no_target"
    scored = partial(Score, shot=truth.shot, method=method, has_target=has_target, groups=truth.groups)
    if estimate is None:
        return scored(outcome=Outcome.LOST, status="lost")
    line, truth_now = estimate.line, pose_errors.truth_at(truth, estimate.stamp_s, estimate.line.stamp_s)
    compared = _compared(truth_now, line)
    distances = {
        name: math.sqrt(pose_errors.mahalanobis_squared(error, covariance))
        for name, (error, covariance) in compared.items()
        if covariance is not None and np.isfinite(covariance).all() and np.isfinite(error).all()
    }
    distances |= {
        f"{name}_{axis}": abs(float(compared[name][0][row])) / math.sqrt(covariance[row, row])
        for name, axes in AXES.items()
        if name in distances and (covariance := compared[name][1]) is not None
        for row, axis in enumerate(axes)
        if covariance[row, row] > 0.0
    }
    by_quantity = dict(_judgements(truth_now, line, compared, distances, camera))
    judgements = {name: judgement for name, (judgement, _) in by_quantity.items()}
    return scored(
        outcome=_outcome(truth, estimate.status, Judgement.WRONG in judgements.values()),
        status=estimate.status,
        errors=_errors(truth_now, line.pose, compared, distances),
        judgements=judgements,
        distances=distances,
        levels=dict(_levels(truth_now, line, compared)),
        gross=tuple(name for name, (_, gross) in by_quantity.items() if gross),
        assumptions=assumptions_of(line),
        latency_s=line.latency_s if math.isfinite(line.latency_s) else None,
        rig=line.rig,
    )


def _outcome(truth: Truth, status: Status, wrong: bool) -> Outcome:
    if status == "none":
        return {"pose": Outcome.MISSED, "partial": Outcome.PARTIAL_NONE, "no_target": Outcome.NO_TARGET}[truth.expect]
    if wrong:
        return Outcome.WRONG
    if truth.expect == "partial":
        return Outcome.PARTIAL
    return Outcome.OK if status == "ok" else Outcome.DEGRADED


Compared = dict[str, tuple[Float64[Array, "n"], Float64[Array, "n n"] | None]]
"""Error of each reported quantity that has a truth, in the coordinates in which it is judged, and its covariance."""


def _compared(truth: Truth, line: PoseLine) -> Compared:
    pose, velocity, reported = line.pose, line.velocity, _reported(line)
    center_m, normal, radius_m = truth.center_m, truth.normal, pose_errors.mid_radius_m(truth)
    errors: Compared = {}
    if pose is None or center_m is None or normal is None:
        return errors
    full = np.full((7, 7), np.nan) if pose.covariance is None else pose.covariance
    if "center" in reported:
        errors["center"] = pose.center_m - center_m, pose.covariance_center_m2
    if "normal" in reported:
        errors["normal"] = pose_errors.tilt_error_rad(pose.normal, normal), full[:2, :2]
    if "grasp" in reported and radius_m is not None:
        axes, beside_m = pose_errors.circle_error(pose.grasp_m, center_m, normal, radius_m)
        grasp_m2 = pose.covariance_grasp_m2
        errors["grasp"] = beside_m, None if grasp_m2 is None else axes @ grasp_m2 @ axes.T
    if "radius_inner" in reported and truth.radius_inner_m is not None:
        errors["radius_inner"] = np.array([pose.radius_inner_m - truth.radius_inner_m]), full[5:6, 5:6]
    if "radius_outer" in reported and truth.radius_outer_m is not None:
        errors["radius_outer"] = np.array([pose.radius_outer_m - truth.radius_outer_m]), full[6:7, 6:7]
    moves = truth.velocity_m_s is not None or truth.angular_velocity_rad_s is not None
    if "velocity" in reported and velocity is not None and moves:
        true_m_s = np.zeros(3) if truth.velocity_m_s is None else truth.velocity_m_s
        true_rad_s = np.zeros(3) if truth.angular_velocity_rad_s is None else truth.angular_velocity_rad_s
        across_rad_s = true_rad_s - (true_rad_s @ normal) * normal  # the spin about the true normal is not observable
        rate_error_rad_s = tilt_basis(pose.normal) @ (velocity.rate_rad_s - across_rad_s)
        errors["velocity"] = np.concatenate([velocity.center_m_s - true_m_s, rate_error_rad_s]), velocity.covariance
    return errors


def _reported(line: PoseLine) -> list[str]:
    """Names of the quantities (`JUDGED`) that a pose line determines."""
    pose, velocity = line.pose, line.velocity
    if pose is None:
        return []
    velocity_m_s = np.array(np.nan) if velocity is None else velocity.center_m_s
    values = (pose.center_m, pose.normal, pose.grasp_m, pose.radius_inner_m, pose.radius_outer_m, velocity_m_s)
    return [name for name, value in zip(JUDGED, values, strict=True) if np.isfinite(value).all()]


def _levels(truth: Truth, line: PoseLine, compared: Compared) -> Iterator[tuple[str, Level]]:
    """Each quantity with a level beside its error; without a ring every error is infinite."""
    pose, protection = line.pose, line.protection
    if pose is None or protection is None:
        return
    levels = (protection.grasp_normal_m, protection.grasp_radial_m, protection.normal_rad)
    errors = dict.fromkeys(PROTECTED, math.inf if truth.expect == "no_target" else math.nan)
    if "grasp" in compared:
        errors["grasp_normal_m"], errors["grasp_radial_m"] = np.abs(compared["grasp"][0]).tolist()
    if "normal" in compared and truth.normal is not None:
        errors["normal_rad"] = float(angle_between(pose.normal[None], truth.normal[None])[0])
    if "center" in compared:
        errors |= dict(zip(PROTECTED[3:], np.abs(compared["center"][0]).tolist(), strict=True))
    for name, level in zip(PROTECTED, (*levels, *protection.center_m.tolist()), strict=True):
        if not (math.isnan(errors[name]) and math.isfinite(level)):  # else the truth does not have it
            yield name, Level(error=0.0 if math.isnan(errors[name]) else errors[name], level=level)


def _judgements(
    truth: Truth, line: PoseLine, compared: Compared, distances: Mapping[str, float], camera: Camera | None
) -> Iterator[tuple[str, tuple[Judgement, bool]]]:
    """Each reported quantity with its judgement, and whether its error is gross."""
    for name in _reported(line):
        if truth.expect != "no_target" and name not in compared:
            continue
        if line.flags & FLAGS_OF_QUANTITY[name]:
            yield name, (Judgement.FLAGGED, False)
        elif truth.expect == "no_target" or (
            name == "grasp" and line.pose is not None and pose_errors.misses_band(line.pose.grasp_m, truth, camera)
        ):
            yield name, (Judgement.WRONG, True)
        elif name in distances:
            wrong = distances[name] > WRONG_SIGMAS
            yield name, (Judgement.WRONG if wrong else Judgement.CORRECT, distances[name] > GROSS_SIGMAS)
        else:  # the limits of band and arc apply to a grasp point without a covariance, too
            yield name, (Judgement.CORRECT if name == "grasp" else Judgement.NO_COVARIANCE, False)


def _errors(
    truth: Truth, pose: RingPose | None, compared: Compared, distances: Mapping[str, float]
) -> dict[str, float]:
    """Errors by the names of `QUANTITIES`; in a partial shot only the errors of normal and grasp point."""
    if pose is None or truth.normal is None or truth.expect == "no_target":
        return {}
    error = {name: vector for name, (vector, _) in compared.items()}
    errors = {}
    if "normal" in error:
        errors["normal_rad"] = float(angle_between(pose.normal[None], truth.normal[None])[0])
    if "grasp" in error:
        errors["grasp_m"] = float(np.hypot(*error["grasp"]))
    nees = {f"{name}_nees": distances[name] ** 2 / JUDGED[name] for name in WITH_NEES if name in distances}
    if truth.expect == "partial":
        return errors | {name: value for name, value in nees.items() if name == "normal_nees"}
    if "center" in error:
        errors |= {f"center_{axis}_m": float(part) for axis, part in zip("xyz", error["center"], strict=True)}
        errors["center_m"] = float(np.linalg.norm(error["center"]))
    if "velocity" in distances:
        errors["velocity_m_s"] = float(np.linalg.norm(error["velocity"][:3]))
        errors["rate_rad_s"] = float(np.linalg.norm(error["velocity"][3:]))
    return errors | nees | {f"{name}_m": float(error[name][0]) for name in error if name.startswith("radius")}
