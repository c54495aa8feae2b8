"""Choices of command-line options, in a module without heavy imports."""

from enum import StrEnum

STDIN = "-"
"""Standard input, in place of the name of a file."""


class DistortionModel(StrEnum):
    """Distortion model, by its ROS name."""

    PLUMB_BOB = "plumb_bob"
    RATIONAL_POLYNOMIAL = "rational_polynomial"


class PoseFrame(StrEnum):
    """Frame in which a pose is expressed."""

    CAMERA = "camera"
    TOOL = "tool"
    BASE = "base"
    """That of the robot which carries the camera, or beside which it stands."""


class SegmentMethod(StrEnum):
    """How line segments are made from edge chains."""

    LENGTH = "length"
    """The paper's method: chords from the first to the last pixel of straight pieces."""
    REFINED = "refined"
    """Sub-pixel least-squares lines through straight pieces; collinear ones are joined."""


class StripeSource(StrEnum):
    """Features from which the stripes are extracted."""

    CENTERS = "centers"
    """Ridges, column by column: more accurate, the default."""
    SEGMENTS = "segments"
    """Pairs of line segments along both edges of each stripe: the paper's method."""


class Method(StrEnum):
    """Method of pose estimation."""

    ML = "ml"
    PAPER = "paper"
    PAPER_CONSTRAINED = "paper-constrained"
    PAPER_DETECTOR = "paper-detector"
    """The paper's closed form from the pixel ends of its line detector, instead of from measured break points."""


class Minimized(StrEnum):
    """The quantity by which `bench design` chooses the best rig."""

    CENTER = "center"
    NORMAL = "normal"
    GRASP = "grasp"
    RADIUS = "radius"
    CENTER_KNOWN = "center-known"
    """The centre with known radii."""


class PlanesMethod(StrEnum):
    """Method of estimating board poses and light planes."""

    JOINT = "joint"
    """Joint robust estimation of board poses and light planes, from weighted corners and stripes."""
    TOTAL_LEAST_SQUARES = "total-least-squares"
    """Board pose from all corners; robust total-least-squares plane through the points."""
    PAPER = "paper"
    """Mean of the poses of the single markers; S . P = 1 by least squares."""


class CameraFormat(StrEnum):
    """File format of a camera, by the program that reads it."""

    RINGPOSE = "ringpose"
    ROS = "ros"
    OPENCV = "opencv"
    KALIBR = "kalibr"
    MATLAB = "matlab"


class Relay(StrEnum):
    """Protocol of the relay board."""

    LCUS = "lcus"
    NUMATO = "numato"
    MODBUS = "modbus"
    ASCII = "ascii"
    NONE = "none"
    """The lasers are switched by the camera's output lines."""


class ServedTarget(StrEnum):
    """Target in front of the simulated camera."""

    RING = "ring"
    CAMERA_BOARD = "camera-board"
    PLANE_BOARD = "plane-board"


class AdvancePolicy(StrEnum):
    """When the simulated camera advances to the next view."""

    PAUSE = "pause"
    """In a pause between frames."""
    TIME = "time"
    """After a given time."""
    NEVER = "never"


class Clock(StrEnum):
    """Clock of served frames."""

    WALL = "wall"
    """The time of day; frames that cannot be rendered in time are dropped."""
    LOCKSTEP = "lockstep"
    """Simulated time, which advances only while every client awaits a frame."""
