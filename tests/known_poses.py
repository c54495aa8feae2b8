"""A ring that faces the camera at 1 m, and poses that are off by known amounts."""

import gzip
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from ringpose.bench import score
from ringpose.files.records import line_of
from ringpose.files.records.poses import pose_record
from ringpose.files.records.truths import truth_record
from ringpose.types.pose import PoseFlag, PoseLine, RingPose
from ringpose.types.truth import Truth

CENTER_M = np.array([0.1, -0.2, 1.0])
NORMAL = np.array([0.0, 0.0, -1.0])
ANGLES_RAD = (-0.2, 0.0, 0.3)
"""Where the three stripes cross the ring, from the x axis."""

FOCAL_PX, PRINCIPAL_PX = 1000.0, np.array([800.0, 600.0])
NO_FLAG = PoseFlag(0)
RADII = {"radius_inner_m": 0.4, "radius_outer_m": 0.5}


def on_ring(angle_rad: float, radius_m: float) -> Any:
    """The point of the ring's plane at an angle from the x axis and a radius."""
    return CENTER_M + radius_m * np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0])


def truth_of(**changes: Any) -> Truth:
    points_m = np.array([[on_ring(angle, 0.4), on_ring(angle, 0.5)] for angle in ANGLES_RAD])
    pixels = FOCAL_PX * points_m[..., :2] / points_m[..., 2:] + PRINCIPAL_PX
    values = {"shot": "a", "expect": "pose", "center_m": CENTER_M, "normal": NORMAL, "break_points_px": pixels}
    return Truth(**(values | RADII | changes))


def pose_of(**changes: Any) -> RingPose:
    """The true pose, but for the changes."""
    values = {"center_m": CENTER_M, "normal": NORMAL, "grasp_m": on_ring(0.0, 0.45)}
    fit = {"method": "paper", "condition_number": 1.0, "residual_rms_px": 0.0}
    return RingPose(**(values | RADII | fit | changes))


def estimate_of(
    shot: str = "a", method: str = "paper", flags: PoseFlag = NO_FLAG, line: Any = None, **changes: Any
) -> score.PoseEstimate:
    """The true estimate, but for changes of the pose and of its line."""
    pose = pose_of(method=method, flags=flags, **changes)
    return score.estimate_of(PoseLine(shot=shot, pose=pose, flags=flags, **({"stamp_s": np.nan} | (line or {}))), "x")


def write_truths(name: str, truths: Iterable[Truth]) -> None:
    Path(name).write_text("".join(line_of(truth_record(truth)) for truth in truths))


def write_lines(name: str, lines: Iterable[PoseLine]) -> str:
    """The records of the lines, compressed if the name says so."""
    text = "".join(line_of(pose_record(line)) for line in lines).encode()
    Path(name).write_bytes(gzip.compress(text, mtime=0) if name.endswith(".gz") else text)
    return name
