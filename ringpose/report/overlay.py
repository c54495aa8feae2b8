"""Drawing of a detection, and of the pose computed from it, over the image: the only drawing routine for shots."""

import textwrap
from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from ringpose.detect.line_segments import eight_bit
from ringpose.estimate.covariance import standard_deviation
from ringpose.geometry.rays import project
from ringpose.geometry.rotations import tilt_basis
from ringpose.pose.transform import pose_in_frame
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
from ringpose.types.image import Shot
from ringpose.types.options import PoseFrame
from ringpose.types.pose import LaserState, PoseLine, RingPose
from ringpose.types.rig import Camera, Rig

Color = tuple[int, int, int]

Rejected = frozenset[tuple[int, int | None]]
"""Laser and edge of each rejected break point; the edge of a rejected stripe is None."""

COLORS: tuple[Color, ...] = (
    (255, 160, 60),
    (80, 220, 80),
    (230, 100, 230),
    (255, 120, 150),
    (60, 220, 230),
    (230, 230, 90),
    (160, 160, 255),
    (160, 230, 160),
)
"""Colour (blue, green, red) of each laser, in the order of the rig; none resembles `REJECTED_COLOR`."""

UNLABELLED_COLOR: Color = (120, 120, 120)
SEGMENT_COLOR: Color = (0, 200, 255)
FLAG_COLOR: Color = (60, 190, 255)
REJECTED_COLOR: Color = (60, 60, 255)

WHITE: Color = (255, 255, 255)

STATUS_COLORS: Mapping[str, Color] = {"ok": (120, 230, 120), "degraded": FLAG_COLOR, "none": REJECTED_COLOR}

EDGE_COLORS: tuple[Color, Color] = ((200, 200, 90), (90, 200, 200))
"""Colours of the inner and the outer edge."""

RING_COLORS: tuple[Color, Color] = ((140, 140, 60), (60, 140, 140))
"""Colours of the projected inner and outer edge: those of measured points, darker."""

EDGE_HALF_LENGTH_PX = 3.0
"""Half length of the dashes along the edge by which points of the ring's edges are drawn."""

ELLIPSE_SIGMAS = 30.0
"""Magnification of the error ellipses: standard deviations of break points are tenths of a pixel."""

GRASP_SIGMAS = 10.0
"""Magnification of the error ellipse of the grasp point."""

NORMAL_SHARE = 0.15
"""Length of the arrow along the normal, as a share of the distance of the grasp point."""

RING_POINTS = 720
"""Vertices of a drawn circle: a chord of half a degree deviates by less than 0.1 px where the ring fills the image."""

ROW_PX = 18.0
"""Distance of two rows of text."""

LETTER_PX = 8.0
"""Width of a letter, a mean with a margin."""

TEXT_WIDTH_PX = 1000.0
"""Width of a picture above which texts grow with it."""

_MAX_PX = 1e5
"""Points of a drawing farther away than this are left out: OpenCV's fixed-point coordinates end at 2^27 px."""

_BITS = 4
"""Fractional bits of the coordinates passed to OpenCV: 1/16 of a pixel."""

_NAME_OFFSET, _FLAGS_OFFSET = np.array([10.0, -8.0]), np.array([10.0, 18.0])

_FONT = cv2.FONT_HERSHEY_SIMPLEX


def overlay(
    image: UInt[Array, "row column"],
    detection: Detection,
    line: PoseLine | None = None,
    rig: Rig | None = None,
    *,
    with_numbers: bool = True,
) -> UInt8[Array, "row column 3"]:
    """The dimmed image as blue, green, red, with segments, stripes, ring edges and break points drawn over it.

    With a pose line and its rig also the projected ring, the grasp point, the normal and the status as text; what the
    pose rejected is red. Each laser has its colour; the half axes of error ellipses are `ELLIPSE_SIGMAS` standard
    deviations, those of the grasp point `GRASP_SIGMAS`. The ring of a moving target is that at the line's
    `pose_stamp_s`. Without `with_numbers` the pose is drawn, but not written.
    """
    picture: UInt8[Array, "row column 3"] = cv2.cvtColor(eight_bit(image) // 2, cv2.COLOR_GRAY2BGR)
    rejected = _rejected(line, rig)
    if detection.segments is not None:
        _draw_segments(picture, detection.segments)
    pose = None if line is None or rig is None else pose_in_camera_frame(line, rig)
    if pose is not None and rig is not None:
        _draw_ring(picture, pose, rig.camera)
    if detection.stripes is not None:
        _draw_stripes(picture, detection.stripes, rejected)
    if detection.ring_edges is not None:
        _draw_ring_edges(picture, detection.ring_edges)
    if isinstance(detection.break_points, BreakPoints):
        _draw_break_points(picture, detection.break_points, rejected)
    if pose is not None and rig is not None:
        _draw_grasp_point(picture, pose, rig.camera)
    if line is None:
        _write_rows(picture, [f"{detection.shot}: {detection.summary}"])
    else:
        _write_status(picture, line, pose if with_numbers else None)
    return picture


def captioned(image: UInt[Array, "row column"], caption: str) -> UInt8[Array, "row column 3"]:
    """The image as blue, green, red, with a caption in its upper left corner."""
    picture: UInt8[Array, "row column 3"] = cv2.cvtColor(eight_bit(image), cv2.COLOR_GRAY2BGR)
    _write_rows(picture, [caption])
    return picture


def picture_of(shot: Shot) -> UInt[Array, "row column"]:
    """The brightest grey value of each pixel in the frames with lasers on: shows the stripes of all of them."""
    lit = np.flatnonzero(shot.lasers)
    image: UInt[Array, "row column"] = shot.images[lit if len(lit) else slice(None)].max(axis=0)
    return image


def color_of(laser: int) -> Color:
    """The colour in which a laser is drawn."""
    return UNLABELLED_COLOR if laser == UNLABELLED else COLORS[laser % len(COLORS)]


def _draw_segments(picture: UInt8[Array, "row column 3"], segments: Segments) -> None:
    for start, end in zip(_fixed(segments.start_px), _fixed(segments.end_px), strict=True):
        cv2.line(picture, start, end, SEGMENT_COLOR, 1, cv2.LINE_AA, _BITS)


def _draw_stripes(picture: UInt8[Array, "row column 3"], stripes: Stripes, rejected: Rejected) -> None:
    for laser in (UNLABELLED, *range(len(COLORS))):
        here = stripes.laser[stripes.piece] == laser
        columns, rows = np.round(stripes.position_px[here]).astype(np.int64).T
        inside = (rows >= 0) & (rows < picture.shape[0]) & (columns >= 0) & (columns < picture.shape[1])
        picture[rows[inside], columns[inside]] = REJECTED_COLOR if (laser, None) in rejected else color_of(laser)


def _draw_ring_edges(picture: UInt8[Array, "row column 3"], edges: RingEdgePoints) -> None:
    along = EDGE_HALF_LENGTH_PX * edges.normal[:, ::-1] * np.array([-1.0, 1.0])
    starts, ends = _fixed(edges.position_px - along), _fixed(edges.position_px + along)
    for start, end, edge in zip(starts, ends, edges.edge.tolist(), strict=True):
        cv2.line(picture, start, end, EDGE_COLORS[edge], 1, cv2.LINE_AA, _BITS)


def _draw_break_points(picture: UInt8[Array, "row column 3"], points: BreakPoints, rejected: Rejected) -> None:
    if points.opposite is not None:
        _draw_break_points(picture, points.opposite, rejected)
    for laser in np.flatnonzero(points.seen.all(axis=1)).tolist():
        inner, outer = _fixed(points.position_px[laser])
        color = REJECTED_COLOR if (laser, None) in rejected else color_of(laser)
        cv2.line(picture, inner, outer, color, 1, cv2.LINE_AA, _BITS)
    for laser, edge in np.argwhere(points.seen).tolist():
        is_rejected = not rejected.isdisjoint({(laser, None), (laser, edge)})
        position, color = points.position_px[laser, edge], REJECTED_COLOR if is_rejected else color_of(laser)
        _draw_ellipse(picture, position, points.covariance_px2[laser, edge], color)
        pixel = tuple(np.round(position).astype(int).tolist())
        cv2.drawMarker(picture, pixel, color, cv2.MARKER_CROSS, 9, 1, cv2.LINE_AA)
        cv2.circle(picture, _fixed(position[None])[0], 6 << _BITS, color, 1, cv2.LINE_AA, _BITS)
        flags = [str(flag.name).lower() for flag in BreakPointFlag if points.flags[laser, edge] & flag]
        flags, of_flags = ([*flags, "rejected"], REJECTED_COLOR) if is_rejected else (flags, FLAG_COLOR)
        _write(picture, f"{laser + 1} {EDGES[edge]}", position + _scale(picture) * _NAME_OFFSET, color)
        _write(picture, " ".join(flags), position + _scale(picture) * _FLAGS_OFFSET, of_flags)


def _draw_ellipse(
    picture: UInt8[Array, "row column 3"],
    position: Float64[Array, "2"],
    covariance: Float64[Array, "2 2"],
    color: Color,
    sigmas: float = ELLIPSE_SIGMAS,
) -> None:
    if not np.isfinite(covariance).all():
        return
    variance, axes = np.linalg.eigh(covariance)
    angle_deg = float(np.degrees(np.arctan2(axes[1, 1], axes[0, 1])))
    long_short = sigmas * np.sqrt(np.clip(variance[::-1], 0, 1e4))
    center, size = _fixed(position[None])[0], _fixed(long_short[None])[0]
    cv2.ellipse(picture, center, size, angle_deg, 0, 360, color, 1, cv2.LINE_AA, _BITS)


def _rejected(line: PoseLine | None, rig: Rig | None) -> Rejected:
    if line is None or rig is None:
        return frozenset()
    names = rig.lasers.names
    by_state = {
        (names.index(name), None)
        for name, state in line.lasers.items()
        if state is LaserState.REJECTED and name in names
    }
    listed = {
        (
            names.index(str(rejection.laser)),
            None if rejection.edge is None or rejection.what == "stripe" else EDGES.index(rejection.edge),
        )
        for rejection in line.rejected
        if rejection.what in ("point", "stripe") and rejection.laser in names
    }
    return frozenset(by_state | listed)


def pose_in_camera_frame(line: PoseLine, rig: Rig) -> RingPose | None:
    """The pose, transformed back if necessary; None if that needs more than the rig's mount."""
    if line.pose is None or line.frame is PoseFrame.CAMERA:
        return line.pose
    if rig.mount is not None and line.frame is rig.mount.carrier:
        return pose_in_frame(line.pose, np.linalg.inv(rig.mount.carrier_from_camera))
    return None


def _draw_ring(picture: UInt8[Array, "row column 3"], pose: RingPose, camera: Camera) -> None:
    """Draw the projected edges, as far as the pose determines them."""
    if not np.isfinite([*pose.center_m, *pose.normal]).all():
        return
    angle = np.linspace(0.0, 2.0 * np.pi, RING_POINTS + 1)
    circle = np.cos(angle)[:, None] * (axes := tilt_basis(pose.normal))[0] + np.sin(angle)[:, None] * axes[1]
    for radius_m, color in zip((pose.radius_inner_m, pose.radius_outer_m), RING_COLORS, strict=True):
        if np.isfinite(radius_m):
            _draw_curve(picture, project(pose.center_m + radius_m * circle, camera), color)


def _draw_curve(picture: UInt8[Array, "row column 3"], points_px: Float64[Array, "n 2"], color: Color) -> None:
    """A polyline, interrupted at points that cannot be projected or are far outside the image."""
    near = (np.abs(np.nan_to_num(points_px, nan=np.inf)) < _MAX_PX).all(axis=1)
    for first in np.flatnonzero(near[:-1] & near[1:]).tolist():
        start, end = _fixed(points_px[first : first + 2])
        cv2.line(picture, start, end, color, 1, cv2.LINE_AA, _BITS)


def _draw_grasp_point(picture: UInt8[Array, "row column 3"], pose: RingPose, camera: Camera) -> None:
    """The grasp point with its error ellipse, and an arrow along the normal."""
    if not np.isfinite(pose.grasp_m).all():
        return
    position = project(pose.grasp_m[None], camera)[0]
    if not np.abs(np.nan_to_num(position, nan=np.inf)).max() < _MAX_PX:
        return
    if pose.covariance_grasp_m2 is not None:
        step_m = 1e-6 * float(np.linalg.norm(pose.grasp_m))
        stepped = project(pose.grasp_m + step_m * np.eye(3), camera)
        jacobian = (stepped - position).T / step_m
        covariance = jacobian @ pose.covariance_grasp_m2 @ jacobian.T
        _draw_ellipse(picture, position, covariance, WHITE, GRASP_SIGMAS)
    center = _fixed(position[None])[0]
    cv2.circle(picture, center, 4 << _BITS, WHITE, -1, cv2.LINE_AA, _BITS)
    length_m = NORMAL_SHARE * float(np.linalg.norm(pose.grasp_m))
    tip = project((pose.grasp_m + length_m * pose.normal)[None], camera)[0]
    if np.abs(np.nan_to_num(tip, nan=np.inf)).max() < _MAX_PX:
        start, end = (tuple(np.round(point).astype(int).tolist()) for point in (position, tip))
        cv2.arrowedLine(picture, start, end, WHITE, 2, cv2.LINE_AA, 0, 0.12)


def _write_status(picture: UInt8[Array, "row column 3"], line: PoseLine, pose: RingPose | None) -> None:
    """Status, flags and reason; what the pose is in the camera frame, with standard deviations."""
    unused = [f"{name} {str(state).replace('_', ' ')}" for name, state in line.lasers.items() if state != "used"]
    texts = [f"{line.shot}: {line.status}"]
    texts += [", ".join(line.flag_names), line.reason or "", f"lasers: {', '.join(unused)}" if unused else ""]
    written = _write_rows(picture, texts, STATUS_COLORS[line.status])
    if pose is None:
        return
    below = picture.shape[0] / _scale(picture) - 12.0
    rows = [row for text in pose_texts(pose) for row in _wrapped(picture, text)]
    room = int((below - 20.0) / ROW_PX) - written  # without one text over another
    for row, text in enumerate(reversed(rows[: max(room, 0)])):
        _write(picture, text, _scale(picture) * np.array([8.0, below - ROW_PX * row]), WHITE)


def pose_texts(pose: RingPose) -> list[str]:
    """Grasp point, centre, normal and radii as text, with standard deviations where they are reported."""
    tilts = None if pose.covariance is None else pose.covariance[:2, :2]
    texts = [
        f"grasp {_millimetres(pose.grasp_m, pose.covariance_grasp_m2)}",
        f"centre {_millimetres(pose.center_m, pose.covariance_center_m2)}",
    ]
    if np.isfinite(pose.normal).all():
        sigma = (
            "" if tilts is None or not np.isfinite(tilts).all() else f" +-{np.degrees(standard_deviation(tilts)):.3f}"
        )
        texts.append(f"pitch {np.degrees(pose.pitch_rad):.2f} yaw {np.degrees(pose.yaw_rad):.2f}{sigma} deg")
    radii = [
        f"{1e3 * radius_m:.2f}" if np.isfinite(radius_m) else "unknown"
        for radius_m in (pose.radius_inner_m, pose.radius_outer_m)
    ]
    return [*texts, f"radii {' and '.join(radii)} mm"]


def _millimetres(point_m: Float64[Array, "3"], covariance_m2: Float64[Array, "3 3"] | None) -> str:
    if not np.isfinite(point_m).all():
        return "not determined"
    sigma = "" if covariance_m2 is None else f" +-{1e3 * standard_deviation(covariance_m2):.2f}"
    return f"{', '.join(f'{value:.2f}' for value in 1e3 * point_m)}{sigma} mm"


def _wrapped(picture: UInt8[Array, "row column 3"], text: str) -> list[str]:
    """The text in rows that fit into the picture."""
    return textwrap.wrap(text, max(int((picture.shape[1] / _scale(picture) - 12.0) / LETTER_PX), 8))


def _write_rows(picture: UInt8[Array, "row column 3"], texts: Sequence[str], first: Color = WHITE) -> int:
    """Write texts from the upper left corner on, the first row in its own colour; returns the number of rows."""
    rows = [row for text in texts for row in _wrapped(picture, text)]
    for number, text in enumerate(rows):
        position = _scale(picture) * np.array([8.0, 20.0 + ROW_PX * number])
        _write(picture, text, position, WHITE if number else first)
    return len(rows)


def _write(picture: UInt8[Array, "row column 3"], text: str, position: Float64[Array, "2"], color: Color) -> None:
    """Draw a text, shifted where necessary so that it lies inside the picture."""
    ascii_text = text.encode("ascii", "replace").decode()
    size = 0.45 * _scale(picture)
    (width, height), _ = cv2.getTextSize(ascii_text, _FONT, size, 1)
    highest = np.array([picture.shape[1] - width - 3, picture.shape[0] - 4])
    column, row = np.maximum(np.minimum(np.round(position), highest), [3, height + 2]).astype(int).tolist()
    for x, y in ((-1, 0), (1, 0), (0, -1), (0, 1)):  # an outline; in OpenCV 5 thicker letters would also be wider
        cv2.putText(picture, ascii_text, (column + x, row + y), _FONT, size, (0, 0, 0), 1, cv2.LINE_AA)
    cv2.putText(picture, ascii_text, (column, row), _FONT, size, color, 1, cv2.LINE_AA)


def _scale(picture: UInt8[Array, "row column 3"]) -> float:
    """Magnification of texts: they stay readable when a large picture is shown on a screen."""
    return max(1.0, int(picture.shape[1]) / TEXT_WIDTH_PX)


def _fixed(points: Float64[Array, "n 2"]) -> list[tuple[int, int]]:
    """Points in OpenCV's fixed-point coordinates."""
    fixed: Int64[Array, "n 2"] = np.round(points * (1 << _BITS)).astype(np.int64)
    return [(x, y) for x, y in fixed.tolist()]
