"""A camera that a robot carries in a steady motion, and rings as it sees them; mount and clock may have errors."""

from dataclasses import replace

import cv2
import numpy as np
from moving_rings import START_S, Motion
from ring_scenes import Ring

from ringpose.geometry.camera_motion import CameraMotion
from ringpose.types.rig import Mount, RobotPoses

TOOL_FROM_CAMERA = np.array([[0.0, -1, 0, 0.1], [1, 0, 0, 0.05], [0, 0, 1, -0.1], [0, 0, 0, 1]])
RATE = np.array([0.02, -0.03, 0.04])
VELOCITY_M_S = np.array([0.01, 0.02, -0.01])


def base_from_tool(time_s: float) -> np.ndarray:
    """A tool that turns and moves steadily."""
    matrix = np.eye(4)
    matrix[:3, :3] = cv2.Rodrigues(RATE * time_s)[0] @ cv2.Rodrigues(np.array([0.3, 0.2, -0.4]))[0]
    matrix[:3, 3] = [1.0, 0.5, 0.8] + VELOCITY_M_S * time_s
    return matrix


def robot(
    duration_s: float,
    mount_sd=(0.0, 0.0),
    delay_sd_s: float = 0.0,
    offset_s: float = 0.0,
    robot_sd=(0.0, 0.0),
    error=None,
) -> CameraMotion:
    """What is known of the camera: the robot's poses, ten a second, and the mount with its standard deviations.

    `robot_sd`: those of the robot's poses, and `error` (4 x 4) the one that all of them have, in the tool frame.
    """
    times_s = np.arange(-0.5, duration_s, 0.1)
    matrices = np.array([base_from_tool(t) for t in times_s])
    if error is not None:
        matrices = matrices @ np.linalg.inv(error)
    poses = RobotPoses(stamp_s=START_S + times_s, position_m=matrices[:, :3, 3], rotation=matrices[:, :3, :3])
    root = np.diag([mount_sd[0]] * 3 + [mount_sd[1]] * 3)
    mount = Mount(carrier_from_camera=TOOL_FROM_CAMERA, root=root, delay_s=offset_s, delay_sd_s=delay_sd_s)
    mount = replace(mount, robot_rotation_sd_rad=robot_sd[0], robot_translation_sd_m=robot_sd[1])
    return CameraMotion(poses=poses, mount=mount)


def random_error(rng, sd) -> np.ndarray:
    """A rigid transform near the identity, whose rotation vector and translation have these standard deviations."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = cv2.Rodrigues(sd[0] * rng.normal(size=3))[0], sd[1] * rng.normal(size=3)
    return matrix


class SeenByRobot:
    """A motion in the base frame, as the moving camera sees it.

    `turn_rad` and `shift_m` are errors of the mount in the tool frame, `delay_s` is how far the robot's clock is ahead.
    """

    def __init__(self, motion: Motion, turn_rad=(0.0, 0.0, 0.0), shift_m=(0.0, 0.0, 0.0), delay_s: float = 0.0) -> None:
        self.motion, self.delay_s = motion, delay_s
        self.tool_from_camera = TOOL_FROM_CAMERA.copy()
        self.tool_from_camera[:3, :3] = cv2.Rodrigues(np.array(turn_rad, float))[0] @ TOOL_FROM_CAMERA[:3, :3]
        self.tool_from_camera[:3, 3] += shift_m

    def at(self, time_s: float) -> Ring:
        camera_from_base = np.linalg.inv(base_from_tool(time_s + self.delay_s) @ self.tool_from_camera)
        return self.motion.at(time_s).moved_by(camera_from_base)


def in_base(seen: Motion) -> Motion:
    """A motion that the camera sees at the start, in the base frame."""
    matrix = base_from_tool(0.0) @ TOOL_FROM_CAMERA
    turned, ring = matrix[:3, :3], seen.ring.moved_by(matrix)
    return Motion(ring=ring, velocity_m_s=turned @ seen.velocity_m_s, rate_rad_s=turned @ seen.rate_rad_s)
