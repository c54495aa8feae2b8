"""Results of the pose estimation: the pose of the ring, or the reason why there is none, and the record of one shot.

Also the prior radii of its edges, the triangulated break points, and the evidence of one shot for errors of the light
planes.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, IntFlag, StrEnum
from typing import Literal

import numpy as np

from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.assumptions import Assumptions
from ringpose.types.detection import Rejection
from ringpose.types.options import PoseFrame
from ringpose.types.rig import PlaneCorrection


class NoPose(Enum):
    """Reason why a shot has no pose; the value is the message for the user."""

    TOO_FEW_BREAK_POINTS = "too few break points: none at all, or for the closed forms fewer than three on an edge"
    UNTRIANGULATED = "a ray runs along its light plane or meets it behind the camera"
    COLLINEAR = "the break points lie on one line within their errors, which no plane determines"
    EDGE_ON = "the ring's plane passes through the camera: its face cannot be seen"
    AMBIGUOUS = "what was seen has several explanations with neither the ring's plane nor a grasp point in common"
    MIRRORED = "what was seen fits a ring only if the image is mirrored left to right; see the camera's flip"
    UNDETERMINED = "neither the ring's plane nor a point to grasp is determined by what was seen"
    SINGULAR = "the equations for the ring are numerically singular: what was seen contradicts itself or is degenerate"
    UNCONFIRMED = (
        "nothing shows that one or two stripes, seen with all lasers on, are those of the lasers on a ring: neither "
        "its curvature, nor visible edges where they end, nor enough clear ends"
    )
    NO_ROBOT_POSES = (
        "the robot's poses do not cover the shot, or have gaps: give them from before its first to after its last frame"
    )
    NOT_FINITE = "the solution misses the break points that it came from, as when the ring lies along a light plane"


class PoseFlag(IntFlag):
    """Warnings of a pose line; the record has their names in lower case. They may accompany any status."""

    CENTER_WEAK = 1 << 0
    NORMAL_WEAK = 1 << 1
    """One stripe does not determine the tilt about it: grasp point without a normal."""
    GRASP_WEAK = 1 << 2
    RADIUS_WEAK = 1 << 3
    VELOCITY_WEAK = 1 << 4
    SIDE_UNKNOWN = 1 << 5
    """Inner and outer edge could not be distinguished: the centre may lie on either side."""
    ASSIGNMENT_AMBIGUOUS = 1 << 6
    """The stripes fit one ring only, or about as well, if they are assigned to other lasers than given."""
    POINT_REJECTED = 1 << 7
    STRIPE_REJECTED = 1 << 8
    EDGE_REJECTED = 1 << 9
    """Visible points of the ring's edge were rejected as those of something else."""
    LASER_MISSING = 1 << 10
    """The stripe of a laser that was on should be in view, but was not found."""
    RADIUS_INCONSISTENT = 1 << 11
    """The observed ring does not have the given radii; the prior was rejected."""
    RADIUS_UNVERIFIED = 1 << 12
    """The radius is assumed: the shot alone determines it to no better than one percent."""
    RING_FORM = 1 << 13
    INCONSISTENT = 1 << 14
    """The observations disagree with one ring by more than their errors; the covariance is inflated accordingly."""
    MOTION = 1 << 15
    AMBIENT_CHANGED = 1 << 16
    RIG_DRIFT = 1 << 17
    RIG_UNCHECKED = 1 << 18
    """One or two stripes: the shot has no redundancy that could show an error of the rig."""
    SATURATED = 1 << 19
    """A break point could not be measured because the stripe is saturated there."""
    TRUNCATED = 1 << 20
    """A break point that should be in view could not be measured, as its stripe is cut off by the image's border."""
    BLUNT_EDGE = 1 << 21
    """The ring's edges are rounded or chamfered: the stripes fade over more columns than the optical blur explains."""


HARMLESS_FLAGS = PoseFlag.RADIUS_UNVERIFIED | PoseFlag.RIG_UNCHECKED
"""Flags that a pose with the status `ok` may have."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlaneEvidence:
    """What one shot shows about the rig's parameters: rows A q = y with noise of unit variance."""

    parameters: tuple[str, ...]
    rows: Float64[Array, "row column"]
    """[A, y], in the parameters' own units."""
    normal: Float64[Array, "xyz=3"]
    """Normal of the ring, by which shots of the same pose are recognized ..."""
    place_m: Float64[Array, "xyz=3"]
    """... and a point of its face."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingPose:
    """Pose of the ring in the camera frame, in metres."""

    center_m: Float64[Array, "xyz=3"]
    """NaN if not determined."""
    normal: Float64[Array, "xyz=3"]
    """Unit normal of the ring's plane, towards the camera (the paper's Z_b); NaN if not determined."""
    radius_inner_m: float
    radius_outer_m: float
    """NaN if that edge was not observed."""
    grasp_m: Float64[Array, "xyz=3"]
    """Grasp point: on the middle of the band, at the centre of the observations (method(7), section 5).

    In `paper` the mean of the break points. NaN if an edge was not observed, so that the middle is not known.
    """
    method: str
    condition_number: float
    """Condition number of the equations: in `ml` of all, columns scaled to unit length; else of the centre's, rows
    scaled."""
    residual_rms_px: float
    """Root mean square reprojection error of the break points."""
    covariance: Float64[Array, "7 7"] | None = None
    """Covariance of tilt_1, tilt_2, offset_m, center_1_m, center_2_m, radius_inner_m, radius_outer_m; NaN in the rows
    and columns of what is not determined.

    Plane: normal(tilt) . point = offset_m (`ringpose.geometry.rotations.tilted`); centre c = offset_m n + center_1_m e1
    + center_2_m e2, where the tilt basis e1, e2 tilts with the normal (method(7), section 8).
    """
    covariance_center_m2: Float64[Array, "3 3"] | None = None
    covariance_grasp_m2: Float64[Array, "3 3"] | None = None
    flags: PoseFlag = PoseFlag(0)
    remark: str = ""
    """Warning in words; empty if there is none."""
    ring_posterior: Mapping[str, float] | None = None
    """Posterior probability of each ring of a catalogue and of `none of these`; None without a catalogue."""

    @property
    def pitch_rad(self) -> float:
        """The paper's pitch: asin(w_y) of w = -normal, zero when the ring faces the camera (method(7), section 4)."""
        return float(np.arctan2(-self.normal[1], np.hypot(self.normal[0], self.normal[2])))

    @property
    def yaw_rad(self) -> float:
        """The paper's yaw: atan2(w_x, w_z) of w = -normal (method(7), section 4)."""
        return float(np.arctan2(-self.normal[0], -self.normal[2]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearizationPoint:
    """The ring about which a measurement is linearised, in the camera frame."""

    center_m: Float64[Array, "xyz=3"]
    normal: Float64[Array, "xyz=3"]
    radius_inner_m: float
    radius_outer_m: float
    velocity_m_s: Float64[Array, "xyz=3"]
    rate_rad_s: Float64[Array, "xyz=3"]


MEASURED_PARAMETERS = (
    "tilt_1", "tilt_2", "offset_m", "center_1_m", "center_2_m", "radius_inner_m", "radius_outer_m",
    "velocity_x_m_s", "velocity_y_m_s", "velocity_z_m_s", "rate_1_rad_s", "rate_2_rad_s",
)  # fmt: skip
"""The ring's parameters in a measurement: increments about the linearisation point, tilt basis of its normal.

c = offset_m n + center_1_m e1 + center_2_m e2, where e1 and e2 tilt with n (method(7), section 8).
"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingMeasurement:
    """The information of one shot alone, without any prior (ringpose-method(7), section 9); always camera frame."""

    linearized_at: LinearizationPoint
    nuisance_parameters: tuple[str, ...]
    """Common errors that several shots share: parameters of rig, ring form and mount, in their own units."""
    square_root: Float64[Array, "row column"]
    """Upper-trapezoidal QR factor of the whitened rows [J, J_q, z - h]; columns: `MEASURED_PARAMETERS`,
    `nuisance_parameters`, residual."""
    degrees_of_freedom: int
    chi2: float
    camera_motion: Literal["none", "robot_poses"] = "none"


@dataclass(frozen=True, slots=True, kw_only=True)
class RadiusPrior:
    """Assumed edge radii; NaN for an edge without a prior."""

    inner_m: float
    outer_m: float
    inner_sd_m: float
    outer_sd_m: float
    source: str
    """`given`, or the name of the catalogue's ring."""

    @property
    def sd_m(self) -> float:
        """The larger standard deviation."""
        return max(sd for sd in (self.inner_sd_m, self.outer_sd_m, 0.0) if sd == sd)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Priors:
    """Prior assumptions of a pose."""

    assumptions: Assumptions = Assumptions()
    radius: RadiusPrior | None = None
    rig_covariance: bool = False
    """Whether the covariance of rig.yaml was used; without one the calibration counts as exact."""
    moved_planes: Mapping[str, PlaneCorrection] = field(default_factory=dict)
    """The corrections of light planes, by the laser's name."""
    regularization: Float64[Array, "row column"] | None = None
    """Rows [J, z - h] in units of their standard deviations, columns `MEASURED_PARAMETERS` and residual: weak priors
    that hold the parameters which the shot leaves open; None if it leaves none open."""


class LaserState(StrEnum):
    """Contribution of a laser's stripe to a pose."""

    USED = "used"
    PARTLY = "partly"
    """One or both of its break points that should be in view were rejected or not found."""
    REJECTED = "rejected"
    NOT_SEEN = "not_seen"
    """Its stripe should be in view, or in a shot without a ring may be, but was not found."""
    OUT_OF_VIEW = "out_of_view"
    """By rig and ring, its stripe lies outside the image."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseResult:
    """The result of the estimation from one detection."""

    pose: RingPose | NoPose
    flags: PoseFlag = PoseFlag(0)
    """Flags of the pose, if there is one."""
    remark: str = ""
    """What contradicts the pose, in words; empty if nothing does."""
    stamp_s: float = math.nan
    """The instant at which the pose holds; NaN if the features' stamps are unknown."""
    velocity: "RingVelocity | None" = None
    """None if the target is assumed to be still."""
    measurement: RingMeasurement | None = None
    priors: Priors | None = None
    lasers: Mapping[str, LaserState] = field(default_factory=dict)
    rejected: tuple[Rejection, ...] = ()
    plane_evidence: PlaneEvidence | None = None
    """Evidence for errors of the light planes, of all measurements if some of them contradict one ring; None for
    methods without residuals."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingVelocity:
    """Velocity of the ring's centre and its angular velocity across the normal, camera frame."""

    center_m_s: Float64[Array, "xyz=3"]
    rate_rad_s: Float64[Array, "xyz=3"]
    """Perpendicular to the normal; the spin about the normal is not observable."""
    covariance: Float64[Array, "5 5"]
    """Covariance of velocity x, y, z, rate_1, rate_2."""


Status = Literal["ok", "degraded", "none"]


def status_of(pose: RingPose | None, flags: PoseFlag) -> Status:
    """The status of a line: `none`, `degraded` (a pose with flags other than `HARMLESS_FLAGS`) or `ok`."""
    if pose is None:
        return "none"
    return "degraded" if flags & ~HARMLESS_FLAGS else "ok"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseLine:
    """Record of one shot: its pose or the reason why it has none, and the provenance."""

    shot: str
    stamp_s: float
    """Mid exposure of the first frame with a laser on."""
    pose: RingPose | None
    pose_stamp_s: float = math.nan
    """The instant at which pose and velocity hold."""
    flags: PoseFlag = PoseFlag(0)
    reason: str | None = None
    """Reason why there is no pose; with a pose, what contradicts it, or None."""
    frame: PoseFrame = PoseFrame.CAMERA
    """Frame in which the pose is expressed."""
    velocity: RingVelocity | None = None
    """None if the target is assumed to be still."""
    measurement: RingMeasurement | None = None
    priors: Priors | None = None
    lasers: Mapping[str, LaserState] = field(default_factory=dict)
    rejected: tuple[Rejection, ...] = ()
    plane_evidence: PlaneEvidence | None = None
    """See `PoseResult`."""
    rig_health: Mapping[str, float] = field(default_factory=dict)
    """Normalised error of each laser's light plane; empty where it was not measured."""
    shots_dropped: int = 0
    """Number of shots that were lost since the previous one."""
    latency_s: float = math.nan
    """Time from the shot in memory to its pose; NaN where it was not measured."""
    stage_s: Mapping[str, float] = field(default_factory=dict)
    """Time that each stage of the computation took."""
    rig: str = ""
    """SHA-256 of the rig file."""

    @property
    def status(self) -> Status:
        """See `status_of`."""
        return status_of(self.pose, self.flags)

    @property
    def flag_names(self) -> tuple[str, ...]:
        """Names of the flags, in lower case."""
        return tuple(str(flag.name).lower() for flag in PoseFlag if flag in self.flags)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingPoints:
    """Triangulated break points on the two edges of the ring's face, camera frame; NaN where one was not measured."""

    position_m: Float64[Array, "laser edge=2 xyz=3"]

    @property
    def seen(self) -> Bool[Array, "laser edge=2"]:
        """Mask of the break points that were measured."""
        seen: Bool[Array, "laser edge=2"] = ~(self.position_m != self.position_m).any(axis=-1)
        return seen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnownRadii:
    """Prior of the radii of the ring's edges."""

    radius_m: Float64[Array, "edge=2"]
    """NaN for an edge without a prior."""
    sd_m: Float64[Array, "edge=2"]
    """Standard deviations."""
    tolerance_m: float | None = None
    """Tolerance of the ring's form by a catalogue; None if it states none, or the user states another one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ring:
    """An entry of a catalogue, with radii as intervals: real ones differ from nominal ones by millimetres."""

    name: str
    radius_inner_m: tuple[float, float]
    """Lower and upper limit."""
    radius_outer_m: tuple[float, float]
    source: str = ""
    tolerance_m: float | None = None
    """Standard deviation of the edges from circles, and of the face from a plane."""

    @property
    def known_radii(self) -> KnownRadii:
        """Mean and standard deviation of a uniform distribution over each interval."""
        intervals = np.array([self.radius_inner_m, self.radius_outer_m])
        return KnownRadii(
            radius_m=intervals.mean(axis=1), sd_m=np.ptp(intervals, axis=1) / np.sqrt(12), tolerance_m=self.tolerance_m
        )
