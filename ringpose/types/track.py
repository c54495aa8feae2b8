"""The record of a track: where the ring is and how it moves, from a stream of pose records."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

from ringpose.types.arrays import Array, Float64
from ringpose.types.options import PoseFrame
from ringpose.types.pose import PoseFlag, RingPose, RingVelocity, Status, status_of


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


CameraMotion = Literal["inertial_assumed", "robot_poses"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """One measurement and how it was used."""

    shot: str
    stamp_s: float
    fusion_status: FusionStatus
    test_ratio: float
    """Chi-squared of the innovation over the limit of the gate; NaN if it was not tested."""
    reason: str = ""
    """Why it was not used, or that the clock was set back before it; empty if it was used."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GraspState:
    """The grasp point and its velocity."""

    point_m: Float64[Array, "xyz=3"]
    velocity_m_s: Float64[Array, "xyz=3"]
    covariance: Float64[Array, "6 6"]
    """Covariance of point and velocity. The point is chosen on the ring: it has no error along the face."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NextTick:
    """The predicted grasp point and normal at the time of the next record."""

    stamp_s: float
    grasp_m: Float64[Array, "xyz=3"]
    normal: Float64[Array, "xyz=3"]
    covariance: Float64[Array, "5 5"]
    """Covariance of grasp point x, y, z, and the two tilts of the normal."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SideHypothesis:
    """One side of the face on which the ring's centre may lie."""

    side: int
    """1: that of the first record; -1: the other one."""
    weight: float
    center_m: Float64[Array, "xyz=3"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrackLine:
    """Record of a track at one instant."""

    stamp_s: float
    attempt: Attempt
    """The newest measurement since the last line."""
    attempts: tuple[Attempt, ...] = ()
    """All measurements since the last line, in the order in which they arrived."""
    measurement_stamp_s: float
    """Stamp of the newest measurement that was used; NaN without a track."""
    validity: Validity
    frame: PoseFrame | Literal["base"]
    pose: RingPose | None = None
    velocity: RingVelocity | None = None
    grasp: GraspState | None = None
    next_tick: NextTick | None = None
    hypotheses: tuple[SideHypothesis, ...] = ()
    flags: PoseFlag = PoseFlag(0)
    model: MotionModel | None = None
    process_noise: tuple[float, float] | None = None
    """Power spectral densities of the chosen filter: m^2/s^3 and rad^2/s^3."""
    log_evidence: Mapping[MotionModel, float]
    camera: CameraMotion
    capture_probability: float | None = None
    resets: int = 0
    rig: str = ""

    @property
    def age_s(self) -> float:
        """Time since the newest measurement that was used."""
        return self.stamp_s - self.measurement_stamp_s

    @property
    def status(self) -> Status:
        """See `status_of`."""
        return status_of(self.pose, self.flags)
