"""The record of a track: where the ring is and how it moves, from a stream of pose records."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import nan
from typing import Annotated, Any, Literal

from ringpose.types.arrays import Array, Float64
from ringpose.types.pose import PoseFlag, RingPose, RingVelocity, Status, status_of
from ringpose.types.protection import Protection
from ringpose.types.record import Form, Key, Presence


class Validity(StrEnum):
    """Validity of a line: how far it may be trusted, by the age of the last measurement that was used."""

    VALID = "valid"
    PREDICTED = "predicted"
    """Measurements are overdue; the prediction describes its own error."""
    STALE = "stale"
    """Predicted for longer than the limit."""
    LOST = "lost"
    """There is no track: no pose is given."""


class FusionStatus(StrEnum):
    """How a measurement was used."""

    FUSED = "fused"
    FUSED_LATE = "fused_late"
    """It was older than a measurement used before; the later measurements were then used again after it."""
    PENDING = "pending"
    """After a gap it does not continue the track, or its stamp is among earlier ones; a second one that agrees with it
    starts the track anew."""
    REJECTED_GATE = "rejected_gate"
    REJECTED_COVARIANCE = "rejected_covariance"
    """Its errors are not described by its covariance."""
    TOO_OLD = "too_old"
    """It is older than the buffer."""
    TOO_NEW = "too_new"
    """Its stamp lies in the future."""
    NONE = "none"
    """There was no measurement."""


class MotionModel(StrEnum):
    """A model of the target's motion."""

    CONSTANT_VELOCITY = "constant_velocity"
    PRECESSION = "precession"


CameraMotion = Literal["inertial_assumed", "robot_poses", "at_rest"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """One measurement and how it was used."""

    shot: Annotated[str, Key("The shot.", blank=True)]
    stamp_s: Annotated[float, Key("When the pose holds.", null=nan)]
    fusion_status: Annotated[FusionStatus, Key("What became of it.")]
    test_ratio: Annotated[
        float,
        Key(
            "Chi-squared of its innovation over the limit of the gate; null if it was not tested.", null=nan, least=0.0
        ),
    ]
    reason: Annotated[
        str, Key("Why it was not used, or that the clock was set back before it; null if it was used.", null="")
    ] = ""


NO_ATTEMPT = Attempt(shot="", stamp_s=nan, fusion_status=FusionStatus.NONE, test_ratio=nan)
"""Stands for the newest measurement where there was none since the last line."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GraspState:
    """The grasp point and its velocity."""

    point_m: Annotated[
        Float64[Array, "xyz=3"],
        Key(
            "Grasp point, on the middle of the band at the place that the last shots have seen. It is chosen on the "
            "ring, and therefore has no error along the face."
        ),
    ]
    velocity_m_s: Annotated[
        Float64[Array, "xyz=3"], Key("Velocity of the ring there, without the rotation about its axis.")
    ]
    covariance: Annotated[Float64[Array, "6 6"], Key("Of point and velocity.", form=Form.COVARIANCE)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NextTick:
    """The predicted grasp point and normal at the time of the next record."""

    stamp_s: Annotated[float, Key("Time of the next line.")]
    grasp_m: Annotated[Float64[Array, "xyz=3"], Key("Grasp point.")]
    normal: Annotated[Float64[Array, "xyz=3"], Key("Normal.", form=Form.UNIT_VECTOR)]
    covariance: Annotated[
        Float64[Array, "5 5"],
        Key("Of the grasp point x, y, z and of the two tilts of the normal.", form=Form.COVARIANCE),
    ]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SideHypothesis:
    """One side of the face on which the ring's centre may lie."""

    side: Annotated[int, Key("1: that of the first record, -1: the other one.", least=-1, most=1)]
    weight: Annotated[float, Key("Its probability.", least=0.0)]
    center_m: Annotated[Float64[Array, "xyz=3"], Key("The ring's centre.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessNoise:
    """Power spectral densities of a filter's process noise."""

    velocity_m2_s3: Annotated[float, Key("Of the velocity of the ring's centre.", least=0.0)]
    rate_rad2_s3: Annotated[float, Key("Of the angular velocity.", least=0.0)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrackLine:
    """Record of a track at one instant."""

    software: Annotated[str, Key("Program and version that wrote the line.", null="", added=True)] = ""
    stamp_s: Annotated[float, Key("The time (Unix time) at which everything in the line holds.", null=nan)]
    measurement_stamp_s: Annotated[
        float, Key("Time of the newest measurement that was used; null without a track.", null=nan)
    ]
    latency_s: Annotated[
        float,
        Key(
            "Time from that measurement to this line, by this computer's clock; null where its stamp is not that "
            "of a live shot by this clock: ahead of it, or older than a track may become.",
            null=nan,
            least=0.0,
            added=True,
        ),
    ] = nan
    validity: Annotated[
        Validity,
        Key("How far the line may be trusted, by the age of the newest measurement that was used."),
    ]
    flags: Annotated[
        PoseFlag,
        Key("As in a pose line; `inconsistent`: the newest measurement contradicts the track."),
    ] = PoseFlag(0)
    frame: Annotated[Literal["camera", "base"], Key("Frame of all vectors.")]
    pose: Annotated[RingPose | None, Key("As in a pose line; its `method` is `track`.")] = None
    velocity: Annotated[RingVelocity | None, Key("As in a pose line.")] = None
    protection: Annotated[
        Protection | None,
        Key(
            "As in a pose line, from the covariances of the track and the levels of its last shots; null if these have "
            "none.",
            added=True,
        ),
    ] = None
    grasp: Annotated[GraspState | None, Key("The grasp point and its velocity.")] = None
    next_tick: Annotated[
        NextTick | None,
        Key(
            "The prediction for the next line; without `--rate` that is expected after the interval between the last "
            "two measurements.",
            name="next",
        ),
    ] = None
    hypotheses: Annotated[
        tuple[SideHypothesis, ...],
        Key("Sides of the face on which the centre may lie; their weights add up to 1."),
    ] = ()
    model: Annotated[MotionModel | None, Key("The motion model with the highest evidence.")] = None
    process_noise: Annotated[ProcessNoise | None, Key("Spectral densities of the chosen filter.")] = None
    log_evidence: Annotated[
        Mapping[MotionModel, Annotated[float, Key(null=nan)]],
        Key(
            "The highest score of each motion model, by name: log likelihood of all innovations, less the penalty of "
            "BIC; see ringpose-method(7), section 10. Missing with `--brief`.",
            presence=Presence.NOT_BRIEF,
        ),
    ] = field(default_factory=lambda: dict.fromkeys(MotionModel, nan))
    camera: Annotated[CameraMotion, Key("What is known of the camera's own motion.")]
    capture_probability: Annotated[
        float | None,
        Key(
            "Probability that grasp point and normal are within the limits of the gripper at `stamp_s`; null without a "
            "gripper.",
            least=0.0,
            most=1.0,
        ),
    ] = None
    resets: Annotated[int, Key("How often the track was started anew.", least=0)] = 0
    attempts: Annotated[
        tuple[Attempt, ...],
        Key(
            "All measurements since the last line, in the order in which they arrived; missing with `--brief`.",
            presence=Presence.NOT_BRIEF,
        ),
    ] = ()
    lines_skipped: Annotated[int | None, Key("As in a pose line.", least=0, presence=Presence.IF_KNOWN)] = None
    rig: Annotated[str, Key("SHA-256 of the rig file.", null="", pattern="^[0-9a-f]{64}$")] = ""

    @classmethod
    def from_record(
        cls,
        fusion_status: FusionStatus,
        test_ratio: float,
        shot: str,
        reason: str,
        attempts: tuple[Attempt, ...],
        **keys: Any,
    ) -> "TrackLine":
        """The line of a record; a brief one states the newest measurement only."""
        newest = Attempt(shot=shot, stamp_s=nan, fusion_status=fusion_status, test_ratio=test_ratio, reason=reason)
        if not attempts and (shot or fusion_status is not FusionStatus.NONE):
            attempts = (newest,)
        return cls(attempts=attempts, **keys)

    @property
    def without_times(self) -> "TrackLine":
        """The line without the time that it took, which differs from run to run."""
        return replace(self, latency_s=nan)

    @property
    def attempt(self) -> Attempt:
        """The newest measurement since the last line."""
        return self.attempts[-1] if self.attempts else NO_ATTEMPT

    @property
    def fusion_status(
        self,
    ) -> Annotated[
        FusionStatus,
        Key("What became of the newest measurement since the last line.", after="flags", is_read=True),
    ]:
        """See `FusionStatus`."""
        return self.attempt.fusion_status

    @property
    def test_ratio(
        self,
    ) -> Annotated[
        float,
        Key(
            "Chi-squared of its innovation over the limit of the gate; null if it was not tested.",
            after="fusion_status",
            is_read=True,
            null=nan,
            least=0.0,
        ),
    ]:
        """NaN if the newest measurement was not tested."""
        return self.attempt.test_ratio

    @property
    def shot(
        self,
    ) -> Annotated[
        str,
        Key("The shot of the newest measurement since the last line.", after="attempts", is_read=True, null=""),
    ]:
        """Empty for an instant between measurements."""
        return self.attempt.shot

    @property
    def reason(
        self,
    ) -> Annotated[
        str, Key("Why the newest measurement was not used; null if it was.", after="shot", is_read=True, null="")
    ]:
        """Empty if the newest measurement was used."""
        return self.attempt.reason

    @property
    def age_s(self) -> Annotated[float, Key("Time since that measurement.", after="measurement_stamp_s", null=nan)]:
        """Time since the newest measurement that was used."""
        return self.stamp_s - self.measurement_stamp_s

    @property
    def status(self) -> Annotated[Status, Key("As in a pose line.", after="validity")]:
        """See `status_of`."""
        return status_of(self.pose, self.flags)
