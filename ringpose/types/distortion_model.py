"""The names of the distortion models, which the command line needs before anything heavy is imported."""

from enum import StrEnum


class DistortionModel(StrEnum):
    """How the lens bends rays, under its name in ROS."""

    PLUMB_BOB = "plumb_bob"
    RATIONAL_POLYNOMIAL = "rational_polynomial"
