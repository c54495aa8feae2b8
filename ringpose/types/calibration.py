"""What a calibration of the light planes found, with what is needed to judge it."""

import math
from dataclasses import dataclass

import numpy as np

from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.camera import Camera
from ringpose.types.covariance import ParameterCovariance
from ringpose.types.laser_planes import LaserPlanes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StripeView:
    """One view of a board with the stripes that the lasers draw on it."""

    board: BoardView
    stripes_px: tuple[Float64[Array, "_ xy=2"], ...]
    """Stripe centres on the board's plane, by laser; empty for a laser that is not seen or not told apart."""
    unlabelled_px: tuple[Float64[Array, "_ xy=2"], ...] = ()
    """Stripes whose lasers were on together, in their order down the image (to the right, if they stand upright)."""
    remarks: tuple[str, ...] = ()
    """What is missing, and why."""
    lit: frozenset[int] = frozenset()
    """Lasers that were on in a frame, as the shot's masks have it."""
    most_stripes: int = 0
    """The most stripes on the board that a frame shows."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaserView:
    """What one view of the board says about one laser."""

    name: str
    points: Float64[Array, "n xyz=3"]
    """Stripe centres on the board, triangulated with the board's plane, in the camera frame."""
    residual_m: Float64[Array, "n"]
    """The points' distances from the light plane, measured normal to it."""
    held_out_m: Float64[Array, "n"]
    """Distances from the light plane of the other views alone, the board where its corners have it; NaN where those
    views determine no plane."""

    @property
    def rms_m(self) -> float:
        """Of the residuals."""
        return float(np.sqrt(np.mean(self.residual_m**2)))

    @property
    def held_out_rms_m(self) -> float:
        """Of the held-out distances; NaN if they are not known."""
        return float(np.sqrt(np.mean(self.held_out_m**2)))

    @property
    def distance_m(self) -> float:
        """Mean depth of the points."""
        return float(self.points[:, 2].mean())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaserCalibration:
    """One light plane `normal . point = distance_m`, and what each view says about it."""

    name: str
    normal: Float64[Array, "xyz=3"]
    distance_m: float
    views: tuple[LaserView, ...]
    rms_m: float
    held_out_rms_m: float
    """Over all points, each against the light plane of the other views; NaN if no view can be left out."""
    condition: float
    """Extent of the points along their longest direction over that across it, in the light plane."""
    disagreement: float = math.nan
    """By how much the laser's stripes disagree with the boards and the other lasers: squares over their number, 1 where
    chance explains it; NaN where two views alone leave nothing to judge by, or the method does not tell."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanesCalibration:
    """The light planes and how well the views determine them."""

    camera: Camera
    """As it was given, or as stripes and boards have improved it."""
    planes: LaserPlanes
    covariance: ParameterCovariance | None
    """Joint, over camera and light planes; None where the method has no honest one."""
    method: str
    lasers: tuple[LaserCalibration, ...]
    poses: tuple[BoardPose, ...]
    remarks: tuple[tuple[str, str], ...] = ()
    """What was left out or is missing: the view's name, and why."""
    contradicting: tuple[tuple[str, str], ...] = ()
    """Shots that were left out because they contradict the others, and how: lasers exchanged, images turned."""
    excess: float = 1.0
    """Factor by which variances of corners and stripes were widened, because the views disagree by more."""
