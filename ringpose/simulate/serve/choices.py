"""The names of what is served, which the command line needs before anything heavy is imported."""

from enum import StrEnum


class Relay(StrEnum):
    """The relay board."""

    LCUS = "lcus"
    NUMATO = "numato"
    MODBUS = "modbus"
    ASCII = "ascii"
    NONE = "none"
    """Leaves the lasers to the camera's output lines."""


class Show(StrEnum):
    """What stands before the camera."""

    RING = "ring"
    CAMERA_BOARD = "camera-board"
    PLANE_BOARD = "plane-board"


class Move(StrEnum):
    """When the next view comes."""

    PAUSE = "pause"
    """In a pause between the frames."""
    TIME = "time"
    """After a time."""
    NEVER = "never"
