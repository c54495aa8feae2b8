"""A study: shots that are simulated, measured and scored over a grid or a random sample, and the rows of its results.

Every shot is a function of the study and of its index, so that it can be computed anywhere and again.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from math import prod
from pathlib import Path
from typing import Annotated, Literal, get_type_hints

from ringpose.types import plausible
from ringpose.types.assumptions import AssumptionOptions
from ringpose.types.capture import CaptureLoop
from ringpose.types.obstacles import Obstacle
from ringpose.types.plausible import Range
from ringpose.types.record import Key, Presence, key_of
from ringpose.types.rig import Rig
from ringpose.types.scene import Ghost, Scene
from ringpose.types.target import MATERIAL_NAMES, Gap, Material

Value = str | float | int | bool
"""Value of a factor."""

Row = dict[str, str | float | int | bool | None]
"""One shot by one method: values by the names of `columns`; None where there is none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawn:
    """What each shot draws a value from; one of them is given."""

    uniform: Annotated[tuple[float, float] | None, Key("The ends of an interval.", presence=Presence.IF_KNOWN)] = None
    choice: Annotated[
        tuple[Value, ...] | None, Key("The values of which each shot has one.", presence=Presence.IF_KNOWN)
    ] = None
    shares: Annotated[
        Mapping[str, Annotated[float, Key(least=0.0, most=1.0)]],
        Key(
            "The same of a factor that is a text: its values, each with the share of the shots that draw it, 1 in all.",
            presence=Presence.IF_KNOWN,
        ),
    ] = field(default_factory=dict)


_Number = float | tuple[float, ...] | Drawn | None
_Text = str | tuple[str, ...] | Drawn | None
_Switch = bool | tuple[bool, ...] | Drawn | None
_Shown = Literal["ring", "body"] | tuple[Literal["ring", "body"], ...] | Drawn | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Factors:
    """The factors of a study: each a value, several values of the grid, or what each shot draws from."""

    distance_m: Annotated[
        _Number,
        Key(
            "Depth of the middle of the visible section of the ring.",
            plausible=plausible.DISTANCE_M,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    tilt_rad: Annotated[
        _Number,
        Key(
            "Largest tilt, as in the random views of a scene.", plausible=plausible.TILT_RAD, presence=Presence.IF_KNOWN
        ),
    ] = None
    clock_rad: Annotated[
        _Number,
        Key(
            "Largest angle of the visible section, likewise.", plausible=plausible.TILT_RAD, presence=Presence.IF_KNOWN
        ),
    ] = None
    offset: Annotated[
        _Number,
        Key(
            "Largest offset from the image centre, likewise.",
            plausible=plausible.OFFSET_SHARE,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    light: Annotated[
        _Text,
        Key("A light of the scene.", presence=Presence.IF_KNOWN),
    ] = None
    sequence: Annotated[
        _Text,
        Key("Laser steps of a shot, such as `off,1,2,3,all`.", presence=Presence.IF_KNOWN),
    ] = None
    target: Annotated[
        _Shown,
        Key("`ring`, or `body` for the satellite without it.", presence=Presence.IF_KNOWN),
    ] = None
    ring_radius_outer_m: Annotated[
        _Number,
        Key(
            "Outer radius of the ring; its cross-section stays the same.",
            plausible=plausible.RING_RADIUS_M,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    whole: Annotated[
        _Switch,
        Key(
            "Whether the middle of the image shows the centre of the ring, not a section of its face, as in the random "
            "views of a scene.",
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    baseline_m: Annotated[
        _Number,
        Key(
            "Mean distance of the lasers' projectors from the optical axis.",
            plausible=plausible.BASELINE_M,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    laser_angle_rad: Annotated[
        _Number,
        Key("Angle of the outer light planes.", plausible=plausible.LASER_ANGLE_RAD, presence=Presence.IF_KNOWN),
    ] = None
    stripe_dn: Annotated[
        _Number,
        Key(
            "Grey value of the stripes, by the exposure; beyond the largest one of the sensor they saturate, in images "
            "only.",
            plausible=plausible.STRIPE_DN,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    blur_px: Annotated[
        _Number,
        Key("Blur of the lens.", plausible=plausible.BLUR_PX, presence=Presence.IF_KNOWN),
    ] = None
    speckle_contrast: Annotated[
        _Number,
        Key("Contrast of the speckle.", plausible=plausible.SHARE, presence=Presence.IF_KNOWN),
    ] = None
    dark_noise_e: Annotated[
        _Number,
        Key("Temporal dark noise.", plausible=plausible.DARK_NOISE_E, presence=Presence.IF_KNOWN),
    ] = None
    rig_errors: Annotated[
        _Switch,
        Key("Whether the true rig is drawn from the covariance of the rig file.", presence=Presence.IF_KNOWN),
    ] = None
    ring_tolerance_m: Annotated[
        _Number,
        Key(
            "Deviation of each edge from a circle, and of the face from a plane (standard deviation).",
            plausible=plausible.RING_TOLERANCE_M,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    plane_tilt_rad: Annotated[
        _Number,
        Key(
            "Angle by which one light plane, drawn by each shot, is turned about its projector, and the rig file is "
            "wrong.",
            plausible=plausible.STABILITY_TILT_RAD,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    speed_sd_m_s: Annotated[
        _Number,
        Key(
            "Standard deviation per axis of the velocity of the ring's centre, drawn for each shot or run.",
            plausible=plausible.SPEED_M_S,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    rate_sd_rad_s: Annotated[
        _Number,
        Key(
            "The same of the rates across the ring's normal.",
            plausible=plausible.RATE_SD_RAD_S,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    displaced_share: Annotated[
        _Number,
        Key(
            "Probability that a break point is an outlier; needs `level: features`.",
            plausible=plausible.SHARE,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    background_share: Annotated[
        _Number,
        Key(
            "Probability that a stripe lies on a surface behind the ring; needs `level: features`.",
            plausible=plausible.SHARE,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    missing_share: Annotated[
        _Number,
        Key(
            "Probability that a stripe is missing; needs `level: features`.",
            plausible=plausible.SHARE,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    target_rate_rad_s: Annotated[
        _Number,
        Key(
            "Rate of the tumbling target; needs `capture`, as the factors that follow do.",
            plausible=plausible.RATE_RAD_S,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    nutation_rad: Annotated[
        _Number,
        Key(
            "Angle between its angular momentum and the ring's axis at the start.",
            plausible=plausible.TILT_RAD,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    drift_m_s: Annotated[
        _Number,
        Key("Speed of its centre of mass.", plausible=plausible.SPEED_M_S, presence=Presence.IF_KNOWN),
    ] = None
    floating_base: Annotated[
        _Switch,
        Key("Whether the robot's base floats freely and reacts to the arm.", presence=Presence.IF_KNOWN),
    ] = None
    lost_share: Annotated[
        _Number,
        Key("Probability that a shot is lost.", plausible=plausible.SHARE, presence=Presence.IF_KNOWN),
    ] = None
    latency_s: Annotated[
        _Number,
        Key("Time from a shot to its line.", plausible=plausible.LATENCY_S, presence=Presence.IF_KNOWN),
    ] = None
    faults: Annotated[
        _Text,
        Key(
            "What is wrong in each shot, see below: names joined by `+`, or `none`; needs `level: features`.",
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    surfaces: Annotated[
        _Text,
        Key("Names of the study's `surfaces`, joined by `+`; needs `level: images`.", presence=Presence.IF_KNOWN),
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surface:
    """How a ring, or the light on it, differs from the scene: keys of its `lasers` and `ring`, and obstacles."""

    ghost: Annotated[Ghost | None, Key("As in `lasers`.", presence=Presence.IF_KNOWN)] = None
    bow_per_rad: Annotated[
        float, Key("As in `lasers`.", plausible=plausible.BOW_PER_RAD, presence=Presence.IF_KNOWN)
    ] = 0.0
    face: Annotated[Material | None, Key("As in `ring`.", words=MATERIAL_NAMES, presence=Presence.IF_KNOWN)] = None
    slope_rad: Annotated[float, Key("As in `ring`.", plausible=plausible.SLOPE_RAD, presence=Presence.IF_KNOWN)] = 0.0
    gaps: Annotated[tuple[Gap, ...], Key("As in `ring`.", presence=Presence.IF_KNOWN)] = ()
    obstacles: Annotated[tuple[Obstacle, ...], Key("As in a scene.", tag="kind", presence=Presence.IF_KNOWN)] = ()


NUMBERS: Mapping[str, Range] = {
    name: key.plausible
    for name, hint in get_type_hints(Factors, include_extras=True).items()
    if (key := key_of(hint)) is not None and key.plausible is not None
}
"""The factors that are numbers, each with its plausible range."""

FAULTS = "faults"
"""The factor whose values are names of faults, joined by `+`."""

NO_FAULT = "none"
"""Its value for a shot in which nothing is wrong."""

DRAWN_FAULTS = ("end", "ends", "stripe", "ghost", "missing", "edge", "unlit", "tails", "sigmas")
"""Faults of a shot's features, each of which happens once in a shot that has it: one end of a stripe is somewhere else
on it, both are, a stripe lies on a surface behind the face, or is displaced with its ends, or missing; a visible edge
is displaced, or all are unlit; errors have heavier tails (Student's t with four degrees of freedom, of the stated
variance), or are 1.3 times as large as stated."""

ONLY_FEATURES = ("displaced_share", "background_share", "missing_share", FAULTS)
"""Factors with which images cannot be rendered, only features drawn."""

ONLY_CAPTURE = ("target_rate_rad_s", "nutation_rad", "drift_m_s", "floating_base", "lost_share", "latency_s")
"""Factors of the closed loop of a capture."""

CASE = "case"
"""The factor whose values are names of cases."""

SURFACES = "surfaces"
"""The factor whose values are names of surfaces, joined by `+`."""

TEXTS = ("light", "sequence", "target", FAULTS, SURFACES)
"""The factors that are texts: a light, the laser steps of a shot, `ring` or `body`, names of faults, and of
surfaces."""

RUN_FAULTS = ("plane", "form", "motion", "radius")
"""Faults of all shots of a run: a light plane has turned by 0.1 to 1 degree, the ring's tolerance is 1 mm, the target
moves four times as fast as assumed, the given radii are wrong by 1 to 10 %."""

SWITCHES = ("whole", "rig_errors", "floating_base")
"""The factors that are true or false."""


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
    shares: tuple[float, ...] = ()
    """How often each value is drawn; equally often without."""


class StudyMethod(StrEnum):
    """A method of a study: those of `ringpose pose`, and baselines on the same detections."""

    ML = "ml"
    ML_KNOWN = "ml-known"
    """Maximum likelihood with the true radii as prior, standard deviation 0.5 mm."""
    PAPER = "paper"
    PAPER_CONSTRAINED = "paper-constrained"
    PAPER_DETECTOR = "paper-detector"
    """The paper's closed form from the pixel ends of its line detector, in images."""
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
    surfaces: Mapping[str, Surface] = field(default_factory=dict)
    occurrence: Mapping[str, float] = field(default_factory=dict)
    """How often the values of the factor `table` occur outside of the study, for the sum in the table of integrity."""
    bounds: bool = True
    """Whether each shot has its Cramér-Rao bounds, and what they determine."""
    assumed: AssumptionOptions | None = None
    """What the estimator assumes about motion, ring and rig; the distributions of the factors if None."""
    calibrate: bool = False
    """Whether the rig that measures is calibrated from simulated board views first."""
    rig: Rig | None = None
    """The rig that measures; that of the scene if None."""
    run: ShotRun = ShotRun()
    capture: CaptureLoop | None = None
    """The loop in which a gripper is guided to the ring, if that is studied: each shot is then a run of it."""
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

CAPTURE_LIMITS: Mapping[str, str] = {"min_success_share": "success", "max_miss_share": "miss"}
"""Limits of a study of captures."""

_Limit = float | Mapping[str, Annotated[float, Key(least=0)]] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """The limits of `LIMITS`; a mapping has them for some of the cases."""

    max_center_m: Annotated[
        _Limit, Key("Root mean square error of the centre.", least=0, presence=Presence.IF_KNOWN)
    ] = None
    max_normal_rad: Annotated[
        _Limit, Key("Root mean square error of the normal.", least=0, presence=Presence.IF_KNOWN)
    ] = None
    max_grasp_m: Annotated[
        _Limit, Key("Root mean square error of the grasp point.", least=0, presence=Presence.IF_KNOWN)
    ] = None
    max_radius_outer_m: Annotated[
        _Limit, Key("Root mean square error of the outer radius.", least=0, presence=Presence.IF_KNOWN)
    ] = None
    min_available_share: Annotated[
        _Limit, Key("Share of the shots with a ring that have the status `ok`.", least=0, presence=Presence.IF_KNOWN)
    ] = None
    max_no_pose_share: Annotated[
        _Limit, Key("Share of the shots with a ring that have no pose.", least=0, presence=Presence.IF_KNOWN)
    ] = None
    max_wrong: Annotated[_Limit, Key("Number of wrong quantities.", least=0, presence=Presence.IF_KNOWN)] = None
    max_ok_wrong_share: Annotated[
        _Limit,
        Key("Share of all shots that have the status `ok` and a wrong quantity.", least=0, presence=Presence.IF_KNOWN),
    ] = None
    min_success_share: Annotated[
        _Limit,
        Key("Share of the runs in which the gripper captures; needs `capture`.", least=0, most=1,
            presence=Presence.IF_KNOWN),
    ] = None  # fmt: skip
    max_miss_share: Annotated[
        _Limit, Key("Share of the runs in which it closes beside the ring, likewise.", least=0,
                    presence=Presence.IF_KNOWN),
    ] = None  # fmt: skip


ERRORS = (
    "center_x_m", "center_y_m", "center_z_m", "center_m", "normal_rad", "pitch_rad", "yaw_rad",
    "radius_inner_m", "radius_outer_m", "grasp_m", "velocity_m_s", "rate_rad_s",
    "center_nees", "normal_nees", "velocity_nees",
)  # fmt: skip

SIGMAS = ("sigma_center_m", "sigma_normal_rad", "sigma_radius_outer_m", "sigma_grasp_m")

LEVELS = tuple(
    f"{prefix}_{name}"
    for name in ("grasp_normal_m", "grasp_radial_m", "normal_rad", "center_x_m", "center_y_m", "center_z_m")
    for prefix in ("error", "level")
)
"""Absolute errors of a line with protection levels, beside these; no level where it is unavailable."""

BOUNDS = ("bound_center_m", "bound_normal_rad", "bound_radius_outer_m")

TIMES = ("simulate_s", "detect_s", "pose_s")
"""The only columns that differ when a shot is computed again."""

INTEGERS = ("shot", "stripes", "break_points", "edge_points", "shots", "rings")

TEXT_COLUMNS = (
    "method", "expect", "outcome", "status", "reason", "flags", "wrong", "gross", "correct", "reported", "determined",
)  # fmt: skip

_TRUTH_COLUMNS = (
    "true_center_x_m", "true_center_y_m", "true_center_z_m", "true_normal_x", "true_normal_y", "true_normal_z",
)  # fmt: skip


CAPTURE_ERRORS = ("radial_error_m", "tilt_error_rad")
"""Errors of a gripper that has closed: its distance from the middle of the band, and its angle to the normal."""

CAPTURE_VECTORS = ("gripper", "approach", "ring_center", "ring_normal")
"""Vectors of a run at its closing, of which each has three columns, in the base frame at the start."""

CAPTURE_RADII = ("ring_radius_inner_m", "ring_radius_outer_m", "window_m", "window_rad")
"""Radii of the true ring, and window of the gripper."""

CAPTURE_TIMES = ("run_s",)
"""The column that differs when a run is computed again."""


def columns(study: Study) -> dict[str, type]:
    """Names of the columns of a study's results, in their order, with the type of their values."""
    factors: dict[str, type] = {
        factor.name: float if factor.name in NUMBERS else bool if factor.name in SWITCHES else str
        for factor in study.factors
    }
    if study.capture is not None:
        vectors = [f"{name}_{axis}" for name in CAPTURE_VECTORS for axis in "xyz"]
        numbers = ("closed_s", "capture_probability", *CAPTURE_ERRORS, *vectors)
        return {
            "shot": int,
            **factors,
            **dict.fromkeys(("method", "outcome", "status", "reason"), str),
            **dict.fromkeys(("shots", "rings"), int),
            **dict.fromkeys((*numbers, *CAPTURE_RADII, *CAPTURE_TIMES), float),
        }
    return {
        "shot": int,
        **factors,
        **dict.fromkeys(TEXT_COLUMNS, str),
        **dict.fromkeys(("stripes", "break_points", "edge_points"), int),
        **dict.fromkeys((*ERRORS, *SIGMAS, *LEVELS, *BOUNDS, *_TRUTH_COLUMNS, *TIMES), float),
    }
