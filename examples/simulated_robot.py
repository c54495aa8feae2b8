#!/usr/bin/env python3
"""A robot for rehearsals: writes the pose of the tool that carries the virtual camera, one JSON line after another.

    ringpose simulate serve scene.yaml --relay lcus --show ring --log frames.jsonl
    python3 simulated_robot.py scene.yaml frames.jsonl

Ring and boards rest in the base; the robot stands where the camera sees them as the view of each frame in the log has
them, from shortly before its exposure to shortly after. It ends when its reader does.
"""

import argparse
import json
import select
import sys
import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ringpose.files.scenes.scene import read_scene
from ringpose.simulate.placement import board_poses, ring_rotation, ring_views


def transform(turn, place_m):
    """4 x 4 matrix of a rotation, given as a matrix or as an axis times an angle, and a place."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(turn).as_matrix() if np.ndim(turn) == 1 else turn
    matrix[:3, 3] = place_m
    return matrix


TOOL_FROM_CAMERA = transform([0.1, -0.15, 1.2], [0.06, -0.02, 0.11])
"""The true mount, which calibrate-mount has to find."""

BASE_FROM_TARGET = {
    "camera-board": transform([3.0, 0.2, 0.1], [0.7, 0.2, 0.05]),
    "plane-board": transform([3.0, -0.1, 0.3], [0.7, -0.3, 0.05]),
    "ring": transform([0.2, -1.4, 0.1], [1.1, 0.3, 0.6]),
}
"""Where the targets rest: the boards' corners, and the ring's centre with z along its normal."""

REPEATABILITY_M, REPEATABILITY_RAD = 5e-5, 1e-4
"""Standard deviation along and about each axis of where the robot stands, about where it says it does: a good one."""

STANDS_S = 0.05
"""Time before and after an exposure in which the robot stands: it covers the errors of stamps."""


def tool_poses(scene):
    """The reported base_from_tool by target and view; the camera itself is off it by the robot's error."""
    seen = {
        ("ring", view.name): transform(ring_rotation(view.normal, view.roll_rad), view.center_m)
        for view in ring_views(scene)
    }
    for target, boards in (("camera-board", scene.camera_boards), ("plane-board", scene.plane_boards)):
        for view in board_poses(scene, boards) if boards else ():
            seen[target, view.name] = transform(view.rotation, view.translation_m)
    random = np.random.default_rng(1)
    poses = {}
    for (target, view), camera_from_target in seen.items():
        stands = BASE_FROM_TARGET[target] @ np.linalg.inv(TOOL_FROM_CAMERA @ camera_from_target)
        error = transform(random.normal(0, REPEATABILITY_RAD, 3), random.normal(0, REPEATABILITY_M, 3))
        poses[target, view] = stands @ error
    return poses


def reader_is_gone():
    """Whether nobody reads standard output any more."""
    poll = select.poll()
    poll.register(sys.stdout, 0)
    return bool(poll.poll(0))


def lines_of(log):
    """The records of a log that grows; those that were there before are read first."""
    rest = ""
    while not reader_is_gone():
        rest += log.read()
        *whole, rest = rest.split("\n")
        yield from map(json.loads, whole)
        time.sleep(0.0 if whole else 0.005)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, help="the scene that is served")
    parser.add_argument("log", type=Path, help="the log of ringpose simulate serve")
    parser.add_argument("--show", choices=BASE_FROM_TARGET, default="ring", help="the target that is shown")
    given = parser.parse_args()
    poses = tool_poses(read_scene(given.scene))
    clock_s = time.time() - time.monotonic()  # the log has the monotonic clock
    last_s = -np.inf
    with given.log.open() as log:
        for frame in lines_of(log):
            pose = poses[given.show, frame["view"]]
            stated = {
                "position_m": pose[:3, 3].tolist(),
                "orientation_xyzw": Rotation.from_matrix(pose[:3, :3]).as_quat().tolist(),
            }
            begin_s = clock_s + frame["began_s"]
            for stamp_s in (begin_s - STANDS_S, begin_s + frame["exposure_s"] + STANDS_S):
                if stamp_s > last_s:
                    last_s = stamp_s
                    print(json.dumps({"stamp_s": stamp_s, "base_from_tool": stated}), flush=True)


if __name__ == "__main__":
    main()
