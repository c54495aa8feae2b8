"""Results of the pose estimation: the pose of the ring, or the reason why there is none, and the record of one shot.

Also the prior radii of its edges, the triangulated break points, and the evidence of one shot for errors of the light
planes.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, IntFlag, StrEnum
from math import atan2, hypot, inf, nan
from typing import Annotated, Any, Literal

import numpy as np

from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.assumptions import Assumptions, MotionPrior, RigStability
from ringpose.types.detection import Rejection
from ringpose.types.options import PoseFrame
from ringpose.types.protection import Protection, Separation
from ringpose.types.record import Form, Key, Presence
from ringpose.types.rig import LaserBow, PlaneCorrection


class NoPose(Enum):
    """Reason why a shot has no pose; the value is the message for the user."""

    TOO_FEW_BREAK_POINTS = "too few break points: none at all, or for the closed forms fewer than three on an edge"
    UNTRIANGULATED = "a ray runs along its light plane or meets it behind the camera"
    COLLINEAR = "the break points lie on one line within their errors, which no plane determines"
    EDGE_ON = "the ring's plane passes through the camera: its face cannot be seen"
    AMBIGUOUS = "what was seen has several explanations with neither the ring's plane nor a grasp point in common"
    MIRRORED = "what was seen fits a ring only if the image is mirrored left to right; see the camera's flip"
    UNDETERMINED = "neither the ring's plane nor a point to grasp is determined by what was seen"
    SINGULAR = "the equations for the ring are numerically singular: what was seen contradicts itself or is degenerate"
    UNCONFIRMED = (
        "nothing shows that one or two stripes, seen with all lasers on, are those of the lasers on a ring: neither "
        "its curvature, nor visible edges where they end, nor enough clear ends"
    )
    NO_ROBOT_POSES = (
        "the robot's poses do not cover the shot, or have gaps: give them from before its first to after its last frame"
    )
    NOT_FINITE = "the solution misses the break points that it came from, as when the ring lies along a light plane"


def names_of(flags: "PoseFlag") -> tuple[str, ...]:
    """Names of flags, in lower case."""
    return tuple(str(flag.name).lower() for flag in PoseFlag if flag in flags)


class PoseFlag(IntFlag):
    """Warnings of a pose line; the record has their names in lower case. They may accompany any status."""

    CENTER_WEAK = 1 << 0
    NORMAL_WEAK = 1 << 1
    """One stripe does not determine the tilt about it: grasp point without a normal."""
    GRASP_WEAK = 1 << 2
    RADIUS_WEAK = 1 << 3
    VELOCITY_WEAK = 1 << 4
    SIDE_UNKNOWN = 1 << 5
    """Inner and outer edge could not be distinguished: the centre may lie on either side."""
    ASSIGNMENT_AMBIGUOUS = 1 << 6
    """The stripes fit one ring only, or about as well, if they are assigned to other lasers than given."""
    POINT_REJECTED = 1 << 7
    STRIPE_REJECTED = 1 << 8
    EDGE_REJECTED = 1 << 9
    """Visible points of the ring's edge were rejected as those of something else."""
    LASER_MISSING = 1 << 10
    """The stripe of a laser that was on should be in view, but was not found."""
    RADIUS_INCONSISTENT = 1 << 11
    """The observed ring does not have the given radii; the prior was rejected."""
    RADIUS_UNVERIFIED = 1 << 12
    """The radius is assumed: the shot alone determines it to no better than one percent."""
    RING_FORM = 1 << 13
    INCONSISTENT = 1 << 14
    """The observations disagree with one ring by more than their errors; the covariance is inflated accordingly."""
    MOTION = 1 << 15
    AMBIENT_CHANGED = 1 << 16
    RIG_DRIFT = 1 << 17
    RIG_UNCHECKED = 1 << 18
    """One or two stripes: the shot has no redundancy that could show an error of the rig."""
    SATURATED = 1 << 19
    """A break point could not be measured because the stripe is saturated there."""
    TRUNCATED = 1 << 20
    """A break point that should be in view could not be measured, as its stripe is cut off by the image's border."""
    BLUNT_EDGE = 1 << 21
    """The ring's edges are rounded or chamfered: the stripes fade over more columns than the optical blur explains."""
    GHOST_REMOVED = 1 << 22
    """Fainter copies of the stripes, by reflection inside the camera, were subtracted."""


HARMLESS_FLAGS = PoseFlag.RADIUS_UNVERIFIED | PoseFlag.RIG_UNCHECKED | PoseFlag.GHOST_REMOVED
"""Flags that a pose with the status `ok` may have."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlaneEvidence:
    """What one shot shows about the rig's parameters: rows A q = y with noise of unit variance."""

    parameters: Annotated[
        tuple[str, ...],
        Key(
            "Names of the errors q of the rig, and of the amplitudes of the ring's form; the ring and its motion are "
            "eliminated.",
            form=Form.DISTINCT,
        ),
    ]
    rows: Annotated[
        Float64[Array, "row column"],
        Key(
            "Rows [A, y] of A q = y with noise of unit variance, in the parameters' own units; those of the form in "
            "standard deviations."
        ),
    ]
    normal: Annotated[
        Float64[Array, "xyz=3"],
        Key("Normal of the ring.", form=Form.UNIT_VECTOR),
    ]
    place_m: Annotated[Float64[Array, "xyz=3"], Key("A point of its face; both distinguish shots at different poses.")]

    @property
    def contradiction(self) -> tuple[str, str] | None:
        """The key and the finding of values that contradict each other; None if they do not."""
        return _other_columns("rows", self.rows, len(self.parameters) + 1)


def _other_columns(key: str, rows: Float64[Array, "row column"], columns: int) -> tuple[str, str] | None:
    """The finding that rows do not have this number of columns."""
    if rows.shape[1] == columns:
        return None
    return key, f"has {rows.shape[0]} x {rows.shape[1]} numbers, must have n x {columns}"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseCovariance:
    """Covariances of a pose; None if they are not known."""

    full: Annotated[
        Float64[Array, "7 7"] | None,
        Key(
            "Of tilt_1, tilt_2, offset_m (of the plane normal . point = offset_m), center_1_m, center_2_m (along the "
            "tilt basis), radius_inner_m, radius_outer_m; null in the rows and columns of what is not determined.",
            gaps=True,
            form=Form.COVARIANCE,
        ),
    ]
    center: Annotated[Float64[Array, "3 3"] | None, Key("Of the centre's coordinates.", form=Form.COVARIANCE)]
    grasp: Annotated[Float64[Array, "3 3"] | None, Key("Of the grasp point's coordinates.", form=Form.COVARIANCE)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingPose:
    """Pose of the ring in the camera frame, in metres."""

    center_m: Annotated[Float64[Array, "xyz=3"], Key("Centre of the ring; null if it is not determined.", null=nan)]
    normal: Annotated[
        Float64[Array, "xyz=3"],
        Key(
            "Unit normal of the ring's plane, towards the camera (the paper's Z_b); null if it is not determined.",
            null=nan,
            form=Form.UNIT_VECTOR,
        ),
    ]
    radius_inner_m: Annotated[float, Key("Radius of the inner edge; null if it is not determined.", null=nan)]
    radius_outer_m: Annotated[float, Key("Radius of the outer edge; null if it is not determined.", null=nan)]
    grasp_m: Annotated[
        Float64[Array, "xyz=3"],
        Key(
            "Grasp point, in the middle of the ring's band where it was seen; null if one of the edges was not seen "
            "and the middle is unknown.",
            null=nan,
        ),
    ]
    """In `ml` at the centre of the observations (method(7), section 5), in `paper` the mean of the break points."""
    ring_posterior: Annotated[
        Mapping[str, Annotated[float, Key(least=0.0, most=1.0, null=nan)]] | None,
        Key("Probability of each ring of a catalogue, and of `none of these`; null without a catalogue."),
    ] = None
    method: Annotated[str, Key("Estimation method of the pose.")]
    residual_rms_px: Annotated[
        float,
        Key(
            "Root mean square distance between the measured break points and those predicted from the pose.",
            null=nan,
            least=0.0,
        ),
    ]
    condition_number: Annotated[
        float,
        Key(
            "Condition number of the system of equations: for `ml` that of all parameters, with columns scaled to unit "
            "length; for the other methods that of the centre, with scaled rows; null if it is singular.",
            null=inf,
            least=0.0,
            earlier="condition",
        ),
    ]
    covariance: Float64[Array, "7 7"] | None = None
    """See `PoseCovariance`; NaN in the rows and columns of what is not determined.

    Plane: normal(tilt) . point = offset_m (`ringpose.geometry.rotations.tilted`); centre c = offset_m n + center_1_m e1
    + center_2_m e2, where the tilt basis e1, e2 tilts with the normal (method(7), section 8).
    """
    covariance_center_m2: Float64[Array, "3 3"] | None = None
    covariance_grasp_m2: Float64[Array, "3 3"] | None = None
    flags: PoseFlag = PoseFlag(0)
    remark: str = ""
    """Warning in words; empty if there is none."""

    @classmethod
    def from_record(cls, covariances: PoseCovariance | None, **keys: Any) -> "RingPose":
        """The pose of a record; its flags are those of its line."""
        known = covariances or PoseCovariance(full=None, center=None, grasp=None)
        return cls(
            **keys,
            covariance=known.full,
            covariance_center_m2=known.center,
            covariance_grasp_m2=known.grasp,
        )

    @property
    def covariances(self) -> Annotated[PoseCovariance | None, Key(name="covariance", after="grasp_m", is_read=True)]:
        """All covariances; None if none is known."""
        full, center, grasp = self.covariance, self.covariance_center_m2, self.covariance_grasp_m2
        known = [each for each in (full, center, grasp) if each is not None]
        return PoseCovariance(full=full, center=center, grasp=grasp) if known else None

    @property
    def pitch_rad(
        self,
    ) -> Annotated[float, Key("The paper's pitch of the normal, null with it.", after="normal", null=nan)]:
        """The paper's pitch: asin(w_y) of w = -normal, zero when the ring faces the camera (method(7), section 4)."""
        x, y, z = self.normal.tolist()
        return atan2(-y, hypot(x, z))

    @property
    def yaw_rad(self) -> Annotated[float, Key("The paper's yaw of the normal.", after="pitch_rad", null=nan)]:
        """The paper's yaw: atan2(w_x, w_z) of w = -normal (method(7), section 4)."""
        x, _, z = self.normal.tolist()
        return atan2(-x, -z)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearizationPoint:
    """The ring about which a measurement is linearised, in the camera frame."""

    center_m: Annotated[Float64[Array, "xyz=3"], Key()]
    normal: Annotated[Float64[Array, "xyz=3"], Key(form=Form.UNIT_VECTOR)]
    radius_inner_m: Annotated[float, Key(null=nan)]
    radius_outer_m: Annotated[float, Key(null=nan)]
    velocity_m_s: Annotated[Float64[Array, "xyz=3"], Key()]
    rate_rad_s: Annotated[Float64[Array, "xyz=3"], Key()]


MEASURED_PARAMETERS = (
    "tilt_1", "tilt_2", "offset_m", "center_1_m", "center_2_m", "radius_inner_m", "radius_outer_m",
    "velocity_x_m_s", "velocity_y_m_s", "velocity_z_m_s", "rate_1_rad_s", "rate_2_rad_s",
)  # fmt: skip
"""The ring's parameters in a measurement: increments about the linearisation point, tilt basis of its normal.

c = offset_m n + center_1_m e1 + center_2_m e2, where e1 and e2 tilt with n (method(7), section 8).
"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingMeasurement:
    """The information of one shot alone, without any prior (ringpose-method(7), section 9); always camera frame."""

    linearized_at: Annotated[LinearizationPoint, Key("The ring about which the equations are linearised.")]
    nuisance_parameters: Annotated[
        tuple[str, ...],
        Key(
            "Names of the n errors q that shots have in common, in their own units: parameters of the rig, and the "
            "amplitudes of the ring's form `form.inner.a2` to `form.axial.b4` in metres (a of the cosine, b of the "
            "sine of the order, with the angle from the middle of the arc that was seen); with `--face-slope` also "
            "`face.slope` in radians, positive where the face rises outwards; with robot poses also "
            "`mount.rotation_x` to `mount.translation_z` and `mount.delay`, those that have a variance.",
            form=Form.DISTINCT,
        ),
    ]
    square_root: Annotated[
        Float64[Array, "row column"],
        Key(
            "The upper-trapezoidal QR factor R of the whitened rows [J, J_q, z - h], 12 + n + 1 columns, so that R^T R "
            "has all blocks of the normal equations.",
            form=Form.UPPER_TRAPEZOIDAL,
        ),
    ]
    degrees_of_freedom: Annotated[int, Key("Of the fit to this shot.")]
    chi2: Annotated[float, Key("Of the fit to this shot.", least=0.0)]
    camera_motion: Annotated[
        Literal["none", "robot_poses"],
        Key("`none`, or `robot_poses` if the camera's motion was known and removed.", needed=True),
    ] = "none"

    @property
    def parameters(
        self,
    ) -> Annotated[
        tuple[str, ...],
        Key(
            "Names of the 12 increments x, in the tilt basis of the normal at the linearisation point: tilt_1, tilt_2, "
            "offset_m, center_1_m, center_2_m, radius_inner_m, radius_outer_m, velocity_x_m_s, velocity_y_m_s, "
            "velocity_z_m_s, rate_1_rad_s, rate_2_rad_s.",
            after="linearized_at",
            constant=MEASURED_PARAMETERS,
        ),
    ]:
        """See `MEASURED_PARAMETERS`."""
        return MEASURED_PARAMETERS

    @property
    def contradiction(self) -> tuple[str, str] | None:
        """The key and the finding of values that contradict each other; None if they do not."""
        columns = len(MEASURED_PARAMETERS) + len(self.nuisance_parameters) + 1
        return _other_columns("square_root", self.square_root, columns)


@dataclass(frozen=True, slots=True, kw_only=True)
class RadiusPrior:
    """Assumed edge radii; NaN for an edge without a prior."""

    inner_m: Annotated[float, Key("Radius of the inner edge; null if none is assumed.", null=nan)]
    outer_m: Annotated[float, Key("Radius of the outer edge; null if none is assumed.", null=nan)]
    inner_sd_m: Annotated[float, Key("Standard deviation of `inner_m`.", null=nan, added=True)]
    outer_sd_m: Annotated[float, Key("Standard deviation of `outer_m`.", null=nan, added=True)]
    source: Annotated[str, Key("`given`, or the name of the catalogue's ring; `or` joins the names of several.")]

    @classmethod
    def from_record(cls, sd_m: float, **keys: Any) -> "RadiusPrior":
        """The prior of a record; older ones have one standard deviation for both edges."""
        for edge in ("inner", "outer"):
            if keys[f"{edge}_m"] == keys[f"{edge}_m"] and keys[f"{edge}_sd_m"] != keys[f"{edge}_sd_m"]:
                keys[f"{edge}_sd_m"] = sd_m
        return cls(**keys)

    @property
    def sd_m(self) -> Annotated[float, Key("The larger standard deviation.", after="source", is_read=True, least=0.0)]:
        """The larger standard deviation."""
        return max(sd for sd in (self.inner_sd_m, self.outer_sd_m, 0.0) if sd == sd)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigPriors:
    """What a pose assumes about the rig."""

    covariance: Annotated[
        bool,
        Key(
            "Whether the covariance of the rig file was used: `rig.yaml`, or `none`; without one the calibration "
            "counts as exact.",
            words={True: "rig.yaml", False: "none"},
        ),
    ]
    stability: Annotated[RigStability, Key("Standard deviations since the calibration.")]
    moved: Annotated[
        Mapping[str, PlaneCorrection],
        Key("After a drift: each light plane that was corrected.", presence=Presence.IF_KNOWN),
    ] = field(default_factory=dict)
    bent: Annotated[
        Mapping[str, LaserBow],
        Key("Each light plane that is bent, as in the rig file.", presence=Presence.IF_KNOWN),
    ] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Priors:
    """Prior assumptions of a pose."""

    assumptions: Assumptions = Assumptions()
    radius: Annotated[RadiusPrior | None, Key("Assumed radii of the edges; null if none is assumed.")] = None
    rig_covariance: bool = False
    """Whether the covariance of rig.yaml was used; without one the calibration counts as exact."""
    moved_planes: Mapping[str, PlaneCorrection] = field(default_factory=dict)
    bent_planes: Mapping[str, LaserBow] = field(default_factory=dict)
    """The corrections of light planes, by the laser's name."""
    regularization: Annotated[
        Float64[Array, "row column=13"] | None,
        Key(
            "Rows [J, z - h] with 12 + 1 columns: weak priors in units of their standard deviations, for parameters "
            "that the shot leaves open; null if it leaves none open."
        ),
    ] = None

    @classmethod
    def from_record(
        cls, motion: MotionPrior | None, ring_tolerance_m: float, rig: RigPriors, face_slope_rad: float, **keys: Any
    ) -> "Priors":
        """The priors of a record."""
        assumptions = Assumptions(
            motion=motion, ring_tolerance_m=ring_tolerance_m, stability=rig.stability, face_slope_rad=face_slope_rad
        )
        return cls(
            assumptions=assumptions,
            rig_covariance=rig.covariance,
            moved_planes=rig.moved,
            bent_planes=rig.bent,
            **keys,
        )

    @property
    def motion(
        self,
    ) -> Annotated[
        MotionPrior | None,
        Key("`still`, or the standard deviations per axis of the ring's motion.", is_read=True, words={None: "still"}),
    ]:
        """None if the target is assumed to be still."""
        return self.assumptions.motion

    @property
    def ring_tolerance_m(
        self,
    ) -> Annotated[float, Key("Standard deviation of the ring's form.", after="radius", is_read=True, least=0.0)]:
        """Standard deviation of the edges from circles, and of the face from a plane."""
        return self.assumptions.ring_tolerance_m

    @property
    def face_slope_rad(
        self,
    ) -> Annotated[
        float,
        Key(
            "Standard deviation of the slope of the ring's face, which may be conical.",
            after="ring_tolerance_m",
            is_read=True,
            added=True,
            null=0.0,
            least=0.0,
        ),
    ]:
        """Standard deviation of the angle between the face and the ring's plane."""
        return self.assumptions.face_slope_rad

    @property
    def rig(
        self,
    ) -> Annotated[RigPriors, Key("What is assumed about the rig.", after="face_slope_rad", is_read=True)]:
        """What is assumed about the rig."""
        return RigPriors(
            covariance=self.rig_covariance,
            stability=self.assumptions.stability,
            moved=self.moved_planes,
            bent=self.bent_planes,
        )


class LaserState(StrEnum):
    """Contribution of a laser's stripe to a pose."""

    USED = "used"
    INTERRUPTED = "interrupted"
    """Used, with the break points that are not hidden; something stands on the face or over it, or a piece of the face
    is missing."""
    PARTLY = "partly"
    """One or both of its break points that should be in view were rejected or not found."""
    REJECTED = "rejected"
    NOT_SEEN = "not_seen"
    """Its stripe should be in view, or in a shot without a ring may be, but was not found."""
    OUT_OF_VIEW = "out_of_view"
    """By rig and ring, its stripe lies outside the image."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseResult:
    """The result of the estimation from one detection."""

    pose: RingPose | NoPose
    flags: PoseFlag = PoseFlag(0)
    """Flags of the pose, if there is one."""
    remark: str = ""
    """What contradicts the pose, in words; empty if nothing does."""
    stamp_s: float = nan
    """The instant at which the pose holds; NaN if the features' stamps are unknown."""
    velocity: "RingVelocity | None" = None
    """None if the target is assumed to be still."""
    measurement: RingMeasurement | None = None
    priors: Priors | None = None
    lasers: Mapping[str, LaserState] = field(default_factory=dict)
    rejected: tuple[Rejection, ...] = ()
    plane_evidence: PlaneEvidence | None = None
    """Evidence for errors of the light planes, of all measurements if some of them contradict one ring; None for
    methods without residuals."""
    budget: Callable[[], Mapping[str, Float64[Array, "quantity=7 quantity=7"]]] | None = None
    """Computes the covariance of the separated quantities but the last, by source; None without residuals."""
    separation: Callable[[], Separation] | None = None
    """Computes the solutions under all hypotheses; None for methods without residuals."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingVelocity:
    """Velocity of the ring's centre and its angular velocity across the normal, camera frame."""

    center_m_s: Annotated[Float64[Array, "xyz=3"], Key("Of the ring's centre.")]
    rate_rad_s: Annotated[
        Float64[Array, "xyz=3"],
        Key("Angular velocity, perpendicular to the normal; the spin about the normal is not observable."),
    ]
    covariance: Annotated[
        Float64[Array, "5 5"],
        Key("Of velocity x, y, z, rate_1, rate_2; rates along the tilt basis.", form=Form.COVARIANCE),
    ]


Status = Literal["ok", "degraded", "none"]


def status_of(pose: RingPose | None, flags: PoseFlag) -> Status:
    """The status of a line: `none`, `degraded` (a pose with flags other than `HARMLESS_FLAGS`) or `ok`."""
    if pose is None:
        return "none"
    return "degraded" if int(flags) & ~int(HARMLESS_FLAGS) else "ok"  # a tenth of the time of operations on flags


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseLine:
    """Record of one shot: its pose or the reason why it has none, and the provenance."""

    software: Annotated[str, Key("Program and version that wrote the line.", null="", added=True)] = ""
    shot: Annotated[str, Key("Name of the shot: its file name without suffix.")]
    stamp_s: Annotated[
        float,
        Key(
            "Time of the shot (Unix time): mid exposure of its first frame with a laser on; for a plain image, the "
            "modification time of the file.",
            null=nan,
        ),
    ]
    pose_stamp_s: Annotated[
        float,
        Key("The instant at which pose and velocity hold; null without a pose, or if it was not determined.", null=nan),
    ] = nan
    frame: Annotated[
        PoseFrame,
        Key("The frame of the vectors, angles and covariances in `pose` and `velocity`.", needed=True),
    ] = PoseFrame.CAMERA
    reason: Annotated[
        str | None,
        Key("Why there is no pose, or which measurement of a pose contradicts the others, as a sentence; else null."),
    ] = None
    flags: Annotated[PoseFlag, Key("Limitations, with any status; see below.", needed=True)] = PoseFlag(0)
    pose: Annotated[
        RingPose | None, Key("See below; null if not even the ring's plane and a grasp point are determined.")
    ]
    velocity: Annotated[
        RingVelocity | None, Key("Velocity of the ring; null if the target is assumed to be still.")
    ] = None
    protection: Annotated[
        Protection | None,
        Key(
            "How far the pose may be off, see below; null without a pose, and for methods other than `ml`.", added=True
        ),
    ] = None
    budget: Annotated[
        Mapping[str, Annotated[Mapping[str, Annotated[float, Key()]], Key()]],
        Key(
            "With `--budget`: the variance of each quantity by source. Quantities: `grasp_normal_m2`, "
            "`grasp_radial_m2`, `normal_rad2` (of both tilts together), `center_x_m2`, `center_y_m2`, `center_z_m2`. "
            "Sources: `image_noise`, `rig_calibration`, `stability`, `radius_prior`, `form`, `motion`, `mount`, "
            "`clock`, `weak_prior` (of what the shot leaves open), `second_order` (of the centre), `contradiction` "
            "(what an inconsistent shot adds). They add up to the variance in `covariance`.",
            presence=Presence.IF_KNOWN,
        ),
    ] = field(default_factory=dict)
    measurement: Annotated[
        RingMeasurement | None,
        Key(
            "The information of this shot alone, see below; null if there is none, missing with `--brief`.",
            presence=Presence.NOT_BRIEF,
        ),
    ] = None
    plane_evidence: Annotated[
        PlaneEvidence | None,
        Key(
            "What the shot shows about errors of the rig, also where its stripes contradict one ring; null where it "
            "shows nothing, missing with `--brief`.",
            presence=Presence.NOT_BRIEF,
        ),
    ] = None
    priors: Annotated[
        Priors | None, Key("What the pose assumes besides the shot, see below; null if nothing was estimated.")
    ] = None
    lasers: Annotated[
        Mapping[str, Annotated[LaserState, Key(grows=True)]],
        Key(
            "For each laser, by name, what its stripe contributed: `used`; `interrupted` (used, with a gap between its "
            "ends, as by a bolt or a cable, or with an end at something that stands on the face); `partly` (a break "
            "point that should be in view was rejected or not found); `rejected`; `not_seen` (the stripe should be in "
            "view but was not found); `out_of_view` (by rig and ring it lies outside the image, which is no fault).",
        ),
    ] = field(default_factory=dict)
    rejected: Annotated[
        tuple[Rejection, ...],
        Key("Measurements that contradict the others and were not used."),
    ] = ()
    rig_health: Annotated[
        Mapping[str, Annotated[float, Key(null=nan)]],
        Key(
            "For each laser, by name, the estimated error of its light plane over about the last fifty shots, in "
            "standard deviations of the estimate from one shot; null where the shots do not determine it, empty for "
            "methods that do not estimate it. Values up to about 1 are normal; over 3, the plane or the camera has "
            "moved.",
            earlier="laser_health",
        ),
    ] = field(default_factory=dict)
    shots_dropped: Annotated[
        int,
        Key(
            "Number of shots that were dropped between the previous pose line and this one, because a newer shot was "
            "available; 0 if shots are read from files.",
            least=0,
            earlier="dropped",
        ),
    ] = 0
    latency_s: Annotated[
        float,
        Key(
            "Time from the shot (or detection) in memory to its pose; for a live camera it includes the time spent "
            "waiting.",
            null=nan,
            least=0.0,
        ),
    ] = nan
    stage_s: Annotated[
        Mapping[str, Annotated[float, Key(null=nan, least=0.0)]],
        Key("Duration of each stage of the computation, by name."),
    ] = field(default_factory=dict)
    lines_skipped: Annotated[
        int | None,
        Key(
            "With `--newest`: number of lines between the previous one and this one that were not written, because the "
            "reader was slow.",
            least=0,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    rig: Annotated[str, Key("SHA-256 of the rig file.", null="", pattern="^[0-9a-f]{64}$")] = ""

    @property
    def status(
        self,
    ) -> Annotated[
        Status,
        Key(
            "`none`: no pose; `ok`: a pose for which every stripe, break point and visible edge that should be in "
            "view was used and agreed, with no flag but `radius_unverified`, `rig_unchecked` and `ghost_removed`; "
            "`degraded`: any other pose.",
            after="frame",
        ),
    ]:
        """See `status_of`."""
        return status_of(self.pose, self.flags)

    @property
    def without_times(self) -> "PoseLine":
        """The line without durations, which differ from run to run."""
        return replace(self, latency_s=nan, stage_s={})

    @property
    def flag_names(self) -> tuple[str, ...]:
        """Names of the flags, in lower case."""
        return names_of(self.flags)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingPoints:
    """Triangulated break points on the two edges of the ring's face, camera frame; NaN where one was not measured."""

    position_m: Float64[Array, "laser edge=2 xyz=3"]

    @property
    def seen(self) -> Bool[Array, "laser edge=2"]:
        """Mask of the break points that were measured."""
        seen: Bool[Array, "laser edge=2"] = ~(self.position_m != self.position_m).any(axis=-1)
        return seen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnownRadii:
    """Prior of the radii of the ring's edges."""

    radius_m: Float64[Array, "edge=2"]
    """NaN for an edge without a prior."""
    sd_m: Float64[Array, "edge=2"]
    """Standard deviations."""
    tolerance_m: float | None = None
    """Tolerance of the ring's form by a catalogue; None if it states none, or the user states another one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ring:
    """An entry of a catalogue, with radii as intervals: real ones differ from nominal ones by millimetres."""

    name: str
    radius_inner_m: tuple[float, float]
    """Lower and upper limit."""
    radius_outer_m: tuple[float, float]
    source: str = ""
    tolerance_m: float | None = None
    """Standard deviation of the edges from circles, and of the face from a plane."""

    @property
    def known_radii(self) -> KnownRadii:
        """Mean and standard deviation of a uniform distribution over each interval."""
        intervals = np.array([self.radius_inner_m, self.radius_outer_m])
        return KnownRadii(
            radius_m=intervals.mean(axis=1), sd_m=np.ptp(intervals, axis=1) / np.sqrt(12), tolerance_m=self.tolerance_m
        )
