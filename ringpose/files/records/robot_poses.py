"""Poses of a robot (JSON lines): the reader of one line, and of those that arrive while the target is measured."""

import threading
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ringpose.errors import DataError, NoInputError, RingposeError
from ringpose.files.inputs import Input, Problem, Record, inputs
from ringpose.files.records.codec import RecordType
from ringpose.files.schema import ROBOT_POSE, kind_of
from ringpose.geometry.rotations import rotation_of
from ringpose.types.options import STDIN
from ringpose.types.rig import RobotPose, RobotPoses
from ringpose.types.robot import ReportedPose

KEPT_S = 5.0
"""Time for which poses that arrive on standard input are kept: longer than late records and backgrounds are used."""


RECORD = RecordType(
    cls=RobotPose,
    kind=ROBOT_POSE,
    description="The pose of a robot at one time, one line of a file of robot poses. Metres, seconds. Readers ignore "
    "unknown keys.",
)


def pose_in_record(item: Input | Problem) -> ReportedPose:
    """The pose in a JSON line; its errors name the line."""
    if not isinstance(item, Record):
        if isinstance(item, Path):
            raise DataError(str(item), "is not a robot pose", "give JSON lines, or --robot-convention for a table")
        raise item
    other = kind_of(item.values)
    if other is not None and other is not ROBOT_POSE:
        raise DataError(item.location, *ROBOT_POSE.instead_of(other))
    read = RECORD.read(item.values, item.location)
    tool = read.base_from_tool
    return ReportedPose(item.location, read.shot, read.stamp_s, tool.position_m, rotation_of(tool.orientation_xyzw))


def motion_of(poses: Sequence[ReportedPose], repeats: int = 0) -> RobotPoses:
    """The motion of the tool by poses in the order of their stamps; DataError for one without a stamp."""
    return RobotPoses(
        stamp_s=np.array([stamp_of(pose) for pose in poses], dtype=np.float64),
        position_m=np.array([pose.position_m for pose in poses], dtype=np.float64).reshape(-1, 3),
        rotation=np.array([pose.rotation for pose in poses], dtype=np.float64).reshape(-1, 3, 3),
        repeats=repeats,
    )


def stamp_of(pose: ReportedPose) -> float:
    """The stamp of a pose, without which it belongs to no frame (DataError)."""
    if pose.stamp_s is None:
        remedy = "give stamp_s: as a key of a JSON line, or as the name of a column (--robot-columns)"
        raise DataError(pose.location, "has no stamp, by which the pose belongs to a frame", remedy)
    return pose.stamp_s


class RobotPoseStream:
    """Poses that arrive on standard input while the target is measured; a thread reads them."""

    def __init__(self, report: Callable[[DataError | NoInputError], None]) -> None:
        """`report` receives the errors of invalid poses, which are left out, as identical repeats are."""
        self.received, self.repeats = 0, 0
        """Number of valid poses that have arrived, and of those among them that repeat the one before exactly."""
        self._report, self._poses, self._ended = report, deque[ReportedPose](), False
        self._failure: RingposeError | None = None
        self._changed = threading.Condition()
        threading.Thread(target=self._read, name="robot poses", daemon=True).start()

    def until(self, stamp_s: float, patience_s: float) -> RobotPoses:
        """The poses so far, once there is one at `stamp_s` or later, for which it waits at most `patience_s`.

        Raises what ended the reading of standard input, if that was an error.
        """
        with self._changed:
            self._changed.wait_for(
                lambda: self._ended or (len(self._poses) > 1 and stamp_of(self._poses[-1]) >= stamp_s), patience_s
            )
            if self._failure is not None:
                raise self._failure
            return motion_of(list(self._poses))

    def _read(self) -> None:
        try:
            for item in inputs([STDIN], (".jsonl",)):
                try:
                    self._add(pose_in_record(item))
                except (DataError, NoInputError) as problem:
                    self._report(problem)
        except RingposeError as failure:
            self._failure = failure
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _add(self, pose: ReportedPose) -> None:
        stamp_s = stamp_of(pose)
        with self._changed:
            self.received += 1
            if self._poses and pose.repeats(self._poses[-1]):
                self.repeats += 1
                return
            if self._poses and stamp_s <= stamp_of(self._poses[-1]):
                finding = f"has the stamp {stamp_s:.6f}, which is not later than the one before"
                raise DataError(pose.location, finding, "give the poses in the order of their stamps")
            self._poses.append(pose)
            while stamp_s - stamp_of(self._poses[0]) > KEPT_S and len(self._poses) > 2:
                self._poses.popleft()
            self._changed.notify_all()
