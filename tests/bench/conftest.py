"""A ring that faces the camera at 1 m, and estimates about it."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ringpose.bench import score
from ringpose.bench.score import PoseEstimate
from ringpose.types.pose import PoseFlag, PoseLine, RingPose
from ringpose.types.rig import Camera
from ringpose.types.scene import Truth

CENTER_M = np.array([0.1, -0.2, 1.0])
NO_FLAG = PoseFlag(0)
NORMAL = np.array([0.0, 0.0, -1.0])
ANGLES_RAD = np.array([-0.2, 0.0, 0.3])
"""Where the three stripes cross the ring, from the x axis."""


@pytest.fixture
def camera() -> Camera:
    matrix = np.array([[1000.0, 0.0, 800.0], [0.0, 1000.0, 600.0], [0.0, 0.0, 1.0]])
    return Camera(
        camera_name="plain",
        image_width=1600,
        image_height=1200,
        camera_matrix=matrix,
        distortion_model="plumb_bob",
        distortion_coefficients=np.zeros(5),
    )


@pytest.fixture
def on_ring() -> Callable[[float, float], Any]:
    """The point of the ring's plane at an angle from the x axis and a radius."""

    def point(angle_rad: float, radius_m: float) -> Any:
        return CENTER_M + radius_m * np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0])

    return point


@pytest.fixture
def truth_of(on_ring: Callable[[float, float], Any]) -> Callable[..., Truth]:
    def truth(**changes: Any) -> Truth:
        pixels = [
            [1000 * point[:2] / point[2] + [800, 600] for point in (on_ring(angle, 0.4), on_ring(angle, 0.5))]
            for angle in ANGLES_RAD
        ]
        radii = {"radius_inner_m": 0.4, "radius_outer_m": 0.5}
        values: dict[str, Any] = {"center_m": CENTER_M, "normal": NORMAL, "break_points_px": np.array(pixels)}
        return Truth(**({"shot": "a", "expect": "pose"} | radii | values | changes))

    return truth


@pytest.fixture
def pose_of(on_ring: Callable[[float, float], Any]) -> Callable[..., RingPose]:
    """The true pose, but for the changes."""

    def pose(**changes: Any) -> RingPose:
        radii = {"radius_inner_m": 0.4, "radius_outer_m": 0.5}
        values: dict[str, Any] = {"center_m": CENTER_M, "normal": NORMAL, "grasp_m": on_ring(0.0, 0.45)}
        fit = {"method": "paper", "condition_number": 1.0, "residual_rms_px": 0.0}
        return RingPose(**(fit | radii | values | changes))

    return pose


@pytest.fixture
def estimate_of(pose_of: Callable[..., RingPose]) -> Callable[..., PoseEstimate]:
    """The true estimate, but for changes of the pose and of its line."""

    def estimate(
        shot: str = "a", method: str = "paper", flags: PoseFlag = NO_FLAG, line: Any = None, **changes: Any
    ) -> PoseEstimate:
        pose = pose_of(method=method, flags=flags, **changes)
        values = {"stamp_s": math.nan} | (line or {})
        return score.estimate_of(PoseLine(shot=shot, pose=pose, flags=flags, **values), "x")

    return estimate
