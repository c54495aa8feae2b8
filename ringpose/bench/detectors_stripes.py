"""Segments against the stripes that are really there: recall, centre line, ends, what is no stripe.

A stripe has two edges; a detector of edges gives its centre line as the mean of the two. All figures are of
straight pieces (`stripe_rig(lens=False)`), in pixels.
"""

import math
from dataclasses import dataclass

import numpy as np

from ringpose.bench.stripe_images import StripeImage
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.detection import Segments

COVERED = 0.8
"""A piece is recalled if a segment on it crosses more than this share of its columns."""

MAX_ANGLE_RAD = math.radians(10)
"""A segment that is turned farther against a piece does not belong to it; short ones waver."""

REACH_SIGMAS, REACH_PX = 2.0, 2.0
"""Nor one whose middle is farther from the centre line than so many sigmas of the stripe and so many pixels: edges
lie at one sigma, of saturated stripes at nearly two."""

BEYOND_PX = 4.0
"""Nor one whose middle lies farther beyond an end of the piece."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StripeErrors:
    """What became of the pieces of one or more images."""

    coverage: Float64[Array, "piece"]
    """Share of the piece's columns that a segment of the piece crosses, along either edge."""
    segments: Float64[Array, "piece"]
    """Segments on each line that the piece has (two edges, or one centre): 1 is whole, more is broken."""
    center_px: Float64[Array, "column"]
    """Row of the centre line less the true row, in each column with both edges, or a centre."""
    short_px: Float64[Array, "end"]
    """How far the ends of the recalled pieces stop short of the true ones; negative beyond them."""
    false: int
    """Segments that belong to no piece."""


def stripe_errors(segments: Segments, image: StripeImage, centers: bool) -> StripeErrors:
    """Segments of an image without lens distortion; `centers` tells those along centres from those along edges."""
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
        self.reach_px = REACH_SIGMAS * sigma_px + REACH_PX
        self.columns = np.arange(math.ceil(self.first), math.floor(self.last) + 1, dtype=np.float64)

    def rows(self, x: Float64[Array, "*n"]) -> Float64[Array, "*n"]:
        return self.row + self.slope * (x - self.first)

    def members(self, left: Float64[Array, "n xy=2"], right: Float64[Array, "n xy=2"]) -> Bool[Array, "n"]:
        """Which segments belong to the piece."""
        along, down = (right - left).T
        turned = np.arctan2(down, along) - math.atan(self.slope)
        middle = (left + right) / 2
        beside = (self.first - BEYOND_PX <= middle[:, 0]) & (middle[:, 0] <= self.last + BEYOND_PX)
        near = np.abs(middle[:, 1] - self.rows(middle[:, 0])) <= self.reach_px
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
    """A piece against its own segments."""
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
