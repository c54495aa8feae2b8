"""Results of the calibrations of camera and light planes, with the quantities and limits by which they are assessed."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.detection import SubtractedGhost
from ringpose.types.rig import Camera, LaserBow, LaserGhost, LaserPlanes, ParameterCovariance


class Grade(StrEnum):
    """Grade of a result; the value is the word for the user."""

    GOOD = "good"
    IMPROVABLE = "can be improved"
    REDO = "redo"


_FROM_GOOD_TO_BAD = tuple(Grade)


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One quantity and its limits; the order of the limits determines whether a larger value is better or worse."""

    name: str
    """Name of the quantity as in files, with its unit: `rms_px`."""
    value: float
    """NaN if not known, which is graded as improvable."""
    pass_limit: float
    """Good up to this value (or from this value, if it is the larger of the two limits)."""
    fail_limit: float
    """Failed beyond this value; infinite if this quantity alone never fails a result."""
    advice: str = ""
    """Advice on how to improve the value; may be empty."""
    place: str = ""
    """What the quantity refers to, such as a laser's name; empty for the whole result."""

    @property
    def grade(self) -> Grade:
        """The grade of this quantity alone."""
        if math.isnan(self.value):
            return Grade.IMPROVABLE
        sign = 1.0 if self.fail_limit >= self.pass_limit else -1.0
        if sign * self.value <= sign * self.pass_limit:
            return Grade.GOOD
        return Grade.REDO if sign * self.value > sign * self.fail_limit else Grade.IMPROVABLE

    @property
    def way_to_redo(self) -> float:
        """Share of the way from the good limit to that of `redo`: 0 where no value is that bad, 1/2 if not known."""
        if math.isnan(self.value):
            return 0.5
        way = self.fail_limit - self.pass_limit
        return (self.value - self.pass_limit) / way if math.isfinite(way) else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The checks of a result; the worst grade of the checks is the grade of the result."""

    findings: tuple[Check, ...]

    @property
    def grade(self) -> Grade:
        """The worst grade of the checks."""
        return max((finding.grade for finding in self.findings), key=_FROM_GOOD_TO_BAD.index, default=Grade.GOOD)

    @property
    def poor(self) -> tuple[Check, ...]:
        """The checks that are not good, those nearest to `redo` or farthest beyond it first."""
        poor = [finding for finding in self.findings if finding.grade is not Grade.GOOD]
        return tuple(sorted(poor, key=lambda finding: -finding.way_to_redo))

    @property
    def advice(self) -> tuple[str, ...]:
        """Advice of the checks that are not good, in the order of `poor`, without repetitions."""
        return tuple(dict.fromkeys(finding.advice for finding in self.poor if finding.advice))


def _rms(values: Float64[Array, "n"]) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StripeView:
    """One view of a board with the laser stripes on it."""

    board: BoardView
    stripes_px: tuple[Float64[Array, "_ xy=2"], ...]
    """Stripe centres on the board's plane, by laser; empty for a laser that is not visible or not identified."""
    unlabelled_px: tuple[Float64[Array, "_ xy=2"], ...] = ()
    """Stripes whose lasers were on together, ordered from top to bottom (from left to right if they are vertical)."""
    remarks: tuple[str, ...] = ()
    """Missing data, and the reasons."""
    lit: frozenset[int] = frozenset()
    """Lasers that were on in a frame, according to the shot's masks."""
    max_stripes: int = 0
    """Largest number of stripes on the board in a frame."""
    ghosts: tuple[tuple[int, SubtractedGhost], ...] = ()
    """By laser, the ghosts of the frames in which it was on."""
    print_m: tuple[float, float] | None = None
    """Width and height of the print that the board's frame starts at; None if all stripes are known to be on it."""

    def beside_print(self, points: Float64[Array, "n xyz=3"], pose: BoardPose) -> Bool[Array, "n"]:
        """Which points of the board's plane, in the camera frame, lie on the sheet beside the print."""
        if self.print_m is None:
            return np.zeros(len(points), dtype=bool)
        position_m = ((points - pose.translation_m) @ pose.rotation)[:, :2]
        return np.any((position_m < 0) | (position_m > self.print_m), axis=1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaserView:
    """The observation of one laser in one view of the board."""

    name: str
    points: Float64[Array, "n xyz=3"]
    """Stripe centres on the board, triangulated with the board's plane, in the camera frame."""
    residual_m: Float64[Array, "n"]
    """Distances of the points from the light plane, along its normal."""
    held_out_m: Float64[Array, "n"]
    """Distances from the light plane estimated without this view, with the board's pose from its corners; NaN where the
    other views do not determine a plane."""

    @property
    def rms_m(self) -> float:
        """Root mean square of the residuals."""
        return _rms(self.residual_m)

    @property
    def held_out_rms_m(self) -> float:
        """Root mean square of the held-out distances; NaN if these are not known."""
        return _rms(self.held_out_m)

    @property
    def distance_m(self) -> float:
        """Mean depth of the points."""
        return float(self.points[:, 2].mean())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaserCalibration:
    """One light plane `normal . point = distance_m`, and the stripe points that it was fitted to, by board view."""

    name: str
    normal: Float64[Array, "xyz=3"]
    distance_m: float
    views: tuple[LaserView, ...]
    condition: float
    """Ratio of the points' extents along and across their longest direction, in the light plane."""
    disagreement: float = math.nan
    """Chi-square per degree of freedom of the laser's stripes against the boards and the other lasers, with expectation
    1; NaN for two views, which have no redundancy, and for methods that do not provide it."""

    @property
    def rms_m(self) -> float:
        """Root mean square of the residuals of all points."""
        return _rms(np.concatenate([view.residual_m for view in self.views]))

    @property
    def held_out_rms_m(self) -> float:
        """Root mean square of the held-out distances of all points that have one; NaN if there are none."""
        held_out_m = np.concatenate([view.held_out_m for view in self.views])
        return _rms(held_out_m[np.isfinite(held_out_m)])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanesCalibration:
    """The light planes and their uncertainty."""

    camera: Camera
    """The given camera, or the camera refined by the stripes and boards."""
    planes: LaserPlanes
    covariance: ParameterCovariance | None
    """Joint, over camera and light planes; None for methods without a consistent covariance."""
    method: str
    lasers: tuple[LaserCalibration, ...]
    poses: tuple[BoardPose, ...]
    remarks: tuple[tuple[str, str], ...] = ()
    """Rejected or missing data: name of the view, and the reason."""
    contradicting: tuple[tuple[str, str], ...] = ()
    """Shots that were rejected because they contradict the others, and how: lasers exchanged, images turned."""
    excess: float = 1.0
    """Factor by which the variances of corners and stripes were inflated to explain the differences of the views."""
    ghosts: Mapping[str, LaserGhost] = field(default_factory=dict)
    """By the laser's name, ghosts of its stripes that several views show."""
    bows: Mapping[str, LaserBow] = field(default_factory=dict)
    """By the laser's name, bends of its light plane that the views show."""
    sheet_height_m: tuple[float, float] | None = None
    """How far behind the print the stripes beside it lie, and the standard deviation; NaN by a method that does not
    estimate it, None without such stripes."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraView:
    """One view of the board in a camera calibration."""

    board: BoardView
    """The view as it was found in the image."""
    pose: BoardPose
    points_px: Float64[Array, "corner xy=2"]
    """The measured corners, without the systematic errors that distortion causes."""
    residual_px: Float64[Array, "corner xy=2"]
    """Measured minus projected corners, rejected ones included."""
    left_out: Bool[Array, "corner"]
    """Corners rejected as outliers."""
    rejected: str = ""
    """Reason why the whole view was rejected; empty if it was used."""

    @property
    def name(self) -> str:
        """The name of the view's image."""
        return self.board.name


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraCalibration:
    """The intrinsic parameters and their uncertainty."""

    camera: Camera
    """The camera with the covariance of the intrinsic parameters, marginalised over the poses of the board."""
    rms_px: float
    """Root mean square reprojection error of the corners that were used."""
    sigma_px: float
    """Standard deviation of one coordinate of a corner, from the residuals and the degrees of freedom."""
    views: tuple[CameraView, ...]

    @property
    def used(self) -> tuple[CameraView, ...]:
        """The views that the parameters were estimated from."""
        return tuple(view for view in self.views if not view.rejected)

    @property
    def covariance(self) -> ParameterCovariance:
        """The covariance of the intrinsic parameters, which a calibrated camera has."""
        assert self.camera.covariance is not None
        return self.camera.covariance

    @property
    def standard_deviations(self) -> dict[str, float]:
        """Standard deviations of the intrinsic parameters, by name; zero for one that was held fixed."""
        return self.covariance.standard_deviations


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Coverage:
    """Distribution of the used corners over the image, and the orientations of the board."""

    corners: Int64[Array, "cell_row cell_column"]
    """Number of corners in each cell of the image."""
    bare_regions: tuple[str, ...]
    """Ninths of the image with hardly any corner, in words: `upper left`."""
    tilt_rad: tuple[float, ...]
    """By view: angle between board and image plane."""
    tilt_spread_rad: tuple[float, float]
    """Standard deviation of the normals over the views, along and across the direction of the largest variation."""
    distance_m: tuple[float, ...]
    """By view: distance of the board's middle."""

    @property
    def share(self) -> float:
        """Share of the cells that contain corners."""
        return float((self.corners > 0).mean())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeftOutView:
    """One view, held out of a calibration from all other views."""

    name: str
    shift_px: float
    """Displacement of the projection when this view is left out, median over the image."""
    rms_px: float
    """Reprojection error of this view's corners under the camera of the other views; only its pose is fitted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelFit:
    """One distortion model on the same views."""

    distortion_model: str
    parameters: int
    rms_px: float
    held_out_rms_px: float
    """Reprojection error of held-out views: decreases only if the additional coefficients describe the lens."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ModelComparison:
    """Two distortion models on the same views."""

    fits: tuple[ModelFit, ...]
    difference_px: Float64[Array, "map_row map_column"]
    """Displacement between the two cameras, with the camera frame rotated to minimise it; NaN where one is unknown."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraAssessment:
    """A camera calibration with the quantities by which it is assessed."""

    calibration: CameraCalibration
    """The calibration, with the covariance inflated if the views disagree more than noise explains, or show a bow."""
    coverage: Coverage
    sigma_px: Float64[Array, "map_row map_column"]
    """Projection uncertainty: rms displacement of the projection by the covariance; NaN outside the region with
    corners."""
    left_out: tuple[LeftOutView, ...]
    """The results of leaving out each view; empty if there are too few views."""
    split_half_px: Float64[Array, "map_row map_column"]
    """Displacement between the cameras of the even and the odd views; NaN if a half does not determine a camera."""
    half_difference: Float64[Array, "parameter"]
    """Half of the difference between the parameters of these two cameras; zero if a half does not determine one."""
    disagreement: float
    """Ratio of the projection uncertainties by jackknife and by the noise of the corners, medians over the image: 1 if
    noise explains the differences of the views; NaN for too few views."""
    distances_m: tuple[float, ...]
    """Distances at which the projection uncertainty is given in metres."""
    comparison: ModelComparison | None = None
    board: tuple[Check, ...] = ()
    """Consistency checks of the images with each other and with the dimensions in the board file."""
    bow_sigma_px: float = 0.0
    """The part of the projection uncertainty that a bow of the board causes, median over the image; 0 without a bow."""

    @property
    def known_sigma_px(self) -> Float64[Array, "map_point"]:
        """The projection uncertainty where it is known."""
        known: Float64[Array, "map_point"] = self.sigma_px[~np.isnan(self.sigma_px)]
        return known

    @property
    def unknown_share(self) -> float:
        """Share of the image in which the projection uncertainty is not known."""
        return 1.0 - self.known_sigma_px.size / self.sigma_px.size
