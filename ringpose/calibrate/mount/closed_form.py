"""A mount in closed form: the start of the adjustment (Park and Martin, IEEE Trans. Robotics and Automation 10, 1994).

With G_i the transform of the robot (`moving_from_fixed`) and T_i the board in the camera, G_i^-1 X T_i = Y is the same
for all views. A pair of views gives the rotations R_G = G_j G_i^-1 and R_T = T_j T_i^-1, with R_G R_X = R_X R_T: their
rotation vectors g and t are the same vector in two frames, g = R_X t. The translation then is linear.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from ringpose.geometry.rotations import rotation_vectors
from ringpose.types.arrays import Array, Float64

MIN_TURN_RAD = np.radians(5.0)
"""Rotation between two views from which it contributes."""

MAX_SCALE_ERROR = 0.1
"""Relative error of the scale up to which it can name a unit: the factors between units differ by 1.2 or more."""

MIN_ACROSS_RAD = np.radians(5.0)
"""Rotation about a second axis that a set of views must have."""


class Transform(NamedTuple):
    """A rigid transform, or several."""

    rotation: Float64[Array, "*shape 3 3"]
    translation_m: Float64[Array, "*shape xyz=3"]

    def inverse(self) -> "Transform":
        """The transform back."""
        back = self.rotation.swapaxes(-1, -2)
        return Transform(back, -(back @ self.translation_m[..., None])[..., 0])

    def after(self, first: "Transform") -> "Transform":
        """The first transform followed by this one."""
        return Transform(self.rotation @ first.rotation, self.rotation @ first.translation_m + self.translation_m)

    @property
    def matrix(self) -> Float64[Array, "4 4"]:
        """As a matrix of homogeneous coordinates."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.translation_m
        return matrix


def moving_from_fixed(base_from_tool: Transform, eye_to_hand: bool) -> Transform:
    """G of T = X^-1 G Y: tool_from_base, or base_from_tool of a camera that is fixed."""
    return base_from_tool if eye_to_hand else base_from_tool.inverse()


class Turns(NamedTuple):
    """Rotation vectors between pairs of views, in the frames of robot and camera."""

    robot_rad: Float64[Array, "pair 3"]
    camera_rad: Float64[Array, "pair 3"]

    @property
    def spread_rad(self) -> Float64[Array, "3"]:
        """Largest rotation between two views, largest across its axis, and across both, from the camera's poses."""
        spread: Float64[Array, "3"] = np.abs(self.camera_rad @ _main_axes(self.camera_rad)).max(axis=0)
        return spread

    @property
    def main_axis(self) -> Float64[Array, "3"]:
        """Axis of the robot's frame about which the views are turned most."""
        return _main_axes(self.robot_rad)[:, 0]


def _main_axes(vectors: Float64[Array, "pair 3"]) -> Float64[Array, "xyz=3 axis=3"]:
    """Orthogonal directions, first that of the largest sum of squares."""
    return np.linalg.eigh(vectors.T @ vectors)[1][:, ::-1]


def turns_between(robot: Sequence[Transform], board: Sequence[Transform]) -> Turns:
    """Rotations between all pairs of views."""
    first, second = np.triu_indices(len(robot), 1)
    several = (np.array([pose.rotation for pose in poses]).reshape(-1, 3, 3) for poses in (robot, board))
    return Turns(*(rotation_vectors(each[second] @ each[first].swapaxes(1, 2)) for each in several))


def closed_form_mount(
    robot: Sequence[Transform], board: Sequence[Transform], turns: Turns
) -> tuple[Transform, Transform, float]:
    """X (camera in the moving or fixed frame), Y (board in the other one), and the scale of the robot's positions.

    The scale is 1 if robot and board are in the same unit, and NaN if its error may exceed `MAX_SCALE_ERROR`; X and Y
    are computed with the scale 1.
    """
    rotation = best_rotation(turns)
    rows, right, positions = [], [], []
    for i, j in combinations(range(len(robot)), 2):
        relative = robot[j].after(robot[i].inverse())
        board_turn = board[j].rotation @ board[i].rotation.T
        shift = board[j].translation_m - board_turn @ board[i].translation_m
        # R_G t_X + s t_G = R_X t_T + t_X
        rows.append(relative.rotation - np.eye(3))
        right.append(rotation @ shift)
        positions.append(relative.translation_m)
    matrix, known, moved = np.concatenate(rows), np.concatenate(right), np.concatenate(positions)
    translation_m = _robust_solution(matrix, known - moved)
    scaled = np.column_stack([matrix, moved])
    solution = _robust_solution(scaled, known)
    # a tool that turns about one point, which the camera sees in one place, moves as another mount explains
    across_m = np.linalg.norm(moved - matrix @ np.linalg.lstsq(matrix, moved)[0])
    errors_m = np.linalg.norm((known - scaled @ solution).reshape(-1, 3), axis=1)
    error_m = float(np.median(errors_m)) * np.sqrt(len(errors_m))  # a few poses may be wrong
    scale = float(solution[3]) if error_m < MAX_SCALE_ERROR * abs(solution[3]) * across_m else float("nan")
    mount = Transform(rotation, translation_m)
    return mount, _mean([g.inverse().after(mount).after(t) for g, t in zip(robot, board, strict=True)]), scale


def best_rotation(turns: Turns) -> Float64[Array, "3 3"]:
    """The rotation that maps the camera's rotation vectors onto the robot's, insensitive to a few wrong ones.

    Two vectors that are parallel leave the turn about them open; the third axis follows from their cross product.
    """
    weight = np.ones(len(turns.robot_rad))
    rotation = np.eye(3)
    for _ in range(10):
        left, _, right = np.linalg.svd((turns.robot_rad * weight[:, None]).T @ turns.camera_rad)
        rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        error = np.linalg.norm(turns.robot_rad - turns.camera_rad @ rotation.T, axis=1)
        weight = 1.0 / np.maximum(error, max(float(np.median(error)), 1e-9))
    return rotation


def _robust_solution(matrix: Float64[Array, "row column"], right: Float64[Array, "row"]) -> Float64[Array, "column"]:
    """Solution of linear equations, three rows a pair, with the least sum of the pairs' errors."""
    weight = np.ones(len(right))
    for _ in range(10):
        root = np.sqrt(weight)
        solution: Float64[Array, "column"] = np.linalg.lstsq(root[:, None] * matrix, root * right)[0]
        error = np.linalg.norm((right - matrix @ solution).reshape(-1, 3), axis=1)
        weight = np.repeat(1.0 / np.maximum(error, max(float(np.median(error)), 1e-9)), 3)
    return solution


def _mean(transforms: Sequence[Transform]) -> Transform:
    """The median position, and the rotation nearest to all."""
    left, _, right = np.linalg.svd(np.sum([one.rotation for one in transforms], axis=0))
    rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return Transform(rotation, np.median([one.translation_m for one in transforms], axis=0))
