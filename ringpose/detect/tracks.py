"""Straight tracks: the stripes' pieces in the undistorted image, cut at kinks and joined across gaps.

A light plane draws a straight line on every planar surface, so the stripe on the ring's face is one track;
a wall or a foil behind it adds tracks of other directions or places.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from ringpose.types.arrays import Array
from ringpose.types.stripes import Stripes

MINIMUM_COLUMNS = 10
"""A shorter track says nothing about direction; 20 mm of ring at 1 m are twice as many."""

BORDER_PX = 3.0
"""A centre so close to the image's left or right border is the last that could be seen."""

KINK_PX = 0.6
"""A piece that leaves its chord by more than this (and by its own scatter) is cut there."""

JOINED_PX = 0.5
"""Tracks whose lines meet this closely across a gap are one surface."""

SHORT_SERIES = 1.5
"""A line fitted to a short series takes part of its likeness away: what is found is so much too small."""

LONGEST_CORRELATION = 40
"""Columns over which errors of neighbouring centres are looked at for likeness: a facet of crinkled foil."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Track:
    """Centres on one straight line y = middle_y + slope (x - middle_x), in undistorted pixels."""

    centers: Int64[Array, "n"]
    """Their indices in the `Stripes`."""
    laser: int
    x_start: float
    x_end: float
    middle_x: float
    middle_y: float
    slope: float
    scatter: float
    """Standard deviation of a centre about the line."""
    correlation: float
    """Columns that err alike (a speckle grain, a facet behind the stripe) and count as one measurement."""
    clipped: bool
    """Whether it leaves the image at its left or right border."""

    def y(self, x: float) -> float:
        """The line's ordinate."""
        return self.middle_y + self.slope * (x - self.middle_x)

    def sigma(self, x: float) -> float:
        """Standard deviation of the line's ordinate, columns that err alike counted once."""
        n = max(len(self.centers) / self.correlation, 2.0)
        spread = max(self.x_end - self.x_start, 1.0) / np.sqrt(12)
        return float(self.scatter / np.sqrt(n) * np.hypot(1.0, (x - self.middle_x) / spread))

    @property
    def length(self) -> float:
        """Columns from start to end."""
        return self.x_end - self.x_start


def straight_tracks(stripes: Stripes, points: Float64[Array, "center xy=2"], image_width: int) -> list[Track]:
    """The straight tracks among the stripes; `points` are the centres in undistorted pixels."""
    column = stripes.position_px[:, 0]
    at_border = (column < BORDER_PX) | (column > image_width - 1 - BORDER_PX)
    tracks: list[Track] = []
    for number, centers in enumerate(np.split(np.arange(len(points)), np.flatnonzero(np.diff(stripes.piece)) + 1)):
        if len(centers) >= MINIMUM_COLUMNS:
            laser = int(stripes.laser[number])
            parts = _straight_parts(points[centers], stripes.sigma_px[centers])
            tracks += [_track(points, centers[part], laser, at_border) for part in parts]
    return _joined(tracks, points, at_border)


def _straight_parts(points: Float64[Array, "n xy=2"], sigma: Float64[Array, "n"]) -> list[slice]:
    """Slices of a piece between its kinks: cut where it is farthest from the chord of its ends (Ramer)."""
    parts, open_parts = [], [slice(0, len(points))]
    while open_parts:
        part = open_parts.pop()
        if part.stop - part.start < MINIMUM_COLUMNS:
            continue
        bend = np.abs(_from_chord(points[part]))
        cut = int(np.argmax(bend))
        if bend[cut] <= KINK_PX + 1.5 * float(np.median(sigma[part])):
            parts.append(part)
        else:
            cut = min(max(cut, 1), len(bend) - 1) + part.start
            open_parts += [slice(part.start, cut), slice(cut, part.stop)]
    return parts


def _from_chord(points: Float64[Array, "n xy=2"]) -> Float64[Array, "n"]:
    """Height of the points, smoothed over a few columns, above the chord of their ends."""
    smooth = _smoothed(points[:, 1])
    x, chord = points[:, 0], points[[0, -1], 0]
    height: Float64[Array, "n"] = smooth - np.interp(x, chord, smooth[[0, -1]])
    return height


def _smoothed(y: Float64[Array, "n"]) -> Float64[Array, "n"]:
    """Running median over seven values, shorter at the ends."""
    padded = np.pad(y, 3, mode="reflect") if len(y) > 3 else np.pad(y, 3, mode="edge")
    smooth: Float64[Array, "n"] = np.median(np.lib.stride_tricks.sliding_window_view(padded, 7), axis=-1)
    return smooth


def _track(
    points: Float64[Array, "center xy=2"], centers: Int64[Array, "n"], laser: int, at_border: Bool[Array, "center"]
) -> Track:
    """The line through centres, by two rounds of least squares without outliers."""
    x, y = points[centers].T
    weight = np.ones(len(x))
    for _ in range(2):
        middle_x, middle_y = weight @ x / weight.sum(), weight @ y / weight.sum()
        slope = weight @ ((x - middle_x) * (y - middle_y)) / (weight @ (x - middle_x) ** 2)
        residual = np.abs(y - middle_y - slope * (x - middle_x))
        scatter = max(1.4826 * float(np.median(residual)), 0.01)
        weight = (residual < 3 * scatter).astype(np.float64)
    return Track(
        centers=centers,
        laser=laser,
        x_start=float(x[0]),
        x_end=float(x[-1]),
        middle_x=float(middle_x),
        middle_y=float(middle_y),
        slope=float(slope),
        scatter=scatter,
        correlation=_correlation_columns((y - middle_y - slope * (x - middle_x))[weight > 0]),
        clipped=bool(at_border[centers[0]] or at_border[centers[-1]]),
    )


def _correlation_columns(residual: Float64[Array, "n"]) -> float:
    """1 + 2 times the sum of the autocorrelation, as far as it stays positive (Geyer's initial sequence)."""
    centred = residual - residual.mean()
    variance = centred @ centred
    columns = 1.0
    for lag in range(1, min(LONGEST_CORRELATION, len(residual) // 3)):
        likeness = float(centred[lag:] @ centred[:-lag] / max(variance, 1e-12))
        if likeness <= 0:
            break
        columns += 2 * likeness
    return SHORT_SERIES * columns


def _joined(
    tracks: list[Track], points: Float64[Array, "center xy=2"], at_border: Bool[Array, "center"]
) -> list[Track]:
    """The tracks with those made one that continue each other across a gap: a bracket, a dropout, a foil's dent."""
    joined: list[Track] = []
    for track in sorted(tracks, key=lambda each: each.x_start):
        partner = next((each for each in reversed(joined) if _continues(each, track)), None)
        if partner is None:
            joined.append(track)
        else:
            joined.remove(partner)
            centers = np.concatenate([partner.centers, track.centers])
            joined.append(_track(points, centers, track.laser, at_border))
    return joined


def _continues(first: Track, second: Track) -> bool:
    """Whether the second track lies on the first one's line, not too far beyond its end."""
    gap = second.x_start - first.x_end
    if first.laser != second.laser or not 0 <= gap <= max(12.0, 0.5 * min(first.length, second.length)):
        return False
    middle = (first.x_end + second.x_start) / 2
    apart = abs(first.y(middle) - second.y(middle))
    reach = max(first.length, second.length) / 2
    turned = abs(first.slope - second.slope) * min(first.length, second.length, reach) / 2
    return bool(max(apart, turned) < JOINED_PX + 2 * np.hypot(first.sigma(middle), second.sigma(middle)))
