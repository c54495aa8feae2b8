"""A study: shots that are simulated, measured and scored over a grid or a random sample, and the rows of its results.

Every shot is a function of the study and of its index, so that it can be computed anywhere and again.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from math import prod
from pathlib import Path
from typing import Literal

from ringpose.types.assumptions import AssumptionOptions
from ringpose.types.plausible import (
    BLUR_PX,
    DARK_NOISE_E,
    DISTANCE_M,
    LASER_ANGLE_RAD,
    OFFSET_SHARE,
    RATE_SD_RAD_S,
    RING_RADIUS_M,
    RING_TOLERANCE_M,
    SHARE,
    SPEED_M_S,
    STABILITY_TILT_RAD,
    STRIPE_DN,
    TILT_RAD,
    Range,
)
from ringpose.types.rig import Rig
from ringpose.types.scene import Scene

Value = str | float | int | bool
"""Value of a factor."""

Row = dict[str, str | float | int | bool | None]
"""One shot by one method: values by the names of `columns`; None where there is none."""


NUMBERS: Mapping[str, Range] = {
    "distance_m": DISTANCE_M,
    "tilt_rad": TILT_RAD,
    "clock_rad": TILT_RAD,
    "offset": OFFSET_SHARE,
    "radius_outer_m": RING_RADIUS_M,
    "laser_angle_rad": LASER_ANGLE_RAD,
    "stripe_dn": STRIPE_DN,
    "blur_px": BLUR_PX,
    "speckle_contrast": SHARE,
    "dark_noise_e": DARK_NOISE_E,
    "ring_tolerance_m": RING_TOLERANCE_M,
    "plane_tilt_rad": STABILITY_TILT_RAD,
    "speed_sd_m_s": SPEED_M_S,
    "rate_sd_rad_s": RATE_SD_RAD_S,
    "displaced_share": SHARE,
    "background_share": SHARE,
    "missing_share": SHARE,
}
"""The factors that are numbers, each with its plausible range."""

ONLY_FEATURES = ("displaced_share", "background_share", "missing_share")
"""Factors with which images cannot be rendered, only features drawn."""

CASE = "case"
"""The factor whose values are names of cases."""

TEXTS = ("light", "sequence", "target")
"""The factors that are texts: a light of the scene, the laser steps of a shot, and `ring` or `body`."""

SWITCHES = ("rig_errors",)
"""The factors that are true or false: whether the true rig is drawn from the covariance of the rig file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Factor:
    """Something that differs between the shots of a study."""

    name: str
    values: tuple[Value, ...] = ()
    """A dimension of the grid, or with `drawn` what each shot draws from."""
    uniform: tuple[float, float] | None = None
    """The interval in which each shot draws a number of its own; `values` are empty then."""
    drawn: bool = False
    """Whether each shot draws its value; otherwise each value is combined with all others."""


class StudyMethod(StrEnum):
    """A method of a study: those of `ringpose pose`, and baselines on the same detections."""

    ML = "ml"
    ML_KNOWN = "ml-known"
    """Maximum likelihood with the true radii as prior, standard deviation 0.5 mm."""
    PAPER = "paper"
    PAPER_CONSTRAINED = "paper-constrained"
    BISECTORS = "bisectors"
    """Perpendicular bisectors of the chords between neighbouring break points, in the plane of all points."""
    POINTS = "points"
    """Unweighted least squares: plane, then two concentric circles through the six points."""
    ELLIPSE = "ellipse"
    """Circle pose from `cv2.fitEllipse` of the ring's visible outer edge; the radii are known."""
    ELLIPSE_REFINED = "ellipse-refined"
    """The same, refined on all visible points of both edges."""
    TRACK = "track"
    """The state after the last shot of a run, tracked by the poses of `ml`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotRun:
    """The shots of one index of a study: the last one is measured by every method, and all of them by `track`."""

    shots: int = 1
    period_s: float = 0.2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Study:
    """What is simulated, measured and scored."""

    title: str
    scene: Scene
    level: Literal["images", "features"]
    """Whether shots are rendered and detected, or their features are drawn from the ring's model."""
    count: int
    """Shots of each cell of the grid."""
    seed: int
    factors: tuple[Factor, ...]
    methods: tuple[StudyMethod, ...]
    table: str
    """The factor in the columns of the first table."""
    cases: Mapping[str, tuple[Factor, ...]] = field(default_factory=dict)
    """By the name of a case, the factors that it replaces; the factor `case` names the one of a shot."""
    assumed: AssumptionOptions | None = None
    """What the estimator assumes about motion, ring and rig; the distributions of the factors if None."""
    calibrate: bool = False
    """Whether the rig that measures is calibrated from simulated board views first."""
    rig: Rig | None = None
    """The rig that measures; that of the scene if None."""
    run: ShotRun = ShotRun()
    limits: Mapping[str, float | Mapping[str, float]] = field(default_factory=dict)
    """Limits of `LIMITS` on the first method; some of them by the name of the case."""
    files: tuple[Path, ...] = ()
    """The files that it was read from."""
    sha256: str = ""
    """Hash of their contents, the number of shots and the seed: studies with the same hash have the same shots."""

    @property
    def grid(self) -> tuple[Factor, ...]:
        """The factors whose values are combined with each other."""
        return tuple(factor for factor in self.factors if not factor.drawn)

    @property
    def cells(self) -> int:
        """Number of combinations."""
        return prod(len(factor.values) for factor in self.grid)

    @property
    def shots(self) -> int:
        """Number of shots."""
        return self.cells * self.count


LIMITS: Mapping[str, str] = {
    "max_center_m": "center_m",
    "max_normal_rad": "normal_rad",
    "max_grasp_m": "grasp_m",
    "max_radius_outer_m": "radius_outer_m",
    "min_available_share": "available",
    "max_no_pose_share": "no_pose",
    "max_wrong": "wrong",
    "max_ok_wrong_share": "ok_wrong",
}
"""Limits of a study, each with what it applies to: root mean square errors, shares of the shots with a ring, the number
of wrong quantities, and the share of all shots that have the status `ok` and a wrong quantity."""

ERRORS = (
    "center_x_m", "center_y_m", "center_z_m", "center_m", "normal_rad", "pitch_rad", "yaw_rad",
    "radius_inner_m", "radius_outer_m", "grasp_m", "velocity_m_s", "rate_rad_s",
    "center_nees", "normal_nees", "velocity_nees",
)  # fmt: skip

SIGMAS = ("sigma_center_m", "sigma_normal_rad", "sigma_radius_outer_m", "sigma_grasp_m")

BOUNDS = ("bound_center_m", "bound_normal_rad", "bound_radius_outer_m")

TIMES = ("simulate_s", "detect_s", "pose_s")
"""The only columns that differ when a shot is computed again."""

INTEGERS = ("shot", "break_points", "edge_points")

TEXT_COLUMNS = ("method", "expect", "outcome", "status", "reason", "flags", "wrong", "gross", "correct")

_TRUTH_COLUMNS = (
    "true_center_x_m", "true_center_y_m", "true_center_z_m", "true_normal_x", "true_normal_y", "true_normal_z",
)  # fmt: skip


def columns(study: Study) -> dict[str, type]:
    """Names of the columns of a study's results, in their order, with the type of their values."""
    factors: dict[str, type] = {
        factor.name: float if factor.name in NUMBERS else bool if factor.name in SWITCHES else str
        for factor in study.factors
    }
    return {
        "shot": int,
        **factors,
        **dict.fromkeys(TEXT_COLUMNS, str),
        **dict.fromkeys(INTEGERS[1:], int),
        **dict.fromkeys((*ERRORS, *SIGMAS, *BOUNDS, *_TRUTH_COLUMNS, *TIMES), float),
    }
