"""Errors of detected segments on synthetic stripes, and their recall on photographs with annotated lines.

A stripe has two edges; for a detector of edges its centre line is the mean of the two. All figures are of straight
pieces (`stripe_rig(lens=False)`), in pixels.
"""

import math
from dataclasses import dataclass

import numpy as np
from benchmarks.stripe_images import StripeImage

from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.detection import Segments

COVERED = 0.8
"""A piece is recalled if a segment on it crosses more than this share of its columns."""

MAX_ANGLE_RAD = math.radians(10)
"""A segment belongs to a piece if the angle between them is not larger; the direction of short ones is noisy,"""

MAX_DISTANCE_SIGMAS, MAX_DISTANCE_PX = 2.0, 2.0
"""if its midpoint is within this many standard deviations of the stripe plus this many pixels of the centre line (edges
lie at one standard deviation, those of saturated stripes at nearly two),"""

END_MARGIN_PX = 4.0
"""and if its midpoint is not farther beyond an end of the piece."""

LINE_MAX_ANGLE_RAD = math.radians(5)
"""Maximum angle between a segment and an annotated line that it covers."""

LINE_END_MARGIN_PX = 1.0
"""A segment also covers this much of an annotated line beyond its ends."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StripeErrors:
    """Errors of the segments on the pieces of one or more images."""

    coverage: Float64[Array, "piece"]
    """Share of the piece's columns that a segment of the piece crosses, along either edge."""
    segments: Float64[Array, "piece"]
    """Segments on each line of the piece (two edges, or one centre): 1 if it is unbroken."""
    center_px: Float64[Array, "column"]
    """Row of the centre line minus the true row, in each column with both edges, or a centre."""
    short_px: Float64[Array, "end"]
    """How far the ends of the recalled pieces stop short of the true ones; negative beyond them."""
    false: int
    """Segments that belong to no piece."""


def stripe_errors(segments: Segments, image: StripeImage, centers: bool) -> StripeErrors:
    """Errors on an image without lens distortion; `centers` states that segments run along centres, not along edges."""
    left, right = _left_to_right(segments)
    pieces = [_PieceLine(ends, image.stripe_sigma_px) for ends in image.pieces_px]
    belongs = np.array([piece.members(left, right) for piece in pieces])
    parts = [_piece_errors(piece, left[own], right[own], centers) for piece, own in zip(pieces, belongs, strict=True)]
    return StripeErrors(
        coverage=np.array([part.coverage for part in parts]),
        segments=belongs.sum(axis=1) / (1.0 if centers else 2.0),
        center_px=np.concatenate([part.center_px for part in parts]),
        short_px=np.concatenate([part.short_px for part in parts]),
        false=int(len(left) - belongs.any(axis=0).sum()),
    )


class _PieceLine:
    """The straight centre line of a piece."""

    def __init__(self, ends_px: Float64[Array, "end=2 xy=2"], sigma_px: float) -> None:
        self.first, self.last = float(ends_px[0, 0]), float(ends_px[1, 0])
        self.slope = float((ends_px[1, 1] - ends_px[0, 1]) / (self.last - self.first))
        self.row = float(ends_px[0, 1])
        self.max_distance_px = MAX_DISTANCE_SIGMAS * sigma_px + MAX_DISTANCE_PX
        self.columns = np.arange(math.ceil(self.first), math.floor(self.last) + 1, dtype=np.float64)

    def rows(self, x: Float64[Array, "*n"]) -> Float64[Array, "*n"]:
        return self.row + self.slope * (x - self.first)

    def members(self, left: Float64[Array, "n xy=2"], right: Float64[Array, "n xy=2"]) -> Bool[Array, "n"]:
        """Which segments belong to the piece."""
        along, down = (right - left).T
        turned = np.arctan2(down, along) - math.atan(self.slope)
        middle = (left + right) / 2
        beside = (self.first - END_MARGIN_PX <= middle[:, 0]) & (middle[:, 0] <= self.last + END_MARGIN_PX)
        near = np.abs(middle[:, 1] - self.rows(middle[:, 0])) <= self.max_distance_px
        belongs: Bool[Array, "n"] = (np.abs(turned) <= MAX_ANGLE_RAD) & beside & near
        return belongs


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _PieceErrors:
    coverage: float
    center_px: Float64[Array, "column"]
    short_px: Float64[Array, "end"]


def _piece_errors(
    piece: _PieceLine, left: Float64[Array, "n xy=2"], right: Float64[Array, "n xy=2"], centers: bool
) -> _PieceErrors:
    """Errors of the segments that belong to a piece."""
    middle = (left + right) / 2
    above = middle[:, 1] < piece.rows(middle[:, 0])
    sides = [np.ones(len(left), dtype=bool)] if centers else [above, ~above]
    rows = np.array([_mean_rows(piece.columns, left[side], right[side]) for side in sides])
    coverage = float((~np.isnan(rows)).any(axis=0).mean())
    whole = ~np.isnan(rows).any(axis=0)
    starts = [left[side, 0].min() - piece.first for side in sides if side.any()]
    stops = [piece.last - right[side, 0].max() for side in sides if side.any()]
    return _PieceErrors(
        coverage=coverage,
        center_px=rows[:, whole].mean(axis=0) - piece.rows(piece.columns[whole]),
        short_px=np.array([np.mean(starts), np.mean(stops)] if coverage > COVERED else []),
    )


def _mean_rows(
    columns: Float64[Array, "column"], left: Float64[Array, "n xy=2"], right: Float64[Array, "n xy=2"]
) -> Float64[Array, "column"]:
    """Mean row of the segments that cross each column; NaN where none does."""
    along = np.maximum(right[:, 0] - left[:, 0], 1e-9)
    slope = (right[:, 1] - left[:, 1]) / along
    crosses = (left[:, 0] <= columns[:, None]) & (columns[:, None] <= right[:, 0])
    rows = left[:, 1] + slope * (columns[:, None] - left[:, 0])
    count = crosses.sum(axis=1)
    total = np.where(crosses, rows, 0.0).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _left_to_right(segments: Segments) -> tuple[Float64[Array, "n xy=2"], Float64[Array, "n xy=2"]]:
    turned = (segments.start_px[:, 0] > segments.end_px[:, 0])[:, None]
    return (
        np.where(turned, segments.end_px, segments.start_px),
        np.where(turned, segments.start_px, segments.end_px),
    )


def length_recalled_px(lines_px: Float64[Array, "line end=2 xy=2"], segments: Segments, distance_px: float) -> float:
    """Length of the parts of the lines that have a segment along them within a distance; sampled at every pixel."""
    return math.fsum(_recalled_px(line, segments, distance_px) for line in lines_px)


def length_px(lines_px: Float64[Array, "line end=2 xy=2"]) -> float:
    """Total length of all lines."""
    return float(np.linalg.norm(lines_px[:, 1] - lines_px[:, 0], axis=-1).sum())


def _recalled_px(line_px: Float64[Array, "end=2 xy=2"], segments: Segments, distance_px: float) -> float:
    start, along = line_px[0], line_px[1] - line_px[0]
    length = float(np.linalg.norm(along))
    count = max(1, round(length))
    points = start + (np.arange(count)[:, None] + 0.5) / count * along
    near = _near(points, segments, distance_px)
    parallel = _parallel(along, segments)
    return length * float((near & parallel).any(axis=1).mean())


def _near(points: Float64[Array, "point xy=2"], segments: Segments, distance_px: float) -> Bool[Array, "point segment"]:
    """Which segments pass each point within the distance."""
    direction, length = _directions(segments)
    offset = points[:, None] - segments.start_px
    along = (offset * direction).sum(axis=-1)
    across = offset[..., 0] * direction[:, 1] - offset[..., 1] * direction[:, 0]
    near: Bool[Array, "point segment"] = (
        (np.abs(across) <= distance_px) & (along >= -LINE_END_MARGIN_PX) & (along <= length + LINE_END_MARGIN_PX)
    )
    return near


def _parallel(along: Float64[Array, "xy=2"], segments: Segments) -> Bool[Array, "segment"]:
    direction, length = _directions(segments)
    sine = (direction[:, 0] * along[1] - direction[:, 1] * along[0]) / max(float(np.linalg.norm(along)), 1e-9)
    parallel: Bool[Array, "segment"] = (np.abs(sine) <= math.sin(LINE_MAX_ANGLE_RAD)) & (length > 0)
    return parallel


def _directions(segments: Segments) -> tuple[Float64[Array, "segment xy=2"], Float64[Array, "segment"]]:
    """Unit vectors and lengths; the direction of a segment of length zero is zero."""
    along = segments.end_px - segments.start_px
    length = np.linalg.norm(along, axis=-1)
    return along / np.maximum(length, 1e-9)[:, None], length
