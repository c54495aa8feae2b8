"""The choices that options of several commands offer, by name; importing them costs nothing."""

from enum import StrEnum


class DistortionModel(StrEnum):
    """How the lens bends rays, under its name in ROS."""

    PLUMB_BOB = "plumb_bob"
    RATIONAL_POLYNOMIAL = "rational_polynomial"


class PoseFrame(StrEnum):
    """The frame of a pose's vectors."""

    CAMERA = "camera"
    TOOL = "tool"


class SegmentMethod(StrEnum):
    """The methods by the names under which they are chosen."""

    LENGTH = "length"
    """The paper's: chords from the first to the last pixel of straight pieces."""
    REFINED = "refined"
    """Sub-pixel least-squares lines of straight pieces, those joined that continue one another."""


class StripeSource(StrEnum):
    """What the stripes' pieces are made from."""

    CENTERS = "centers"
    """Ridges, column by column: finer, and what is used unless the paper's way is asked for."""
    SEGMENTS = "segments"
    """The paper's line segments along both edges of each stripe."""


class Method(StrEnum):
    """How the pose is computed."""

    ML = "ml"
    PAPER = "paper"
    PAPER_CONSTRAINED = "paper-constrained"


class PlanesMethod(StrEnum):
    """How board poses and light planes are estimated."""

    JOINT = "joint"
    """Board poses and light planes together, from corners and stripes, each weighed by its errors; robust."""
    TOTAL_LEAST_SQUARES = "total-least-squares"
    """One pose over all corners of a board; the plane nearest to the points, robust."""
    PAPER = "paper"
    """The mean of the poses of the single markers; S . P = 1 by least squares."""


class CameraFormat(StrEnum):
    """A format, by the program that reads it."""

    RINGPOSE = "ringpose"
    ROS = "ros"
    OPENCV = "opencv"
    KALIBR = "kalibr"
    MATLAB = "matlab"


class Relay(StrEnum):
    """The relay board."""

    LCUS = "lcus"
    NUMATO = "numato"
    MODBUS = "modbus"
    ASCII = "ascii"
    NONE = "none"
    """Leaves the lasers to the camera's output lines."""


class ServedTarget(StrEnum):
    """What stands before the camera."""

    RING = "ring"
    CAMERA_BOARD = "camera-board"
    PLANE_BOARD = "plane-board"


class AdvancePolicy(StrEnum):
    """When the next view comes."""

    PAUSE = "pause"
    """In a pause between the frames."""
    TIME = "time"
    """After a time."""
    NEVER = "never"
