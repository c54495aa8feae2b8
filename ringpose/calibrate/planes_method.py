"""The names of the methods, which the command line needs before anything heavy is imported."""

from enum import StrEnum


class PlanesMethod(StrEnum):
    """How board poses and light planes are estimated."""

    JOINT = "joint"
    """Board poses and light planes together, from corners and stripes, each weighed by its errors; robust."""
    TOTAL_LEAST_SQUARES = "total-least-squares"
    """One pose over all corners of a board; the plane nearest to the points, robust."""
    PAPER = "paper"
    """The mean of the poses of the single markers; S . P = 1 by least squares."""
