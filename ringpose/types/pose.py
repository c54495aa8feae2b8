"""Results of the pose estimation: the pose of the ring, or the reason why there is none, and the record of one shot.

Also the triangulated break points, and the evidence of one shot for errors of the light planes.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, IntFlag
from typing import Literal

import numpy as np

from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.options import PoseFrame


class NoPose(Enum):
    """Reason why a shot has no pose; the value is the message for the user."""

    TOO_FEW_BREAK_POINTS = "too few break points: an edge must be seen by three lasers"
    UNTRIANGULATED = "a ray runs along its light plane or meets it behind the camera"
    COLLINEAR = "the break points lie on one line within their errors, which no plane determines"
    EDGE_ON = "the ring's plane passes through the camera: its face cannot be seen"
    UNDETERMINED = "neither the ring's plane nor a point to grasp is determined by what was seen"
    SINGULAR = "the equations for the ring are numerically singular: what was seen contradicts itself or is degenerate"
    NOT_FINITE = "the solution misses the break points that it came from, as when the ring lies along a light plane"


class PoseFlag(IntFlag):
    """Warnings about a pose."""

    CENTER_WEAK = 1
    RADIUS_WEAK = 2
    DAMPED = 4
    """The closed form was near singular; damped least squares pulled the centre towards the points."""
    NORMAL_WEAK = 8
    """One stripe does not determine the tilt about it: grasp point without a normal."""
    SIDE_UNKNOWN = 16
    """Inner and outer edge could not be distinguished: the centre may lie on either side."""
    POINT_LEFT_OUT = 32
    """A break point was rejected as an outlier."""
    STRIPE_LEFT_OUT = 64
    """A laser's stripe was rejected as an outlier."""
    RELABELLED = 128
    """The stripes fit one ring only if assigned to other lasers than given."""
    RADIUS_DISAGREES = 256
    """The observed ring does not have the given radii; the prior was rejected."""
    INCONSISTENT = 512
    """The observations disagree with one ring by more than their errors; the covariance is inflated accordingly."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlaneEvidence:
    """Score and Fisher information of an error of each single light plane, from the residuals of its stripe.

    Both are additive over shots. The maximum-likelihood error (tilt_1, tilt_2, distance) of a plane is
    information^-1 score, and its squared Mahalanobis length is score^T information^-1 score.
    """

    score: Float64[Array, "laser parameter=3"]
    information: Float64[Array, "laser parameter=3 parameter=3"]
    """Zero for a laser without redundancy: any plane is consistent with two stripes alone."""


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
    condition: float
    """Condition number of the equations: in `ml` of all, columns scaled to unit length; else of the centre's, rows
    scaled."""
    residual_rms_px: float
    """Root mean square reprojection error of the break points."""
    covariance: Float64[Array, "7 7"] | None = None
    """Covariance of tilt_1, tilt_2, offset_m, center_1_m, center_2_m, radius_inner_m, radius_outer_m; NaN in the rows
    and columns of what is not determined.

    Plane: normal(tilt) . point = offset_m (`ringpose.geometry.rotations.tilted`). center_1_m and center_2_m are the
    centre's coordinates along the tilt basis of the estimated normal, which is held fixed while the ring tilts.
    """
    covariance_center_m2: Float64[Array, "3 3"] | None = None
    covariance_grasp_m2: Float64[Array, "3 3"] | None = None
    flags: PoseFlag = PoseFlag(0)
    remark: str = ""
    """Warning in words; empty if there is none."""
    ring_posterior: Mapping[str, float] | None = None
    """Posterior probability of each ring of a catalogue and of `none of these`; None without a catalogue."""
    plane_evidence: PlaneEvidence | None = None
    """Evidence of the stripes for errors of the light planes; None for methods that do not use them."""

    @property
    def pitch_rad(self) -> float:
        """The paper's pitch: asin(w_y) of w = -normal, zero when the ring faces the camera (method(7), section 4)."""
        return float(np.arctan2(-self.normal[1], np.hypot(self.normal[0], self.normal[2])))

    @property
    def yaw_rad(self) -> float:
        """The paper's yaw: atan2(w_x, w_z) of w = -normal (method(7), section 4)."""
        return float(np.arctan2(-self.normal[0], -self.normal[2]))


Status = Literal["ok", "degraded", "none"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseLine:
    """Record of one shot: its pose or the reason why it has none, and the provenance."""

    shot: str
    stamp_s: float
    pose: RingPose | None
    reason: str | None = None
    """Reason why there is no pose; with a pose, what contradicts it, or None."""
    frame: PoseFrame = PoseFrame.CAMERA
    """Frame in which the pose is expressed."""
    laser_health: Mapping[str, float] = field(default_factory=dict)
    """Normalised error of each laser; empty where it was not measured."""
    dropped: int = 0
    """Number of shots that were lost since the previous one."""
    latency_s: float = math.nan
    """Time from the shot in memory to its pose; NaN where it was not measured."""
    rig: str = ""
    """SHA-256 of the rig file."""

    @property
    def status(self) -> Status:
        """`ok`, `degraded` (a pose with flags) or `none`."""
        if self.pose is None:
            return "none"
        return "degraded" if self.pose.flags else "ok"

    @property
    def flags(self) -> tuple[str, ...]:
        """Names of the pose's flags, in lower case."""
        flags = PoseFlag(0) if self.pose is None else self.pose.flags
        return tuple(str(flag.name).lower() for flag in PoseFlag if flag in flags)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingPoints:
    """Triangulated break points on the two edges of the ring's face, camera frame; NaN where one was not measured."""

    position_m: Float64[Array, "laser edge=2 xyz=3"]

    @property
    def seen(self) -> Bool[Array, "laser edge=2"]:
        """Which of them were measured."""
        seen: Bool[Array, "laser edge=2"] = ~(self.position_m != self.position_m).any(axis=-1)
        return seen
