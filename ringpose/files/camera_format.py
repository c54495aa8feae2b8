"""The formats in which cameras are written."""

from enum import StrEnum


class CameraFormat(StrEnum):
    """A format, by the program that reads it."""

    RINGPOSE = "ringpose"
    ROS = "ros"
    OPENCV = "opencv"
    KALIBR = "kalibr"
    MATLAB = "matlab"
