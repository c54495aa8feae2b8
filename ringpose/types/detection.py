"""Results of the detection in one shot: stripe centres, line segments, break points and visible edges of the ring.

A break point is the endpoint of a laser stripe on the ring's face, at its inner or outer edge.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum, IntFlag
from typing import Annotated, Any, Literal

import numpy as np

from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.record import Form, Key, Presence

MAX_SIGMA_PX = 1e4
"""Largest standard deviation of a detected point: larger than an image, it is not a measurement. The detector does not
write a larger one, and readers reject it."""

MAX_OFFSET = {"position_px": 1.0, "face_start_undistorted_px": 10.0, "face_end_undistorted_px": 10.0}
"""Maximum distance of a measured point outside the image, in image sizes (undistorted wide images are larger). The
detector does not write a point beyond, and readers reject it."""


class BreakPointFlag(IntFlag):
    """Conditions that reduce the quality of a break point."""

    SATURATED = 1
    KINK = 2
    """The stripe continues beyond the edge, in another direction."""
    CLIPPED = 4
    """The stripe leaves the image before its edge."""
    OCCLUDED = 8
    """The end does not lie on the circle of the others: the edge is occluded."""
    EDGE_UNKNOWN = 16
    """Inner and outer edge could not be distinguished: the ring's centre may lie on either side."""
    BLUNT = 32
    """The stripe fades over more columns than the optical blur explains: a rounded or chamfered edge."""
    UNCLEAR = 64
    """Low confidence: by noise, a glint or foil, the sigma exceeds 0.75 px (not counting that of a chamfer). An end
    that could not be measured, as where its columns are saturated, has this flag and no position."""
    BESIDE_OCCLUDER = 128
    """A stripe of the same laser on a surface in front of the face begins beside the end, which may be occluded."""
    INTERRUPTED = 256
    """The stripe has a gap of 10 columns or more between its ends, or an end at something that stands on the face:
    something stands on it, over it, or is missing from it."""
    SEVERAL_FACES = 512
    """Another face is at the same height about the same axis: which one is the ring's, or whether both are, is open."""


class NoBreakPoints(Enum):
    """Reason why a shot has no break points; the value is the message for the user."""

    NO_LASER_FRAME = "no frame has a laser on"
    IMAGE_DARK = "the image is dark: no stripe stands out of the noise"
    IMAGE_SATURATED = "the image is saturated: no stripe stands out"
    HIDDEN_BY_SATURATION = "the ambient light saturates where the stripes end; they may go on: reduce the exposure"
    NO_STRIPE = "no laser stripe found"
    NO_RING = "stripes found, but none of them looks like a stripe on the ring's face"
    SURFACE_IN_FRONT = "the stripes fit a ring, but another is on a flat surface in front of it, which may be its face"
    STRAIGHT_EDGES = "the stripes end on straight edges, as on a bar or a plate: no ring"
    CONTRADICTED_MASKS = "the stripes fit a ring only if assigned to other lasers than by the masks; check the wiring"
    CONTRADICTED_RIG = "most stripes would lie behind the camera; the images are of another rig, or upside down"
    AMBIGUOUS_LABELS = "the stripes fit the lasers in more than one way; switch the lasers one by one"
    UPSIDE_DOWN = "the stripes fit a ring if the image is upside down or mirrored; see the camera's flip, and its mount"
    DARK_FRAME_LIT = "a laser is seen in the frame that should be dark; see whether frames and masks have one order"
    AMBIENT_CHANGED = "ambient light changed within the shot, so that its frames cannot be compared"
    NOT_SOUGHT = "break points were not searched for"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BreakPoints:
    """Endpoints of the stripes on the ring's face, in (distorted) pixels; NaN where one was not measured."""

    position_px: Annotated[
        Float64[Array, "laser edge=2 xy=2"],
        Key(
            "Null where the stripe's end was not seen, or where its uncertainty exceeds the columns of the fit (10.4 "
            "px, flag 64), as next to a saturated glint. At most one image width or height outside the image.",
            gaps=True,
            form=Form.POINTS,
        ),
    ]
    covariance_px2: Annotated[
        Float64[Array, "laser edge=2 xy=2 xy=2"],
        Key("Covariance, 2 x 2; standard deviations are at most 10000 px.", gaps=True, form=Form.COVARIANCES),
    ]
    flags: Annotated[
        Int64[Array, "laser edge=2"],
        Key(
            "A sum of 1 (saturated), 2 (the stripe continues beyond the edge at another angle), 4 (it leaves the image "
            "before the edge), 8 (the edge is occluded), 16 (inner and outer edge could not be distinguished), 32 (the "
            "stripe fades more slowly than by the optical blur, as on a chamfer; the covariance includes the unknown "
            "position of the sharp edge), 64 (its standard deviation exceeds 0.75 px because of noise, a glint or "
            "foil, or it could not be measured: null), 128 (a stripe of the same laser on a surface in front of the "
            "face begins beside the end, which may be occluded), 256 (the stripe has a gap between its ends: a bolt, a "
            "cable, a piece of the face that is missing), 512 (another face is at the same height about the same "
            "axis: which one is the ring's is open).",
            least=0,
        ),
    ]
    face_start_undistorted_px: Annotated[
        Float64[Array, "laser xy=2"],
        Key(
            "Start of the stripe's straight line on the ring's face, in pixels of the same camera without distortion; "
            "null where the stripe was not found.",
            name="face_start_px",
            gaps=True,
            form=Form.POINTS,
        ),
    ]
    face_end_undistorted_px: Annotated[
        Float64[Array, "laser xy=2"], Key("End of that line.", name="face_end_px", gaps=True, form=Form.POINTS)
    ]
    face_sigma_px: Annotated[
        Float64[Array, "laser end=2"],
        Key("Standard deviation perpendicular to that line, at its start and at its end.", gaps=True, form=Form.SIGMAS),
    ]
    labelled: Annotated[
        bool,
        Key("Whether the assignment to lasers is known from switched lasers; false if it was estimated."),
    ]
    stamp_s: Annotated[
        Float64[Array, "laser"] | None,
        Key(
            "Mid exposure of the frame of each laser's stripe; null where it was not found, or if it is unknown.",
            gaps=True,
        ),
    ] = None
    repeated: "BreakPoints | None" = None
    """The break points in a frame with several lasers on, at another time; NaN where one was not measured again."""
    opposite: "BreakPoints | None" = None
    """The break points on the opposite arc of the ring, in the same frames; None if one arc was seen. A stripe that
    passes beside the hole has its line here or there, not twice."""

    @property
    def arcs(self) -> tuple["BreakPoints", ...]:
        """The break points on each arc that was seen."""
        return (self,) if self.opposite is None else (self, self.opposite)

    def arcs_exchanged(self) -> "BreakPoints":
        """The break points described from the opposite arc, without those measured again, which are on this arc."""
        if self.opposite is None:
            return self
        return replace(self.opposite, opposite=replace(self, opposite=None, repeated=None))

    def from_arc_near(self, place_px: tuple[float, float]) -> "BreakPoints":
        """The break points described from the arc that is nearer to a place in the (distorted) image."""
        off_px = [
            float(np.linalg.norm(arc.position_px[arc.seen].mean(axis=0) - place_px)) if arc.seen.any() else math.inf
            for arc in self.arcs
        ]
        return self.arcs_exchanged() if len(off_px) > 1 and off_px[1] < off_px[0] else self

    @property
    def seen(self) -> Bool[Array, "laser edge=2"]:
        """Mask of the break points that were measured."""
        seen: Bool[Array, "laser edge=2"] = ~np.isnan(self.position_px[..., 0])
        return seen

    @property
    def of_lasers(self) -> Bool[Array, "laser"]:
        """The lasers of which a break point or a line on the face was measured."""
        lasers: Bool[Array, "laser"] = self.seen.any(axis=1) | ~np.isnan(self.face_start_undistorted_px[:, 0])
        return lasers

    def without(self, ends: Bool[Array, "laser edge=2"], lines: Bool[Array, "laser"]) -> "BreakPoints":
        """The break points without some ends of stripes and without the lines of some lasers' stripes."""
        return replace(
            self,
            position_px=np.where(ends[..., None], np.nan, self.position_px),
            covariance_px2=np.where(ends[..., None, None], np.nan, self.covariance_px2),
            face_start_undistorted_px=np.where(lines[:, None], np.nan, self.face_start_undistorted_px),
            face_end_undistorted_px=np.where(lines[:, None], np.nan, self.face_end_undistorted_px),
            face_sigma_px=np.where(lines[:, None], np.nan, self.face_sigma_px),
        )

    def with_edges_exchanged(self) -> "BreakPoints":
        """The break points with inner edges taken for outer ones and the reverse."""
        return replace(
            self,
            position_px=self.position_px[:, ::-1],
            covariance_px2=self.covariance_px2[:, ::-1],
            flags=self.flags[:, ::-1],
            repeated=None if self.repeated is None else self.repeated.with_edges_exchanged(),
            opposite=None if self.opposite is None else self.opposite.with_edges_exchanged(),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingEdgePoints:
    """Points of the ring's visible edges between the stripes, in (distorted) pixels."""

    position_px: Annotated[Float64[Array, "point xy=2"], Key("Position.")]
    normal: Annotated[
        Float64[Array, "point xy=2"],
        Key(
            "Unit normal of the edge in the image: the direction in which the position was measured.",
            form=Form.DIRECTIONS,
        ),
    ]
    sigma_px: Annotated[Float64[Array, "point"], Key("Standard deviation along that normal.", form=Form.SIGMAS)]
    edge: Annotated[Int64[Array, "point"], Key("0 inner, 1 outer.")]
    stamp_s: Annotated[Float64[Array, "point"] | None, Key("Mid exposure of the frame; null if it is unknown.")] = None

    @property
    def contradiction(self) -> tuple[str, str] | None:
        """The key and the finding of values that are impossible; None if they are not."""
        if np.isin(self.edge, (0, 1)).all():
            return None
        return "edge", "has a value other than 0 (inner) and 1 (outer)"


def outside_image(
    position_px: Float64[Array, "*shape xy=2"], max_offset: float, image_width: int, image_height: int
) -> Bool[Array, "*shape"]:
    """Which points are more than `max_offset` image sizes outside the image; false for NaN."""
    size_px = np.array([image_width, image_height], dtype=np.float64)
    outside = (position_px < -max_offset * size_px) | (position_px > (1 + max_offset) * size_px)
    return np.asarray(outside.any(axis=-1))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stripes:
    """Sub-pixel centres of the stripes of one shot, in (distorted) pixels, sorted by piece, then column."""

    position_px: Annotated[Float64[Array, "center xy=2"], Key("Position.")]
    sigma_px: Annotated[Float64[Array, "center"], Key("Standard deviation along the column.", gaps=True)]
    peak_dn: Annotated[Float64[Array, "center"], Key("Grey value over the background.", gaps=True)]
    piece: Annotated[
        Int64[Array, "center"],
        Key("Number of the piece that a centre belongs to, from 0: centres linked along x without a gap.", least=0),
    ]
    laser: Annotated[Int64[Array, "piece"], Key("Number of each piece's laser, from 0; -1 if it is unknown.", least=-1)]
    stamp_s: Annotated[
        Float64[Array, "piece"] | None, Key("Mid exposure of each piece's frame; null if it is unknown.")
    ] = None

    @property
    def contradiction(self) -> tuple[str, str] | None:
        """The key and the finding of values that contradict each other; None if they do not."""
        if self.piece.max(initial=-1) < len(self.laser):
            return None
        return "piece", f"has an index out of range: there are {len(self.laser)} pieces"

    def without(self, dropped: Bool[Array, "center"]) -> "Stripes":
        """The stripes without some centres, and without the pieces of which none is left."""
        pieces, piece = np.unique(self.piece[~dropped], return_inverse=True)
        return replace(
            self,
            position_px=self.position_px[~dropped],
            sigma_px=self.sigma_px[~dropped],
            peak_dn=self.peak_dn[~dropped],
            piece=piece,
            laser=self.laser[pieces],
            stamp_s=None if self.stamp_s is None else self.stamp_s[pieces],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Segments:
    """Line segments of one image, in (distorted) pixels."""

    start_px: Annotated[Float64[Array, "segment xy=2"], Key("Start.")]
    end_px: Annotated[Float64[Array, "segment xy=2"], Key("End.")]
    support: Annotated[Int64[Array, "segment"], Key("Number of edge pixels in the support region.", least=0)]
    stamp_s: Annotated[Float64[Array, "segment"] | None, Key("Mid exposure of the frame; null if it is unknown.")] = (
        None
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JudgedRing:
    """The ring that explains the break points of a shot, to some hundredths of its standard deviations."""

    origin_m: Annotated[Float64[Array, "xyz=3"], Key("A point on the middle of its face, camera frame.")]
    axes: Annotated[
        Float64[Array, "3 xyz=3"],
        Key(
            "Unit vectors there: towards the centre, along the face, and the normal towards the camera.",
            form=Form.ORTHONORMAL,
        ),
    ]
    curvature_per_m: Annotated[float, Key("Inverse of the mean radius.")]
    half_band_m: Annotated[float, Key("Half of the outer minus the inner radius.")]
    velocity_m_s: Annotated[Float64[Array, "xyz=3"], Key("Velocity of the centre.")]
    rate_rad_s: Annotated[Float64[Array, "xyz=3"], Key("Angular velocity across the normal.")]
    stamp_s: Annotated[float | None, Key("Instant at which the ring is there; null if the frames have no stamps.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rejection:
    """A measurement that was not used because it contradicts the others."""

    what: Annotated[Literal["point", "stripe", "edge", "assignment", "radius"], Key("What was rejected.", grows=True)]
    laser: Annotated[str | None, Key("Null where it does not apply.")] = None
    edge: Annotated[Literal["inner", "outer"] | None, Key("Null where it does not apply.")] = None
    opposite: Annotated[
        bool, Key("Whether it is on the arc of the ring that is opposite to the grasp point.", added=True)
    ] = False
    chi2: Annotated[float, Key("By how much it reduces chi-squared; null if that was not computed.", null=math.nan)] = (
        math.nan
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class SubtractedGhost:
    """A fainter copy of the laser light of a frame, some rows beside it, that was subtracted."""

    offset_px: Annotated[float, Key("Row of the copy less that of the light; column where stripes run along columns.")]
    ratio: Annotated[float, Key("Brightness of the copy over that of the light.", least=0.0, most=1.0)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Detection:
    """Everything that was detected in one shot."""

    software: Annotated[str, Key("Program and version that wrote the record.", null="", added=True)] = ""
    shot: Annotated[str, Key("As in the pose line.")]
    stamp_s: Annotated[float, Key("As in the pose line.", null=math.nan)]
    lasers_on: Annotated[
        Bool[Array, "laser"] | None,
        Key("For each laser of the rig, whether it was on in at least one frame; null if it is unknown."),
    ] = None
    still: Annotated[bool, Key("Whether the shot states that the target was held still.", added=True)] = False
    ambient_changed: Annotated[
        bool, Key("Whether the shot states that ambient light changed within it.", added=True)
    ] = False
    advice: Annotated[
        str,
        Key("What would improve the shot, such as a shorter exposure; may be empty.", blank=True, added=True),
    ] = ""
    break_points: BreakPoints | NoBreakPoints
    ring_edges: Annotated[
        RingEdgePoints | None,
        Key(
            "Points of the ring's visible edges between and beyond the stripes, measured in the frame without lasers "
            "if there is one; null if no edge was found."
        ),
    ] = None
    ring: Annotated[
        JudgedRing | None,
        Key(
            "The ring that explains the break points, near which `ringpose pose` seeks the one of all measurements; "
            "null if several do, or none.",
            added=True,
        ),
    ] = None
    rejected: Annotated[
        tuple[Rejection, ...],
        Key("Measurements that contradict the others and were not used, as in the pose line."),
    ] = ()
    ghosts: Annotated[
        tuple[SubtractedGhost, ...],
        Key("Fainter copies of the stripes that were subtracted from the frames, one for each frame.", added=True),
    ] = ()
    rig: Annotated[
        str,
        Key(
            "SHA-256 of the rig file; null if it is unknown, as of simulated detections. `ringpose pose` rejects a "
            "detection of another rig.",
            null="",
            pattern="^[0-9a-f]{64}$",
            added=True,
        ),
    ] = ""
    stripes: Annotated[
        Stripes | None,
        Key(
            "Centres of the laser stripes, column by column, sorted by piece; only with `--full`, and in NPZ files.",
            presence=Presence.NOT_BRIEF,
        ),
    ] = None
    segments: Annotated[
        Segments | None,
        Key("Straight segments; only with `--full`, and in NPZ files.", presence=Presence.NOT_BRIEF),
    ] = None

    @classmethod
    def from_record(
        cls,
        reason: str | None,
        measured: BreakPoints | None,
        repeated: BreakPoints | None,
        opposite: BreakPoints | None = None,
        **keys: Any,
    ) -> "Detection":
        """The detection of a record, which has either a known reason or break points."""
        points = NoBreakPoints(reason) if measured is None else replace(measured, repeated=repeated, opposite=opposite)
        return cls(break_points=points, **keys)

    @property
    def reason(
        self,
    ) -> Annotated[
        str | None,
        Key("Why there are no break points, as a sentence; else null.", after="stamp_s", is_read=True),
    ]:
        """None if there are break points."""
        return str(self.break_points.value) if isinstance(self.break_points, NoBreakPoints) else None

    @property
    def measured(
        self,
    ) -> Annotated[
        BreakPoints | None,
        Key("See below; null if there are none.", name="break_points", after="advice", is_read=True),
    ]:
        """The break points; None if there are none."""
        return self.break_points if isinstance(self.break_points, BreakPoints) else None

    @property
    def repeated(
        self,
    ) -> Annotated[
        BreakPoints | None,
        Key(
            "The same as `break_points`, measured in a frame with several lasers on that a shot has beside one frame "
            "for each laser; null without such a frame. As its time differs, it shows a motion within the shot.",
            after="break_points",
            is_read=True,
            added=True,
        ),
    ]:
        """See `BreakPoints`."""
        return None if self.measured is None else self.measured.repeated

    @property
    def opposite(
        self,
    ) -> Annotated[
        BreakPoints | None,
        Key(
            "The same as `break_points` for the ends on the opposite arc of the ring, if the shot shows both; null "
            "otherwise. A stripe that passes beside the hole has one outer end here and one there.",
            after="repeated",
            is_read=True,
            added=True,
        ),
    ]:
        """See `BreakPoints`."""
        return None if self.measured is None else self.measured.opposite

    @property
    def contradiction(self) -> tuple[str, str] | None:
        """The key and the finding of values that contradict each other; None if they do not."""
        lasers = None if self.measured is None else len(self.measured.position_px)
        counts = {
            "lasers_on": self.lasers_on,
            "repeated": None if self.repeated is None else self.repeated.flags,
            "opposite": None if self.opposite is None else self.opposite.flags,
        }
        for key, of_lasers in counts.items():
            if lasers is not None and of_lasers is not None and len(of_lasers) != lasers:
                return key, f"has {len(of_lasers)} lasers, break_points has {lasers}"
        return None

    @property
    def found(self) -> bool:
        """Whether there are break points."""
        return isinstance(self.break_points, BreakPoints)

    @property
    def summary(self) -> str:
        """The result in a few words."""
        if self.break_points is NoBreakPoints.NOT_SOUGHT:
            return f"{0 if self.segments is None else len(self.segments.support)} segments"
        if isinstance(self.break_points, NoBreakPoints):
            return str(self.break_points.value)
        return f"{int(self.break_points.seen.sum())} break points"


UNLABELLED = -1
"""Laser of a stripe piece that is not assigned to a laser."""


def joined_stripes(parts: Sequence[Stripes]) -> Stripes:
    """Stripes of several frames or windows in one record, with consecutive piece indices."""
    before = np.cumsum([0, *(len(part.laser) for part in parts[:-1])])
    return Stripes(
        position_px=np.concatenate([part.position_px for part in parts]),
        sigma_px=np.concatenate([part.sigma_px for part in parts]),
        peak_dn=np.concatenate([part.peak_dn for part in parts]),
        piece=np.concatenate([part.piece + start for part, start in zip(parts, before, strict=True)]),
        laser=np.concatenate([part.laser for part in parts]),
        stamp_s=np.concatenate([stamps_of(part) for part in parts]),
    )


def joined_edge_points(parts: Sequence[RingEdgePoints]) -> RingEdgePoints:
    """Points of the ring's edges in several frames in one record, each with its stamp."""
    return RingEdgePoints(
        position_px=np.concatenate([part.position_px for part in parts]),
        normal=np.concatenate([part.normal for part in parts]),
        sigma_px=np.concatenate([part.sigma_px for part in parts]),
        edge=np.concatenate([part.edge for part in parts]),
        stamp_s=np.concatenate([stamps_of(part) for part in parts]),
    )


def stamps_of(part: Stripes | Segments | RingEdgePoints) -> Float64[Array, "n"]:
    """The time stamps of a record's features; NaN if they are unknown."""
    if part.stamp_s is not None:
        return part.stamp_s
    features = part.laser if isinstance(part, Stripes) else part.support if isinstance(part, Segments) else part.edge
    return np.full(len(features), np.nan)
