"""A robot that moves while its camera sees a board: its motion, its poses and the images by formulas of their own."""

from typing import NamedTuple

import cv2
import numpy as np
from known_views import CHESSBOARD, TRUE_CAMERA
from scipy.spatial.transform import Rotation

from ringpose.geometry.board import corner_points
from ringpose.types.board import BoardView

CORNERS_M = corner_points(CHESSBOARD)[::5].copy()
MIDDLE_M = np.array([0.15, 0.125, 0.0])
START_S = 1764378000.0


class Seen(NamedTuple):
    """What camera and robot record, and the truth."""

    mount: np.ndarray
    views: list[BoardView]
    stamps_s: list[float]
    """Of the camera's clock."""
    robot_s: np.ndarray
    """Of the robot's clock, which shows more by `delay_s`."""
    poses: np.ndarray
    """base_from_tool as the robot reports it."""
    delay_s: float


def matrix(vector, place_m) -> np.ndarray:
    """One, or one for each row."""
    made = np.zeros((*np.shape(vector)[:-1], 4, 4))
    made[..., :3, :3], made[..., :3, 3] = Rotation.from_rotvec(vector).as_matrix(), place_m
    made[..., 3, 3] = 1.0
    return made


def waves(rng, size, period_s):
    """Sums of three sines of unit variance about each axis, as functions of times."""
    rate = 2 * np.pi / (period_s * rng.uniform(0.7, 1.4, (3, size)))
    phase, part = rng.uniform(0, 2 * np.pi, (3, size)), rng.dirichlet(np.ones(3) * 3, size).T
    return lambda times_s: (np.sqrt(2 * part) * np.sin(rate * times_s[:, None, None] + phase)).sum(axis=1)


def seen_by_a_moving_robot(
    rng, *, views=10, delay_s=0.05, rate_hz=100.0, robot=(3.5e-4, 1e-4), noise_px=0.1, eye_to_hand=False,
    period_s=4.0, every_s=1.7, still=False,
) -> Seen:  # fmt: skip
    """Views every `every_s`, while the board turns and moves before the camera with about this period.

    Each pose of the robot has an error that changes over a fifth of a second; `still`: the robot halts at each view.
    """
    mount = matrix(rng.normal(0, 1, 3), rng.normal(0, 0.05, 3))
    board = matrix(rng.normal(0, 1, 3), rng.normal(0, 0.5, 3))
    turn, shift = waves(rng, 3, period_s), waves(rng, 3, period_s)

    def board_in_camera(times_s):
        if still:  # to and fro between whole multiples of every_s, at rest a third of the time at each of them
            number = np.round(times_s / every_s)
            share = np.clip(3.0 * (times_s / every_s - number), -1, 1)
            times_s = every_s * (number + np.sign(share) * 0.5 * np.maximum(np.abs(share) - 0.4, 0.0) / 0.6)
        turned = turn(times_s) * [0.25, 0.25, 0.4]
        middle_m = np.array([0, 0, 0.5]) + shift(times_s) * [0.015, 0.015, 0.05]
        return matrix(turned, middle_m - Rotation.from_rotvec(turned).apply(MIDDLE_M))

    def base_from_tool(times_s):
        moving = mount @ board_in_camera(times_s) @ np.linalg.inv(board)
        return moving if eye_to_hand else np.linalg.inv(moving)

    times_s = every_s * (1.0 + np.arange(views))
    sampled_s = np.arange(0.0, times_s[-1] + every_s, 1 / rate_hz) + rng.uniform(0, 1 / rate_hz)
    # an error that is drawn every 0.2 s, and a smooth curve between
    knots_s = np.arange(-1.0, sampled_s[-1] + 2.0, 0.2)
    drawn = rng.normal(0, 1, (len(knots_s), 6)) * np.repeat(robot, 3)
    nearness = np.exp(-0.5 * ((sampled_s[:, None] - knots_s) / 0.1) ** 2)
    errors = nearness @ drawn / np.linalg.norm(nearness, axis=1)[:, None]
    reported = base_from_tool(sampled_s) @ matrix(errors[:, :3], errors[:, 3:])
    made = []
    for number, pose in enumerate(board_in_camera(times_s)):
        pixels = cv2.projectPoints(
            CORNERS_M, cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3], TRUE_CAMERA.camera_matrix,
            TRUE_CAMERA.distortion_coefficients,
        )[0][:, 0]  # fmt: skip
        pixels = pixels + rng.normal(0, noise_px, pixels.shape)
        made.append(
            BoardView(name=f"view{number:02d}", ids=np.arange(len(pixels)), points_board_m=CORNERS_M, points_px=pixels)
        )
    stamps_s = (START_S + times_s).tolist()
    return Seen(mount, made, stamps_s, START_S + sampled_s + delay_s, reported, delay_s)
