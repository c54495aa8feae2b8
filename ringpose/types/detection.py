"""Where the stripes on the ring's face end.

The laser stripes' centres, column by column.

Straight line segments in an image.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, IntFlag

import numpy as np

from ringpose.types.arrays import Array, Bool, Float64, Int64

MAX_SIGMA_PX = 1e4
"""Largest standard deviation of a detection, in pixels: what is known worse than an image is large is not measured.
The detector writes no larger one, and readers refuse it."""

MAX_OFFSET = {"position_px": 1.0, "face_start_px": 10.0, "face_end_px": 10.0}
"""How far beside the image a measured point may lie, in image sizes: lens distortion removed, a wide image is wider.
The detector writes no point beyond, and readers refuse it."""


class BreakPointFlag(IntFlag):
    """What makes a break point less than a clean end of a clean stripe."""

    SATURATED = 1
    KINK = 2
    """The stripe runs on beyond the edge, at another angle."""
    CLIPPED = 4
    """The stripe leaves the image before its edge."""
    OCCLUDED = 8
    """Its end does not lie on the circle of the others: something hides the edge."""
    EDGE_UNKNOWN = 16
    """Inner and outer edge could not be told apart: the ring's centre may lie on either side."""
    BLUNT = 32
    """The stripe fades over more columns than optics blur: the sharp edge lies somewhere in a chamfer."""
    UNCLEAR = 64
    """Noise, a glint or foil about the end leaves its place open: its sigma is over 0.75 px, a chamfer aside.
    An end that is not measured at all, its columns being saturated, say, has this flag and no position."""


class NoBreakPoints(Enum):
    """Why a shot has no break points; the value is the sentence the user reads."""

    NO_LASER_FRAME = "no frame has a laser on"
    IMAGE_DARK = "the image is dark: no stripe stands out of the noise"
    IMAGE_SATURATED = "the image is saturated: no stripe stands out"
    NO_STRIPE = "no laser stripe found"
    NO_RING = "stripes found, but no piece of one looks like the ring's face"
    CONTRADICTED_MASKS = "the stripes make one ring only under other lasers than the masks say; check the wiring"
    CONTRADICTED_RIG = "most stripes lie nowhere before the camera; the images are of another rig, or upside down"
    AMBIGUOUS_LABELS = "the stripes fit the lasers in more than one way; switch the lasers one by one"
    NOT_SOUGHT = "break points were not looked for"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BreakPoints:
    """Ends of the stripes on the ring's face, in (distorted) pixels; NaN where one was not seen."""

    position_px: Float64[Array, "laser edge=2 xy=2"]
    covariance_px2: Float64[Array, "laser edge=2 xy=2 xy=2"]
    flags: Int64[Array, "laser edge=2"]
    """Sums of `BreakPointFlag`."""
    face_start_px: Float64[Array, "laser xy=2"]
    """The stripe's line on the face, undistorted (still pixels), from ..."""
    face_end_px: Float64[Array, "laser xy=2"]
    """... to here; NaN where the laser's stripe on the face was not seen."""
    face_sigma_px: Float64[Array, "laser end=2"]
    """Standard deviation of that line across itself, at its start and at its end."""
    labelled: bool
    """True if switched frames gave the labels, False if the assignment that fits one ring best did."""

    @property
    def seen(self) -> Bool[Array, "laser edge=2"]:
        """Which of them were seen."""
        seen: Bool[Array, "laser edge=2"] = ~np.isnan(self.position_px[..., 0])
        return seen


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


def outside_image(
    position_px: Float64[Array, "*shape xy=2"], max_offset: float, image_width: int, image_height: int
) -> Bool[Array, "*shape"]:
    """Which points lie more than `max_offset` image sizes beside the image; NaN does not."""
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
    """Number of the piece, from 0: centres linked along x without a gap or a jump."""
    laser: Int64[Array, "piece"]
    """Laser of each piece, or `UNLABELLED`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Segments:
    """Line segments of one image, in (distorted) pixels."""

    start_px: Float64[Array, "segment xy=2"]
    end_px: Float64[Array, "segment xy=2"]
    support: Int64[Array, "segment"]
    """Number of edge pixels that the segment stands for."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Detection:
    """All that was found in one shot."""

    shot: str
    stamp_s: float
    break_points: BreakPoints | NoBreakPoints
    stripes: Stripes | None = None
    segments: Segments | None = None
    ring_edges: RingEdgePoints | None = None
    """None where the edges were not looked for or not seen."""

    @property
    def found(self) -> bool:
        """Whether there are break points."""
        return isinstance(self.break_points, BreakPoints)

    @property
    def summary(self) -> str:
        """What was found, in a few words."""
        if self.break_points is NoBreakPoints.NOT_SOUGHT:
            return f"{0 if self.segments is None else len(self.segments.support)} segments"
        if isinstance(self.break_points, NoBreakPoints):
            return str(self.break_points.value)
        return f"{int(self.break_points.seen.sum())} break points"


UNLABELLED = -1
"""Laser of a stripe piece whose laser is not known."""


def joined_stripes(parts: Sequence[Stripes]) -> Stripes:
    """Stripes of several frames or windows in one record, their pieces numbered on."""
    if len(parts) == 1:
        return parts[0]
    before = np.cumsum([0, *(len(part.laser) for part in parts[:-1])])
    return Stripes(
        position_px=np.concatenate([part.position_px for part in parts]),
        sigma_px=np.concatenate([part.sigma_px for part in parts]),
        peak_dn=np.concatenate([part.peak_dn for part in parts]),
        piece=np.concatenate([part.piece + start for part, start in zip(parts, before, strict=True)]),
        laser=np.concatenate([part.laser for part in parts]),
    )
