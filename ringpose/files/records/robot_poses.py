"""Poses of a robot (JSON lines)."""

import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ringpose.errors import DataError, NoInputError, RingposeError
from ringpose.files.inputs import Input, Problem, Record, inputs
from ringpose.files.records.codec import RecordType
from ringpose.files.schema import ROBOT_POSE, kind_of
from ringpose.geometry.rotations import rotation_of
from ringpose.types.options import STDIN
from ringpose.types.rig import RobotPose, RobotPoses

KEPT_S = 5.0
"""Time for which poses that arrive on standard input are kept: longer than late records and backgrounds are used."""


RECORD = RecordType(
    cls=RobotPose,
    kind=ROBOT_POSE,
    description="The pose of a robot at one time, one line of a file of robot poses. Metres, seconds. Readers ignore "
    "unknown keys.",
)


def read_robot_poses(source: Path | str) -> RobotPoses:
    """The poses in a file, or on standard input (`-`) until its end, in the order of their stamps, without repeats."""
    read = sorted((_robot_pose(item) for item in inputs([source], (".jsonl",))), key=lambda pose: pose.stamp_s)
    location = "standard input" if source == STDIN else str(source)
    poses: list[RobotPose] = []
    for pose in read:
        if not poses or pose.stamp_s > poses[-1].stamp_s:
            poses.append(pose)
        elif not pose.repeats(poses[-1]):
            finding = f"has two poses of the stamp {pose.stamp_s:.6f} that differ"
            raise DataError(location, finding, "give the poses of one robot, each with the stamp at which it holds")
    if len(poses) < 2:
        raise DataError(location, "has fewer than two poses", "give the robot's poses at least ten times a second")
    return replace(_joined(poses), repeats=len(read) - len(poses))


class RobotPoseStream:
    """Poses that arrive on standard input while the target is measured; a thread reads them."""

    def __init__(self, report: Callable[[DataError | NoInputError], None]) -> None:
        """`report` receives the errors of invalid poses, which are left out, as identical repeats are."""
        self.received, self.repeats = 0, 0
        """Number of valid poses that have arrived, and of those among them that repeat the one before exactly."""
        self._report, self._poses, self._ended = report, deque[RobotPose](), False
        self._failure: RingposeError | None = None
        self._changed = threading.Condition()
        threading.Thread(target=self._read, name="robot poses", daemon=True).start()

    def until(self, stamp_s: float, patience_s: float) -> RobotPoses:
        """The poses so far, once there is one at `stamp_s` or later, for which it waits at most `patience_s`.

        Raises what ended the reading of standard input, if that was an error.
        """
        with self._changed:
            self._changed.wait_for(
                lambda: self._ended or (len(self._poses) > 1 and self._poses[-1].stamp_s >= stamp_s), patience_s
            )
            if self._failure is not None:
                raise self._failure
            return _joined(list(self._poses))

    def _read(self) -> None:
        try:
            for item in inputs([STDIN], (".jsonl",)):
                try:
                    self._add(_robot_pose(item), getattr(item, "location", STDIN))
                except (DataError, NoInputError) as problem:
                    self._report(problem)
        except RingposeError as failure:
            self._failure = failure
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _add(self, pose: RobotPose, location: str) -> None:
        with self._changed:
            self.received += 1
            if self._poses and pose.repeats(self._poses[-1]):
                self.repeats += 1
                return
            if self._poses and pose.stamp_s <= self._poses[-1].stamp_s:
                finding = f"has the stamp {pose.stamp_s:.6f}, which is not later than the one before"
                raise DataError(location, finding, "give the poses in the order of their stamps")
            self._poses.append(pose)
            while pose.stamp_s - self._poses[0].stamp_s > KEPT_S and len(self._poses) > 2:
                self._poses.popleft()
            self._changed.notify_all()


def _joined(poses: Sequence[RobotPose]) -> RobotPoses:
    return RobotPoses(
        stamp_s=np.array([pose.stamp_s for pose in poses], dtype=np.float64),
        position_m=np.array([pose.base_from_tool.position_m for pose in poses], dtype=np.float64).reshape(-1, 3),
        rotation=np.array(
            [rotation_of(pose.base_from_tool.orientation_xyzw) for pose in poses], dtype=np.float64
        ).reshape(-1, 3, 3),
    )


def _robot_pose(item: Input | Problem) -> RobotPose:
    """The pose in a record; its errors name the line."""
    if not isinstance(item, Record):
        if isinstance(item, Path):
            raise DataError(str(item), "is not a robot pose", "give JSON lines, or --robot-convention for a table")
        raise item
    other = kind_of(item.values)
    if other is not None and other is not ROBOT_POSE:
        raise DataError(item.location, *ROBOT_POSE.instead_of(other))
    return RECORD.read(item.values, item.location)
