"""The names of the frames, which the command line needs before anything heavy is imported."""

from enum import StrEnum


class PoseFrame(StrEnum):
    """The frame of a pose's vectors."""

    CAMERA = "camera"
    TOOL = "tool"
