"""Visualization of a detection, drawn over the image."""

import cv2
import numpy as np

from ringpose.detect.line_segments import eight_bit
from ringpose.types.arrays import EDGES, Array, Float64, Int64, UInt, UInt8
from ringpose.types.detection import (
    UNLABELLED,
    BreakPointFlag,
    BreakPoints,
    Detection,
    RingEdgePoints,
    Segments,
    Stripes,
)

Color = tuple[int, int, int]

COLORS: tuple[Color, ...] = (
    (255, 160, 60),
    (80, 220, 80),
    (80, 120, 255),
    (230, 100, 230),
    (60, 220, 230),
    (230, 230, 90),
    (160, 160, 255),
    (160, 230, 160),
)
"""Colour (blue, green, red) of each laser, in the order of the rig."""

UNLABELLED_COLOR: Color = (170, 170, 170)
SEGMENT_COLOR: Color = (0, 200, 255)
FLAG_COLOR: Color = (60, 60, 255)

EDGE_COLORS: tuple[Color, Color] = ((200, 200, 90), (90, 200, 200))
"""Colours of the inner and the outer edge."""

EDGE_HALF_LENGTH_PX = 3.0
"""Half length of the dashes along the edge by which points of the ring's edges are drawn."""

ELLIPSE_SIGMAS = 30.0
"""Magnification of the error ellipses: standard deviations of break points are tenths of a pixel."""

_BITS = 4
"""Fractional bits of the coordinates passed to OpenCV: 1/16 of a pixel."""

_NAME_OFFSET, _FLAGS_OFFSET = np.array([10.0, -8.0]), np.array([10.0, 18.0])

_FONT = cv2.FONT_HERSHEY_SIMPLEX


def overlay(image: UInt[Array, "row column"], detection: Detection) -> UInt8[Array, "row column 3"]:
    """The dimmed image as blue, green, red, with segments, stripes, ring edges and break points drawn over it.

    Each laser has its colour; the half axes of error ellipses are `ELLIPSE_SIGMAS` standard deviations.
    """
    picture: UInt8[Array, "row column 3"] = cv2.cvtColor(eight_bit(image) // 2, cv2.COLOR_GRAY2BGR)
    if detection.segments is not None:
        _draw_segments(picture, detection.segments)
    if detection.stripes is not None:
        _draw_stripes(picture, detection.stripes)
    if detection.ring_edges is not None:
        _draw_ring_edges(picture, detection.ring_edges)
    if isinstance(detection.break_points, BreakPoints):
        _draw_break_points(picture, detection.break_points)
    _write(picture, f"{detection.shot}: {detection.summary}", np.array([8.0, 20.0]), (255, 255, 255))
    return picture


def color_of(laser: int) -> Color:
    """The colour in which a laser is drawn."""
    return UNLABELLED_COLOR if laser == UNLABELLED else COLORS[laser % len(COLORS)]


def _draw_segments(picture: UInt8[Array, "row column 3"], segments: Segments) -> None:
    for start, end in zip(_fixed(segments.start_px), _fixed(segments.end_px), strict=True):
        cv2.line(picture, start, end, SEGMENT_COLOR, 1, cv2.LINE_AA, _BITS)


def _draw_stripes(picture: UInt8[Array, "row column 3"], stripes: Stripes) -> None:
    for laser in (UNLABELLED, *range(len(COLORS))):
        here = stripes.laser[stripes.piece] == laser
        columns, rows = np.round(stripes.position_px[here]).astype(np.int64).T
        inside = (rows >= 0) & (rows < picture.shape[0]) & (columns >= 0) & (columns < picture.shape[1])
        picture[rows[inside], columns[inside]] = color_of(laser)


def _draw_ring_edges(picture: UInt8[Array, "row column 3"], edges: RingEdgePoints) -> None:
    along = EDGE_HALF_LENGTH_PX * edges.normal[:, ::-1] * np.array([-1.0, 1.0])
    starts, ends = _fixed(edges.position_px - along), _fixed(edges.position_px + along)
    for start, end, edge in zip(starts, ends, edges.edge.tolist(), strict=True):
        cv2.line(picture, start, end, EDGE_COLORS[edge], 1, cv2.LINE_AA, _BITS)


def _draw_break_points(picture: UInt8[Array, "row column 3"], points: BreakPoints) -> None:
    for laser, edge in np.argwhere(points.seen).tolist():
        position, color = points.position_px[laser, edge], color_of(laser)
        _draw_ellipse(picture, position, points.covariance_px2[laser, edge], color)
        center = _fixed(position[None])[0]
        cv2.drawMarker(
            picture, tuple(np.round(position).astype(int).tolist()), color, cv2.MARKER_CROSS, 9, 1, cv2.LINE_AA
        )
        cv2.circle(picture, center, 6 << _BITS, color, 1, cv2.LINE_AA, _BITS)
        flags = flag_names(int(points.flags[laser, edge]))
        _write(picture, f"{laser + 1} {EDGES[edge]}", position + _NAME_OFFSET, color)
        _write(picture, " ".join(flags), position + _FLAGS_OFFSET, FLAG_COLOR)


def flag_names(flags: int) -> list[str]:
    """Names of the flags of a break point, in lower case."""
    return [str(flag.name).lower() for flag in BreakPointFlag if flags & flag]


def _draw_ellipse(
    picture: UInt8[Array, "row column 3"],
    position: Float64[Array, "2"],
    covariance: Float64[Array, "2 2"],
    color: Color,
) -> None:
    if not np.isfinite(covariance).all():
        return
    variance, axes = np.linalg.eigh(covariance)
    angle_deg = float(np.degrees(np.arctan2(axes[1, 1], axes[0, 1])))
    long_short = ELLIPSE_SIGMAS * np.sqrt(np.clip(variance[::-1], 0, 1e4))
    center, size = _fixed(position[None])[0], _fixed(long_short[None])[0]
    cv2.ellipse(picture, center, size, angle_deg, 0, 360, color, 1, cv2.LINE_AA, _BITS)


def _write(picture: UInt8[Array, "row column 3"], text: str, position: Float64[Array, "2"], color: Color) -> None:
    column, row = np.round(position).astype(int).tolist()
    ascii_text = text.encode("ascii", "replace").decode()
    for x, y in ((-1, 0), (1, 0), (0, -1), (0, 1)):  # an outline; in OpenCV 5 thicker letters would also be wider
        cv2.putText(picture, ascii_text, (column + x, row + y), _FONT, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    cv2.putText(picture, ascii_text, (column, row), _FONT, 0.45, color, 1, cv2.LINE_AA)


def _fixed(points: Float64[Array, "n 2"]) -> list[tuple[int, int]]:
    """Points in OpenCV's fixed-point coordinates."""
    fixed: Int64[Array, "n 2"] = np.round(points * (1 << _BITS)).astype(np.int64)
    return [(x, y) for x, y in fixed.tolist()]
