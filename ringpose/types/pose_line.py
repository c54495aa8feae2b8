"""What is said about one shot in the end."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from ringpose.types.pose_frame import PoseFrame
from ringpose.types.ring_pose import PoseFlag, RingPose

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
