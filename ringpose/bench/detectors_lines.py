"""Segments against straight lines that somebody drew into a photograph: recall by length."""

import math

import numpy as np

from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.detection import Segments

MAX_ANGLE_RAD = math.radians(5)
"""A segment that is turned farther against a line does not lie along it."""

BEYOND_PX = 1.0
"""A segment also speaks for so much of the line beyond its ends."""


def length_recalled_px(lines_px: Float64[Array, "line end=2 xy=2"], segments: Segments, distance_px: float) -> float:
    """How much of the lines' length has a segment along it, no farther than a distance; taken at every pixel."""
    return math.fsum(_recalled_px(line, segments, distance_px) for line in lines_px)


def length_px(lines_px: Float64[Array, "line end=2 xy=2"]) -> float:
    """Length of all lines together."""
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
    """Which segments pass a point within the distance."""
    direction, length = _directions(segments)
    offset = points[:, None] - segments.start_px
    along = (offset * direction).sum(axis=-1)
    across = offset[..., 0] * direction[:, 1] - offset[..., 1] * direction[:, 0]
    near: Bool[Array, "point segment"] = (
        (np.abs(across) <= distance_px) & (along >= -BEYOND_PX) & (along <= length + BEYOND_PX)
    )
    return near


def _parallel(along: Float64[Array, "xy=2"], segments: Segments) -> Bool[Array, "segment"]:
    direction, length = _directions(segments)
    sine = (direction[:, 0] * along[1] - direction[:, 1] * along[0]) / max(float(np.linalg.norm(along)), 1e-9)
    parallel: Bool[Array, "segment"] = (np.abs(sine) <= math.sin(MAX_ANGLE_RAD)) & (length > 0)
    return parallel


def _directions(segments: Segments) -> tuple[Float64[Array, "segment xy=2"], Float64[Array, "segment"]]:
    """Unit vectors and lengths; a segment of no length has no direction."""
    along = segments.end_px - segments.start_px
    length = np.linalg.norm(along, axis=-1)
    return along / np.maximum(length, 1e-9)[:, None], length
