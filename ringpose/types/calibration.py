"""What a calibration of the light planes found, with what is needed to judge it.

What a camera calibration found, and what there is to judge it by.
"""

import math
from dataclasses import dataclass

import numpy as np

from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.camera import Camera
from ringpose.types.covariance import ParameterCovariance
from ringpose.types.rig import LaserPlanes
from ringpose.types.verdict import Check


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
    max_stripes: int = 0
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraView:
    """One view of the board in a camera calibration."""

    name: str
    pose: BoardPose
    ids: Int64[Array, "corner"]
    """Number of each corner on the board."""
    points_px: Float64[Array, "corner xy=2"]
    """The measured corners."""
    residual_px: Float64[Array, "corner xy=2"]
    """Measured minus projected corners, of those left out too."""
    left_out: Bool[Array, "corner"]
    """Corners that were not used, because they lie too far from where the others say."""
    rejected: str = ""
    """Why the whole view was left out; empty if it was used."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraCalibration:
    """The intrinsic parameters and how well the views determine them."""

    camera: Camera
    """With the covariance of the intrinsic parameters, the poses of the board marginalised out."""
    rms_px: float
    """Of the distances between measured and projected corners that were used."""
    sigma_px: float
    """Standard deviation of one coordinate of a corner, from the residuals and the degrees of freedom."""
    views: tuple[CameraView, ...]

    @property
    def used(self) -> tuple[CameraView, ...]:
        """The views that the parameters were estimated from."""
        return tuple(view for view in self.views if not view.rejected)

    @property
    def standard_deviations(self) -> dict[str, float]:
        """Of the intrinsic parameters, by name; zero for one that was held."""
        covariance = self.camera.covariance
        return {} if covariance is None else covariance.standard_deviations


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Coverage:
    """Where the corners that were used lie, and how the board stood."""

    corners: Int64[Array, "cell_row cell_column"]
    """Number in each cell of the image."""
    bare_regions: tuple[str, ...]
    """Ninths of the image with hardly a corner, in words: `upper left`."""
    tilt_rad: tuple[float, ...]
    """By view: angle between board and image."""
    tilt_spread_rad: tuple[float, float]
    """Standard deviation of the normals over the views, along the direction in which they vary most, and across it."""
    distance_m: tuple[float, ...]
    """By view: of the board's middle."""

    @property
    def share(self) -> float:
        """Cells with corners over all cells."""
        return float((self.corners > 0).mean())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImageMap:
    """Pixels on a regular grid over the image, at which cameras are compared."""

    points_px: Float64[Array, "map_row map_column xy=2"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeftOutView:
    """What the other views say about one that they were calibrated without."""

    name: str
    shift_px: float
    """Displacement of the projection when this view is left out, median over the image."""
    rms_px: float
    """Of this view's corners under the camera of the other views, its pose alone fitted."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CrossValidation:
    """How much the result hangs on which views were taken."""

    split_half_px: Float64[Array, "map_row map_column"]
    """Displacement between the cameras of every other view and of the rest; NaN where a half determines no camera."""
    left_out: tuple[LeftOutView, ...]
    """Empty if there are too few views to leave one out."""
    jackknife_px: Float64[Array, "map_row map_column"]
    """Projection uncertainty times the displacements by leaving out each view, over those that noise would make:
    whatever the errors of a view's corners have in common; NaN without them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelFit:
    """One distortion model on the same views."""

    distortion_model: str
    parameters: int
    rms_px: float
    held_out_rms_px: float
    """Of views that the camera was calibrated without: falls only while more coefficients describe the lens."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ModelComparison:
    """Two distortion models on the same views."""

    fits: tuple[ModelFit, ...]
    difference_px: Float64[Array, "map_row map_column"]
    """Displacement between the two cameras, the camera frame turned so that it is least."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraAssessment:
    """Everything that a camera calibration is judged by."""

    coverage: Coverage
    image_map: ImageMap
    sigma_px: Float64[Array, "map_row map_column"]
    """Projection uncertainty: rms length of the displacement that the covariance allows; NaN where no corner tells of
    the lens."""
    validation: CrossValidation
    disagreement: float
    """Projection uncertainty from leaving out views over that from the corners' noise, medians over the image: 1 where
    noise explains the differences of the views; NaN if there are too few views."""
    distances_m: tuple[float, ...]
    """At which the projection uncertainty is given in metres."""
    comparison: ModelComparison | None = None
    board: tuple[Check, ...] = ()
    """What the images say against one another and the sizes in the board file."""

    @property
    def known_sigma_px(self) -> Float64[Array, "map_point"]:
        """The projection uncertainty where it is known."""
        known: Float64[Array, "map_point"] = self.sigma_px[~np.isnan(self.sigma_px)]
        return known

    @property
    def unknown_share(self) -> float:
        """Of the image in which the projection uncertainty is not known."""
        return 1.0 - self.known_sigma_px.size / self.sigma_px.size
