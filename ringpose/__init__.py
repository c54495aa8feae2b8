"""Pose of a satellite's launch-adapter ring from one camera and line lasers.

What `ringpose.api` has for notebooks is found here, too; it is imported when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ringpose.api import *  # noqa: F403

__all__ = [  # noqa: F405
    "PLUMB_BOB",
    "AssumptionOptions",
    "Board",
    "Camera",
    "CameraAssessment",
    "CameraModel",
    "Detection",
    "KnownRadii",
    "Measured",
    "PlanesAssessment",
    "PlanesMethod",
    "PoseLine",
    "Prior",
    "Rig",
    "Ring",
    "RingposeError",
    "Scene",
    "Setup",
    "Shot",
    "Stream",
    "TrackLine",
    "TrackOptions",
    "Tracker",
    "Truth",
    "calibrate_camera",
    "calibrate_planes",
    "detect_ring",
    "measure_ring",
    "read_board",
    "read_camera",
    "read_pose_lines",
    "read_rig",
    "read_scene",
    "read_shot",
    "record_of",
    "simulate_shots",
]


def __getattr__(name: str) -> Any:
    """A function or class of `ringpose.api`."""
    if name in __all__:
        return getattr(import_module("ringpose.api"), name)
    raise AttributeError(f"module 'ringpose' has no attribute {name!r}")


def __dir__() -> list[str]:
    """The names, for completion."""
    return sorted(__all__)
