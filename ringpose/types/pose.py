"""The answer: where the ring is, or why nobody knows.

What is said about one shot in the end.

The break points in space.

What one shot says about errors of the light planes.
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
    """Why a shot has no pose; the value is the sentence the user reads."""

    TOO_FEW_BREAK_POINTS = "too few break points: an edge must be seen by three lasers"
    UNTRIANGULATED = "a ray runs along its light plane or meets it behind the camera"
    COLLINEAR = "the break points lie on one line within their errors, which no plane determines"
    EDGE_ON = "the ring's plane passes through the camera: its face cannot be seen"
    UNDETERMINED = "neither the ring's plane nor a point to grasp is determined by what was seen"
    SINGULAR = "the equations for the ring are numerically singular: what was seen contradicts itself or is degenerate"
    NOT_FINITE = "the solution misses the break points that it came from, as when the ring lies along a light plane"


class PoseFlag(IntFlag):
    """What to mind about a pose."""

    CENTER_WEAK = 1
    RADIUS_WEAK = 2
    DAMPED = 4
    """The closed form was near singular; damped least squares pulled the centre towards the points."""
    NORMAL_WEAK = 8
    """One stripe leaves the tilt about it open: grasp point without a normal."""
    SIDE_UNKNOWN = 16
    """Inner and outer edge could not be told apart: the centre may lie on either side."""
    POINT_LEFT_OUT = 32
    """A break point contradicts the others and was left out."""
    STRIPE_LEFT_OUT = 64
    """A laser's stripe contradicts the others and was left out."""
    RELABELLED = 128
    """The stripes fit one ring only if they belong to other lasers than was said."""
    RADIUS_DISAGREES = 256
    """The ring that was seen has not the radii that were said; they were left out."""
    INCONSISTENT = 512
    """What was seen disagrees with one ring by more than its errors; the covariance is widened accordingly."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlaneEvidence:
    """Whether each light plane, if it alone had moved, would explain what its stripe leaves over.

    Sums over shots add up. A plane's most likely error (tilt_1, tilt_2, distance) is information^-1 score, and
    score^T information^-1 score is the square of that error in its standard deviations.
    """

    score: Float64[Array, "laser parameter=3"]
    information: Float64[Array, "laser parameter=3 parameter=3"]
    """Zero for a laser that nothing checks: two stripes alone agree with every plane."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingPose:
    """Pose of the ring in the camera frame, in metres."""

    center_m: Float64[Array, "xyz=3"]
    """NaN if it is not determined."""
    normal: Float64[Array, "xyz=3"]
    """Unit normal of the ring's plane, towards the camera (the paper's Z_b); NaN if it is not determined."""
    radius_inner_m: float
    radius_outer_m: float
    """NaN where that edge was not seen."""
    grasp_m: Float64[Array, "xyz=3"]
    """The point where a gripper would close: in the middle of the band, amid what was seen (method(7), section 5).

    In `paper` the mean of the break points. NaN where the middle of the band is not known, an edge being unseen.
    """
    method: str
    condition: float
    """Of the equations: in `ml` for everything, columns scaled to unit length; else for the centre, rows scaled."""
    residual_rms_px: float
    """Distance of the break points from those that the pose predicts."""
    covariance: Float64[Array, "7 7"] | None = None
    """Of tilt_1, tilt_2, offset_m, center_1_m, center_2_m, radius_inner_m, radius_outer_m; NaN in rows and
    columns of what is not determined.

    Plane: normal(tilt) . point = offset_m (`ringpose.geometry.rotations.tilted`). center_1_m and center_2_m are the
    centre's coordinates along the tilt basis of the estimated normal, which stays while the ring tilts.
    """
    covariance_center_m2: Float64[Array, "3 3"] | None = None
    covariance_grasp_m2: Float64[Array, "3 3"] | None = None
    flags: PoseFlag = PoseFlag(0)
    remark: str = ""
    """What to mind, in words; empty if nothing."""
    ring_posterior: Mapping[str, float] | None = None
    """Probability of each ring of a catalogue, `none of these` among them; None without a catalogue."""
    plane_evidence: PlaneEvidence | None = None
    """What the stripes say about the light planes; None in methods that do not use them."""

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
    """The pose of one shot, or the reason why it has none, with where it came from."""

    shot: str
    stamp_s: float
    pose: RingPose | None
    reason: str | None = None
    """Why there is no pose; of a pose what contradicts it, None if nothing does."""
    frame: PoseFrame = PoseFrame.CAMERA
    """The frame of the pose's vectors."""
    laser_health: Mapping[str, float] = field(default_factory=dict)
    """A figure for each laser; empty where it was not measured."""
    dropped: int = 0
    """Shots that were lost between the one before and this one."""
    latency_s: float = math.nan
    """From the shot in memory to its pose; NaN where it was not measured."""
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
    """Points on the two edges of the ring's face, in the camera frame; NaN where one was not seen."""

    position_m: Float64[Array, "laser edge=2 xyz=3"]

    @property
    def seen(self) -> Bool[Array, "laser edge=2"]:
        """Which of them were seen."""
        seen: Bool[Array, "laser edge=2"] = ~(self.position_m != self.position_m).any(axis=-1)
        return seen
