"""The joining of lines again, written to be read: the oracle of `ringpose.kernels.joins`, equal to it bit for bit."""

import math
from dataclasses import dataclass

import numpy as np

from ringpose.kernels.reference import line_through, on_line
from ringpose.types.arrays import Array, Float64, Int32, Int64


@dataclass
class Growing:
    """A line that grows at its tip."""

    tail: list[float]
    tip: list[float]
    moments: list[float]


def joins(
    lines: Float64[Array, "piece end=2 xy=2"],
    moments: Float64[Array, "piece moment=6"],
    pieces: Int32[Array, "piece end=2"],
    gap_px: float,
    aside_px: float,
    shortest: int,
) -> tuple[Float64[Array, "line end=2 xy=2"], Int64[Array, "line"]]:
    """Twin of `ringpose.kernels.joins`; looks at all ends, not only at those of the cells around."""
    free = dict(enumerate(zip(lines.tolist(), moments.tolist(), strict=True)))
    joined, support = [], []
    pixels = (pieces[:, 1].astype(np.int64) - pieces[:, 0] + 1).tolist()
    for seed in range(len(lines)):
        if seed not in free or pixels[seed] < shortest:
            continue
        (start, end), sums = free.pop(seed)
        line, members = Growing(start, end, sums), [seed]
        for _ in range(2):
            while (longer := next_line(line, free, gap_px, aside_px)) is not None:
                number, line = longer
                del free[number]
                members.append(number)
            line = Growing(line.tip, line.tail, line.moments)
        joined.append([line.tail, line.tip])
        support.append(sum(pixels[i] for i in members))
    return np.array(joined, np.float64).reshape(-1, 2, 2), np.array(support, np.int64)


def next_line(
    line: Growing, free: dict[int, tuple[list[list[float]], list[float]]], gap_px: float, aside_px: float
) -> tuple[int, Growing] | None:
    """The nearest line that continues this one, and both together."""
    dx, dy = line.tip[0] - line.tail[0], line.tip[1] - line.tail[1]
    length = math.sqrt(dx * dx + dy * dy)
    if length == 0:
        return None
    dx, dy = dx / length, dy / length
    found: list[tuple[float, int, int, Growing]] = []
    for number, (ends, moments) in free.items():
        for side, (near, far) in enumerate((ends, ends[::-1])):
            x, y = near[0] - line.tip[0], near[1] - line.tip[1]
            ahead, beside = -2 * aside_px <= x * dx + y * dy <= gap_px, abs(x * dy - y * dx) <= 2 * aside_px
            if ahead and beside and (far[0] - near[0]) * dx + (far[1] - near[1]) * dy > 0:
                longer = joined_line(line, [near, far], moments, aside_px)
                found += [] if longer is None else [(x * x + y * y, number, side, longer)]
    nearest = min(found, key=lambda each: each[:3], default=None)
    return None if nearest is None else (nearest[1], nearest[3])


def joined_line(line: Growing, ends: list[list[float]], moments: list[float], aside_px: float) -> Growing | None:
    """Both as one line, if all their ends lie beside it."""
    far = ends[1]
    flat = abs(far[0] - line.tail[0]) >= abs(far[1] - line.tail[1])
    u, v = (0, 1) if flat else (1, 0)
    sums = [a + b for a, b in zip(line.moments, moments, strict=True)]
    straight = line_through(sums, flat)
    if straight is None:
        return None
    slope, offset = straight
    if any(not abs(end[v] - (offset + slope * end[u])) <= aside_px for end in (line.tail, line.tip, *ends)):
        return None
    tip = max(far, line.tip, key=lambda end: abs(end[u] - line.tail[u]))
    return Growing(on_line(line.tail, straight, flat), on_line(tip, straight, flat), sums)
