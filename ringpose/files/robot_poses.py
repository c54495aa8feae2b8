"""Poses of a robot (JSON lines), and the mount of the camera in rig.yaml with its errors."""

from pathlib import Path

import numpy as np

from ringpose.errors import DataError
from ringpose.files.cameras.covariances import checked_covariance
from ringpose.files.inputs import Record, inputs
from ringpose.files.io import read_bytes
from ringpose.files.rigs import read_mount
from ringpose.files.schema import Fields
from ringpose.files.yaml import parsed
from ringpose.types.arrays import Array, Float64
from ringpose.types.robot import Mount, RobotPoses

MAX_REACH_M = 100.0
"""Longest plausible distance of a tool from the robot's base."""

MAX_QUATERNION_ERROR = 1e-3
"""Tolerance of the length of a quaternion, for values rounded in a file."""


def read_robot_poses(path: Path) -> RobotPoses:
    """The poses in a file, in the order of their stamps."""
    stamps_s, positions_m, rotations = [], [], []
    for item in inputs([path], (".jsonl",)):
        if not isinstance(item, Record):
            if isinstance(item, Path):
                raise DataError(str(item), "is not a file of robot poses", "give JSON lines in a file *.jsonl")
            raise item
        fields = Fields(item.location, item.values)
        pose = fields.fields("base_from_tool")
        position_m = pose.vector("position_m", 3)
        if np.abs(position_m).max() > MAX_REACH_M:
            raise pose.problem(
                "position_m", f"is {np.abs(position_m).max():g}", "give metres; this looks like millimetres"
            )
        stamps_s.append(fields.number("stamp_s"))
        positions_m.append(position_m)
        rotations.append(_rotation(pose))
    order = np.argsort(stamps_s, kind="stable")
    stamp_s = np.array(stamps_s)[order]
    if len(stamp_s) < 2 or (np.diff(stamp_s) <= 0).any():
        found = "has two poses of one stamp" if len(stamp_s) > 1 else "has fewer than two poses"
        raise DataError(str(path), found, "give the robot's poses at least ten times a second")
    return RobotPoses(stamp_s=stamp_s, position_m=np.array(positions_m)[order], rotation=np.array(rotations)[order])


def _rotation(pose: Fields) -> Float64[Array, "3 3"]:
    quaternion = pose.vector("orientation_xyzw", 4)
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1.0) > MAX_QUATERNION_ERROR:
        remedy = "give a unit quaternion x, y, z, w; this looks like degrees" if length > 2.0 else "normalize it"
        raise pose.problem("orientation_xyzw", f"has length {length:.6g}, must be 1", remedy)
    x, y, z, w = (quaternion / length).tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def read_mount_with_errors(path: Path) -> Mount:
    """The mount in a rig.yaml; one without `covariance`, `delay_s` or `delay_sd_s` counts as exact in these."""
    matrix = read_mount(path)
    fields = Fields(str(path), parsed(read_bytes(path), str(path))).fields("mount")
    covariance = np.zeros((6, 6))
    if fields.has("covariance"):
        covariance = checked_covariance(fields, "covariance", fields.array("covariance", (6, 6)))
    variance, axes = np.linalg.eigh(covariance)
    return Mount(
        tool_from_camera=matrix,
        root=axes * np.sqrt(np.maximum(variance, 0.0)),
        delay_s=fields.number("delay_s") if fields.has("delay_s") else 0.0,
        delay_sd_s=fields.number("delay_sd_s", least=0) if fields.has("delay_sd_s") else 0.0,
    )
