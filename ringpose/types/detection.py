"""Results of the detection in one shot: stripe centres, line segments, break points and visible edges of the ring.

A break point is the endpoint of a laser stripe on the ring's face, at its inner or outer edge.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum, IntFlag
from typing import Annotated, Literal

import numpy as np

from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.record import Key

MAX_SIGMA_PX = 1e4
"""Largest standard deviation of a detected point: larger than an image, it is not a measurement. The detector does not
write a larger one, and readers reject it."""

MAX_OFFSET = {"position_px": 1.0, "face_start_px": 10.0, "face_end_px": 10.0}
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

    position_px: Float64[Array, "laser edge=2 xy=2"]
    covariance_px2: Float64[Array, "laser edge=2 xy=2 xy=2"]
    flags: Int64[Array, "laser edge=2"]
    """Sums of `BreakPointFlag`."""
    face_start_px: Float64[Array, "laser xy=2"]
    """Start of the stripe's line on the face, in undistorted pixels; NaN where the stripe was not found."""
    face_end_px: Float64[Array, "laser xy=2"]
    """End of that line."""
    face_sigma_px: Float64[Array, "laser end=2"]
    """Standard deviation across that line, at its start and at its end."""
    labelled: bool
    """True if the lasers were switched one by one; False if the stripes were assigned by the best fit of a ring."""
    stamp_s: Float64[Array, "laser"] | None = None
    """Mid exposure of the frame that shows each laser's stripe; NaN where it was not found, None if unknown."""
    repeated: "BreakPoints | None" = None
    """The break points in a frame with several lasers on, at another time; NaN where one was not measured again."""

    @property
    def seen(self) -> Bool[Array, "laser edge=2"]:
        """Mask of the break points that were measured."""
        seen: Bool[Array, "laser edge=2"] = ~np.isnan(self.position_px[..., 0])
        return seen

    @property
    def of_lasers(self) -> Bool[Array, "laser"]:
        """The lasers of which a break point or a line on the face was measured."""
        lasers: Bool[Array, "laser"] = self.seen.any(axis=1) | ~np.isnan(self.face_start_px[:, 0])
        return lasers

    def without(self, ends: Bool[Array, "laser edge=2"], lines: Bool[Array, "laser"]) -> "BreakPoints":
        """The break points without some ends of stripes and without the lines of some lasers' stripes."""
        return replace(
            self,
            position_px=np.where(ends[..., None], np.nan, self.position_px),
            covariance_px2=np.where(ends[..., None, None], np.nan, self.covariance_px2),
            face_start_px=np.where(lines[:, None], np.nan, self.face_start_px),
            face_end_px=np.where(lines[:, None], np.nan, self.face_end_px),
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
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingEdgePoints:
    """Points of the ring's visible edges between the stripes, in (distorted) pixels."""

    position_px: Float64[Array, "point xy=2"]
    normal: Float64[Array, "point xy=2"]
    """Unit normal of the edge in the image: the direction in which the position was measured."""
    sigma_px: Float64[Array, "point"]
    """Standard deviation along that normal."""
    edge: Int64[Array, "point"]
    """0 for the inner edge, 1 for the outer (order of `EDGES`)."""
    stamp_s: Float64[Array, "point"] | None = None
    """Mid exposure of the frame in which each point was measured; None if unknown."""


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

    position_px: Float64[Array, "center xy=2"]
    sigma_px: Float64[Array, "center"]
    """Standard deviation along the column."""
    peak_dn: Float64[Array, "center"]
    piece: Int64[Array, "center"]
    """Index of the piece, from 0: centres linked along x without a gap or a jump."""
    laser: Int64[Array, "piece"]
    """Laser of each piece, or `UNLABELLED`."""
    stamp_s: Float64[Array, "piece"] | None = None
    """Mid exposure of each piece's frame; None if unknown."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Segments:
    """Line segments of one image, in (distorted) pixels."""

    start_px: Float64[Array, "segment xy=2"]
    end_px: Float64[Array, "segment xy=2"]
    support: Int64[Array, "segment"]
    """Number of edge pixels in the support region of the segment."""
    stamp_s: Float64[Array, "segment"] | None = None
    """Mid exposure of each segment's frame; None if unknown."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JudgedRing:
    """The ring that explains the break points of a shot, to some hundredths of its standard deviations."""

    origin_m: Float64[Array, "xyz=3"]
    """A point on the middle of its face, camera frame."""
    axes: Float64[Array, "3 xyz=3"]
    """Unit vectors there: towards the centre, along the face, and the normal towards the camera."""
    curvature_per_m: float
    """Inverse of the mean radius."""
    half_band_m: float
    """Half of the outer minus the inner radius."""
    velocity_m_s: Float64[Array, "xyz=3"]
    """Velocity of the centre."""
    rate_rad_s: Float64[Array, "xyz=3"]
    """Angular velocity across the normal."""
    stamp_s: float | None
    """Instant at which the ring is there; None if the frames have no stamps."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rejection:
    """A measurement that was not used because it contradicts the others."""

    what: Annotated[Literal["point", "stripe", "edge", "assignment", "radius"], Key("What was rejected.", grows=True)]
    laser: Annotated[str | None, Key("Null where it does not apply.")] = None
    edge: Annotated[Literal["inner", "outer"] | None, Key("Null where it does not apply.")] = None
    chi2: Annotated[float, Key("By how much it reduces chi-squared; null if that was not computed.", null=math.nan)] = (
        math.nan
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Detection:
    """Everything that was detected in one shot."""

    shot: str
    stamp_s: float
    break_points: BreakPoints | NoBreakPoints
    stripes: Stripes | None = None
    segments: Segments | None = None
    ring_edges: RingEdgePoints | None = None
    """None where the edges were not searched for or not found."""
    ring: JudgedRing | None = None
    """Where the estimation of the pose starts; None if several rings explain the break points, or none does."""
    lasers_on: Bool[Array, "laser"] | None = None
    """Which lasers of the rig were on in at least one frame; None if unknown."""
    rejected: tuple[Rejection, ...] = ()
    """Measurements that the detector did not use because they contradict the others."""
    still: bool = False
    """Whether the target was held still while the shot was taken, as the shot states."""
    ambient_changed: bool = False
    """Whether ambient light changed within the shot, as the shot states."""
    advice: str = ""
    """What would improve the shot, such as a shorter exposure; empty if nothing is known."""
    rig: str = ""
    """SHA-256 of the rig file with which the break points were found; empty if unknown."""

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
