"""Readable NumPy twin of the kernel that makes straight tracks: the oracle of its tests."""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from ringpose.kernels.ring import Lens, TrackRules
from ringpose.types.arrays import Array, Float64, Int64

MOST_RUNS = 8
"""Runs of neighbouring centres that one track is joined from."""

LAG, LEAST_DIFFERENCES = 4, 8
"""Columns over which the speckle of two centres has become independent, and differences that tell a scatter."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Centers:
    """All stripe centres."""

    column: Float64[Array, "center"]
    points: Float64[Array, "center xy=2"]
    """Undistorted."""
    sigma: Float64[Array, "center"]
    laser: Int64[Array, "center"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Line:
    """A track: its centres and the line through them."""

    centers: Int64[Array, "n"]
    runs: int
    laser: int
    x: tuple[float, float]
    middle: tuple[float, float]
    slope: float
    scatter: float
    correlation: float

    def y(self, x: float) -> float:
        """The line's ordinate."""
        return self.middle[1] + self.slope * (x - self.middle[0])

    def sigma(self, x: float) -> float:
        """Standard deviation of the ordinate, columns that err alike counted once."""
        n = max(len(self.centers) / self.correlation, 2.0)
        spread = max(self.x[1] - self.x[0], 1.0) / np.sqrt(12)
        return float(self.scatter / np.sqrt(n) * np.hypot(1.0, (x - self.middle[0]) / spread))


def straight_tracks(
    position_px: Float64[Array, "center xy=2"],
    sigma_px: Float64[Array, "center"],
    piece: Int64[Array, "center"],
    laser: Int64[Array, "piece"],
    lens: Lens,
    rules: TrackRules,
) -> Float64[Array, "track column=11"]:
    """Twin of `ringpose.kernels.ring.straight_tracks`."""
    points = undistorted(position_px, lens)
    centers = Centers(column=position_px[:, 0], points=points, sigma=sigma_px, laser=laser[piece])
    runs = np.split(np.arange(len(points)), np.flatnonzero(np.diff(piece)) + 1)
    parts = [part for run in runs for part in _straight_parts(run, centers, rules)]
    lines = _joined([_line(part, 1, centers, rules) for part in parts], centers, rules)
    rows = [_row(line, centers, rules) for line in lines]
    return np.array(rows, dtype=np.float64).reshape(-1, 11)


def undistorted(position_px: Float64[Array, "center xy=2"], lens: Lens) -> Float64[Array, "center xy=2"]:
    """Where the same camera without distortion would see the points: OpenCV's distortion undone by iteration."""
    if not len(position_px):
        return position_px
    matrix = np.array([[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]])
    coefficients = np.array([lens.k1, lens.k2, lens.p1, lens.p2, lens.k3, lens.k4, lens.k5, lens.k6])
    goal = (position_px - matrix[:2, 2]) / matrix[[0, 1], [0, 1]]
    guess = goal.copy()
    for _ in range(100):
        rays = np.column_stack([guess, np.ones(len(guess))])
        bent = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.eye(3), coefficients)[0].reshape(-1, 2)
        guess -= bent - goal
    straight: Float64[Array, "center xy=2"] = guess * matrix[[0, 1], [0, 1]] + matrix[:2, 2]
    return straight


def _straight_parts(
    run: Int64[Array, "n"], centers: Centers, rules: TrackRules, sigma: float = np.inf
) -> list[Int64[Array, "m"]]:
    """A run between its kinks: cut where it is farthest from the chord of its ends (Ramer).

    `sigma` is the least that was said of the runs that it was cut from, by their own sigmas or by their scatter: a jump
    raises the sigmas of all the piece, which must not hide it.
    """
    if len(run) < rules.minimum_columns:
        return []
    bend = _from_chord(centers.points[run])
    cut = int(np.argmax(bend))
    sigma = min(sigma, float(np.median(centers.sigma[run])), _scatter(centers.points[run, 1]))
    if bend[cut] <= rules.kink_px + 1.5 * sigma:
        return [run]
    cut = min(max(cut, 1), len(run) - 1)
    return _straight_parts(run[:cut], centers, rules, sigma) + _straight_parts(run[cut:], centers, rules, sigma)


def _scatter(y: Float64[Array, "n"]) -> float:
    """Of a run's centres, by the median of their second differences, which few jumps do not raise."""
    if len(y) < 2 * LAG + LEAST_DIFFERENCES:
        return math.inf
    differences = np.abs(y[: -2 * LAG] + y[2 * LAG :] - 2 * y[LAG:-LAG])
    return 1.4826 * float(np.median(differences)) / math.sqrt(6)


def _from_chord(points: Float64[Array, "n xy=2"]) -> Float64[Array, "n"]:
    """Distance of the points, smoothed by a running median of seven, from the chord of their ends."""
    x, y = points.T
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(np.pad(y, 3, mode="reflect"), 7), axis=-1)
    slope = (smooth[-1] - smooth[0]) / (x[-1] - x[0])
    bend: Float64[Array, "n"] = np.abs(smooth - (smooth[0] + slope * (x - x[0])))
    return bend


def _line(members: Int64[Array, "n"], runs: int, centers: Centers, rules: TrackRules) -> Line:
    """The line through centres, by two rounds of least squares, the second without outliers."""
    x, y = centers.points[members].T
    inlier = np.ones(len(x), dtype=bool)
    for _ in range(2):
        middle_x, middle_y = x[inlier].mean(), y[inlier].mean()
        across = x[inlier] - middle_x
        slope = across @ (y[inlier] - middle_y) / (across @ across)
        residual = y - middle_y - slope * (x - middle_x)
        scatter = max(1.4826 * float(np.median(np.abs(residual))), 0.01)
        inlier = np.abs(residual) < 3 * scatter
    return Line(
        centers=members,
        runs=runs,
        laser=int(centers.laser[members[0]]),
        x=(float(x[0]), float(x[-1])),
        middle=(float(middle_x), float(middle_y)),
        slope=float(slope),
        scatter=scatter,
        correlation=_correlation_columns(residual[inlier], rules),
    )


def _correlation_columns(residual: Float64[Array, "n"], rules: TrackRules) -> float:
    """1 + 2 times the sum of the autocorrelation, as far as it stays positive (Geyer's initial sequence)."""
    centred = residual - residual.mean()
    variance = max(float(centred @ centred), 1e-12)
    columns = 1.0
    for lag in range(1, min(int(rules.longest_lag), len(residual) // 3)):
        likeness = float(centred[lag:] @ centred[:-lag]) / variance
        if likeness <= 0:
            break
        columns += 2 * likeness
    return rules.short_series * columns


def _joined(lines: list[Line], centers: Centers, rules: TrackRules) -> list[Line]:
    """The lines with those made one that continue each other across a gap: a bracket, a dropout, a foil's dent."""
    joined: list[Line] = []
    for line in sorted(lines, key=lambda each: (each.x[0], each.centers[0])):
        partner = next((each for each in reversed(joined) if _continues(each, line, rules)), None)
        if partner is None:
            joined.append(line)
        else:
            joined.remove(partner)
            members = np.concatenate([partner.centers, line.centers])
            joined.append(_line(members, partner.runs + 1, centers, rules))
    return joined


def _continues(first: Line, second: Line, rules: TrackRules) -> bool:
    """Whether the second line's centres lie on the first line, not too far beyond its end."""
    gap = second.x[0] - first.x[1]
    lengths = (first.x[1] - first.x[0], second.x[1] - second.x[0])
    if first.laser != second.laser or first.runs >= MOST_RUNS or not 0 <= gap <= max(12.0, 0.5 * min(lengths)):
        return False
    middle = (first.x[1] + second.x[0]) / 2
    apart = abs(first.y(middle) - second.y(middle))
    turned = abs(first.slope - second.slope) * min(*lengths, max(lengths) / 2) / 2
    return bool(max(apart, turned) < rules.joined_px + 2 * np.hypot(first.sigma(middle), second.sigma(middle)))


def _row(line: Line, centers: Centers, rules: TrackRules) -> tuple[int | float, ...]:
    """What is said of a track, in the order of `TRACK_COLUMNS`."""
    ends = centers.column[line.centers[[0, -1]]]
    clipped = np.any((ends < rules.border_px) | (ends > rules.image_width - 1 - rules.border_px))
    x, y = centers.points.T
    reach = min(line.x[1] - line.x[0], 100.0) + 40
    beyond = (x > line.x[0] - reach) & (x < line.x[0] - 2) | (x > line.x[1] + 2) & (x < line.x[1] + reach)
    beyond &= np.abs(y - line.middle[1] - line.slope * (x - line.middle[0])) < rules.on_line_px
    spilt = int(np.count_nonzero(beyond & ((centers.laser == line.laser) | (line.laser < 0))))
    shape = (*line.x, *line.middle, line.slope, line.scatter, line.correlation)
    return (line.laser, len(line.centers), *shape, float(clipped), spilt)
