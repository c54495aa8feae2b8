"""Stripe centres triangulated with a board's plane (ringpose-method(7), section 6)."""

import numpy as np

from ringpose.geometry.rays import intersect, rays
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose
from ringpose.types.camera import Camera


def triangulated(points_px: Float64[Array, "n xy=2"], pose: BoardPose, camera: Camera) -> Float64[Array, "n xyz=3"]:
    """Points on the board, in the camera frame, that distorted pixels see."""
    return on_board(rays(points_px, camera), pose)


def on_board(directions: Float64[Array, "n xyz=3"], pose: BoardPose) -> Float64[Array, "n xyz=3"]:
    """P = t r with t = (n_b . c_b) / (n_b . r): where rays meet the board."""
    normal = pose.rotation[:, 2]
    return intersect(directions, normal, np.array(float(normal @ pose.translation_m)))
