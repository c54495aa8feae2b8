"""What one method answered about one shot."""

from dataclasses import dataclass

from ringpose.errors import DataError
from ringpose.types.pose_frame import PoseFrame
from ringpose.types.pose_line import PoseLine
from ringpose.types.ring_pose import RingPose


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """A pose in the camera frame, or None."""

    shot: str
    method: str
    """Empty where a line without a pose does not name it."""
    pose: RingPose | None


def answer_of(line: PoseLine, place: str) -> Answer:
    """The answer that a pose line is; truth is known in the camera frame alone."""
    if line.pose is not None and line.frame is not PoseFrame.CAMERA:
        raise DataError(place, f"is in the {line.frame} frame", "give poses in the camera frame")
    return Answer(shot=line.shot, method=line.pose.method if line.pose else "", pose=line.pose)
