"""Drawing of a detection, and of the pose computed from it, over the image: the only drawing routine for shots."""

import textwrap
from collections.abc import Container, Mapping, Sequence

import cv2
import numpy as np

from ringpose.detect.line_segments import eight_bit
from ringpose.estimate.covariance import standard_deviation
from ringpose.geometry.rays import project
from ringpose.geometry.rotations import tilt_basis
from ringpose.pose.transform import pose_in_frame
from ringpose.types.arrays import EDGES, Array, Bool, Float64, Int64, UInt, UInt8
from ringpose.types.detection import (
    UNLABELLED,
    BreakPointFlag,
    BreakPoints,
    Detection,
    Rejection,
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
NORMAL_COLOR: Color = (80, 255, 255)

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

DISC_SHARE = 0.04
"""Radius of the circle about the arrow, in the ring's plane; it shows the tilt where the arrow points to the camera."""

SCALE_SHARE = 0.15
"""Least length of the scale, as a share of the picture's width; it has 1, 2 or 5 times a power of ten millimetres."""

NEAR_PX = 5.0
"""Distance of a break point from the centres of its stripe; a stripe of another laser is farther away."""

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

_OFFSETS = ((10.0, -8.0), (10.0, 20.0), (-10.0, -8.0), (-10.0, 20.0), (10.0, -28.0), (10.0, 40.0), (-10.0, -28.0))
"""Places of a label beside its point, the best first; with a negative first number it ends there."""

_FONT = cv2.FONT_HERSHEY_SIMPLEX

Box = tuple[int, int, int, int]
"""Left, top, right and bottom of a text."""


def overlay(
    image: UInt[Array, "row column"],
    detection: Detection,
    line: PoseLine | None = None,
    rig: Rig | None = None,
    *,
    with_numbers: bool = True,
) -> UInt8[Array, "row column 3"]:
    """The dimmed image as blue, green, red, with segments, stripes, ring edges and break points drawn over it.

    With a pose line and its rig also the projected ring, the grasp point, the normal, a scale and the status as text;
    what the pose rejected is red. Each laser has its colour, and its name if the rig is given; the half axes of error
    ellipses are `ELLIPSE_SIGMAS` standard deviations, those of the grasp point `GRASP_SIGMAS`. A legend states what is
    drawn. The ring of a moving target is that at the line's `pose_stamp_s`. Without `with_numbers` the pose is drawn,
    but not written.
    """
    picture: UInt8[Array, "row column 3"] = cv2.cvtColor(eight_bit(image) // 2, cv2.COLOR_GRAY2BGR)
    drawing = Drawing(picture, _names(detection, rig))
    pose = None if line is None or rig is None else pose_in_camera_frame(line, rig)
    if pose is not None and rig is not None:
        _draw_ring(drawing, pose, rig.camera)
    _draw_detection(drawing, detection, line)
    if pose is not None and rig is not None:
        _draw_grasp_point(drawing, pose, rig.camera)
    if line is None:
        _write_rows(drawing, [f"{detection.shot}: {detection.summary}"])
    else:
        _write_status(drawing, line, pose if with_numbers else None)
    _write_legend(drawing)
    if pose is not None and rig is not None:
        _draw_scale(drawing, pose, rig.camera)
    write_labels(drawing)
    return picture


def _draw_detection(drawing: "Drawing", detection: Detection, line: PoseLine | None) -> None:
    """Segments, stripes, ring edges and break points; what detection or pose have rejected is red."""
    rejections = detection.rejected if line is None else line.rejected
    rejected = _rejected(line, rejections, drawing.names)
    if detection.segments is not None:
        _draw_segments(drawing.picture, detection.segments)
    if detection.stripes is not None:
        _draw_stripes(drawing.picture, detection.stripes, rejected)
    if detection.ring_edges is not None:
        _draw_ring_edges(drawing, detection.ring_edges, {each.edge for each in rejections if each.what == "edge"})
    if isinstance(detection.break_points, BreakPoints):
        _draw_break_points(drawing, detection.break_points, rejected)
        _draw_left_out(drawing, detection.break_points, detection.stripes, rejected)
        if drawing.labels:
            drawing.explain(f"ellipses of break points: {ELLIPSE_SIGMAS:.0f} sigmas", UNLABELLED_COLOR)


class Drawing:
    """A picture with the labels and the legend that it will have, and the places that texts have taken."""

    def __init__(self, picture: UInt8[Array, "row column 3"], names: Sequence[str] = ()) -> None:
        self.picture, self.names = picture, names
        self.labels: list[tuple[str, Float64[Array, "2"], Color]] = []
        """Text, point and colour."""
        self.legend: dict[str, Color] = {}
        self.taken: list[Box] = []

    @property
    def scale(self) -> float:
        """Magnification of texts: they stay readable when a large picture is shown on a screen."""
        return max(1.0, int(self.picture.shape[1]) / TEXT_WIDTH_PX)

    def explain(self, what: str, color: Color) -> None:
        """Add an entry to the legend."""
        self.legend.setdefault(what, color)

    def write(self, text: str, position: Float64[Array, "2"], color: Color) -> None:
        """Draw a text, shifted where necessary so that it lies inside the picture."""
        box = self.box(text, position)
        self.taken.append(box)
        ascii_text, size = _ascii(text), 0.45 * self.scale
        for x, y in ((-1, 0), (1, 0), (0, -1), (0, 1)):  # an outline; in OpenCV 5 thicker letters would also be wider
            cv2.putText(self.picture, ascii_text, (box[0] + x, box[3] + y), _FONT, size, (0, 0, 0), 1, cv2.LINE_AA)
        cv2.putText(self.picture, ascii_text, (box[0], box[3]), _FONT, size, color, 1, cv2.LINE_AA)

    def box(self, text: str, position: Float64[Array, "2"]) -> Box:
        """Where a text is drawn whose lower left corner is at a position, or moved into the picture."""
        (width, height), _ = cv2.getTextSize(_ascii(text), _FONT, 0.45 * self.scale, 1)
        highest = np.array([self.picture.shape[1] - width - 3, self.picture.shape[0] - 4])
        column, row = np.maximum(np.minimum(np.round(position), highest), [3, height + 2]).astype(int).tolist()
        return column, row - height, column + width, row

    def is_free(self, box: Box) -> bool:
        """Whether no text is there."""
        left, top, right, bottom = box
        return all(right < other[0] or left > other[2] or bottom < other[1] or top > other[3] for other in self.taken)


def _ascii(text: str) -> str:
    return text.encode("ascii", "replace").decode()


def _names(detection: Detection, rig: Rig | None) -> tuple[str, ...]:
    """Names of the lasers; their numbers from 1 without a rig."""
    if rig is not None:
        return rig.lasers.names
    points = detection.break_points
    return tuple(str(number + 1) for number in range(len(points.seen) if isinstance(points, BreakPoints) else 0))


def captioned(image: UInt[Array, "row column"], caption: str) -> UInt8[Array, "row column 3"]:
    """The image as blue, green, red, with a caption in its upper left corner."""
    picture: UInt8[Array, "row column 3"] = cv2.cvtColor(eight_bit(image), cv2.COLOR_GRAY2BGR)
    _write_rows(Drawing(picture), [caption])
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


def _draw_ring_edges(drawing: Drawing, edges: RingEdgePoints, rejected: Container[str | None]) -> None:
    along = EDGE_HALF_LENGTH_PX * edges.normal[:, ::-1] * np.array([-1.0, 1.0])
    starts, ends = _fixed(edges.position_px - along), _fixed(edges.position_px + along)
    for start, end, edge in zip(starts, ends, edges.edge.tolist(), strict=True):
        is_rejected = EDGES[edge] in rejected
        color = REJECTED_COLOR if is_rejected else EDGE_COLORS[edge]
        drawing.explain(REJECTED if is_rejected else f"visible {EDGES[edge]} edge", color)
        cv2.line(drawing.picture, start, end, color, 1, cv2.LINE_AA, _BITS)


REJECTED = "rejected"
"""In the legend, and of a break point."""


def _draw_break_points(drawing: Drawing, points: BreakPoints, rejected: Rejected) -> None:
    if points.opposite is not None:
        _draw_break_points(drawing, points.opposite, rejected)
    for laser in np.flatnonzero(points.seen.all(axis=1)).tolist():
        inner, outer = _fixed(points.position_px[laser])
        color = REJECTED_COLOR if (laser, None) in rejected else color_of(laser)
        cv2.line(drawing.picture, inner, outer, color, 1, cv2.LINE_AA, _BITS)
    for laser, edge in np.argwhere(points.seen).tolist():
        is_rejected = not rejected.isdisjoint({(laser, None), (laser, edge)})
        flags = [str(flag.name).lower() for flag in BreakPointFlag if points.flags[laser, edge] & flag]
        _draw_break_point(drawing, laser, edge, points.position_px[laser, edge], flags, is_rejected=is_rejected)
        color = REJECTED_COLOR if is_rejected else color_of(laser)
        _draw_ellipse(drawing.picture, points.position_px[laser, edge], points.covariance_px2[laser, edge], color)


def _draw_break_point(
    drawing: Drawing,
    laser: int,
    edge: int,
    position: Float64[Array, "2"],
    flags: Sequence[str] = (),
    *,
    is_rejected: bool,
) -> None:
    name, color = drawing.names[laser], REJECTED_COLOR if is_rejected else color_of(laser)
    pixel = tuple(np.round(position).astype(int).tolist())
    cv2.drawMarker(drawing.picture, pixel, color, cv2.MARKER_CROSS, 9, 1, cv2.LINE_AA)
    cv2.circle(drawing.picture, _fixed(position[None])[0], 6 << _BITS, color, 1, cv2.LINE_AA, _BITS)
    drawing.explain(REJECTED if is_rejected else f"laser {name}", color)
    words = [*flags, REJECTED] if is_rejected else flags
    drawing.labels.append((f"{name} {EDGES[edge]}", position, color))
    if words:
        drawing.labels.append((" ".join(words), position, REJECTED_COLOR if is_rejected else FLAG_COLOR))


def _draw_left_out(drawing: Drawing, points: BreakPoints, stripes: Stripes | None, rejected: Rejected) -> None:
    """The end of a stripe that was rejected as the ring's edge, so that it is no break point: beyond the other end."""
    for laser, edge in rejected:
        if stripes is None or edge is None or points.seen[laser, edge] or not points.seen[laser, 1 - edge]:
            continue
        kept = points.position_px[laser, 1 - edge]
        distance_px = np.linalg.norm(stripes.position_px - kept, axis=1)
        nearest = int(np.argmin(distance_px))
        if distance_px[nearest] > NEAR_PX:
            continue
        piece = stripes.position_px[stripes.piece == stripes.piece[nearest]]
        end = piece[int(np.argmax(np.linalg.norm(piece - kept, axis=1)))]
        _draw_break_point(drawing, laser, edge, end, is_rejected=True)


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


def _rejected(line: PoseLine | None, rejections: Sequence[Rejection], names: Sequence[str]) -> Rejected:
    states = {} if line is None else line.lasers
    by_state = {
        (names.index(name), None) for name, state in states.items() if state is LaserState.REJECTED and name in names
    }
    listed = {
        (
            names.index(str(rejection.laser)),
            None if rejection.edge is None or rejection.what == "stripe" else EDGES.index(rejection.edge),
        )
        for rejection in rejections
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


def _draw_ring(drawing: Drawing, pose: RingPose, camera: Camera) -> None:
    """Draw the projected edges, as far as the pose determines them."""
    if not np.isfinite([*pose.center_m, *pose.normal]).all():
        return
    angle = np.linspace(0.0, 2.0 * np.pi, RING_POINTS + 1)
    circle = np.cos(angle)[:, None] * (axes := tilt_basis(pose.normal))[0] + np.sin(angle)[:, None] * axes[1]
    for radius_m, color, edge in zip((pose.radius_inner_m, pose.radius_outer_m), RING_COLORS, EDGES, strict=True):
        if np.isfinite(radius_m):
            curve_px = project(pose.center_m + radius_m * circle, camera)
            _draw_curve(drawing.picture, curve_px, color)
            if _is_inside(drawing.picture, curve_px).any():
                drawing.explain(f"{edge} edge of the pose", color)


def _draw_curve(picture: UInt8[Array, "row column 3"], points_px: Float64[Array, "n 2"], color: Color) -> None:
    """A polyline, interrupted at points that cannot be projected or are far outside the image."""
    near = (np.abs(np.nan_to_num(points_px, nan=np.inf)) < _MAX_PX).all(axis=1)
    for first in np.flatnonzero(near[:-1] & near[1:]).tolist():
        start, end = _fixed(points_px[first : first + 2])
        cv2.line(picture, start, end, color, 1, cv2.LINE_AA, _BITS)


def _is_inside(picture: UInt8[Array, "row column 3"], points_px: Float64[Array, "n 2"]) -> Bool[Array, "n"]:
    inside: Bool[Array, "n"] = ((points_px >= 0) & (points_px < picture.shape[1::-1])).all(axis=1)
    return inside


def _draw_grasp_point(drawing: Drawing, pose: RingPose, camera: Camera) -> None:
    """The grasp point with its error ellipse, and an arrow along the normal from a circle in the ring's plane."""
    picture = drawing.picture
    if not np.isfinite(pose.grasp_m).all():
        return
    position = project(pose.grasp_m[None], camera)[0]
    if not np.abs(np.nan_to_num(position, nan=np.inf)).max() < _MAX_PX:
        return
    drawing.explain(f"grasp point, its ellipse: {GRASP_SIGMAS:.0f} sigmas", WHITE)
    if pose.covariance_grasp_m2 is not None:
        step_m = 1e-6 * float(np.linalg.norm(pose.grasp_m))
        stepped = project(pose.grasp_m + step_m * np.eye(3), camera)
        jacobian = (stepped - position).T / step_m
        covariance = jacobian @ pose.covariance_grasp_m2 @ jacobian.T
        _draw_ellipse(picture, position, covariance, WHITE, GRASP_SIGMAS)
    cv2.circle(picture, _fixed(position[None])[0], 4 << _BITS, WHITE, -1, cv2.LINE_AA, _BITS)
    if not np.isfinite(pose.normal).all():
        return
    distance_m = float(np.linalg.norm(pose.grasp_m))
    axes, angle = tilt_basis(pose.normal), np.linspace(0.0, 2.0 * np.pi, 73)
    circle = np.cos(angle)[:, None] * axes[0] + np.sin(angle)[:, None] * axes[1]
    _draw_curve(picture, project(pose.grasp_m + DISC_SHARE * distance_m * circle, camera), NORMAL_COLOR)
    tip = project((pose.grasp_m + NORMAL_SHARE * distance_m * pose.normal)[None], camera)[0]
    if np.abs(np.nan_to_num(tip, nan=np.inf)).max() < _MAX_PX:
        start, end = (tuple(np.round(point).astype(int).tolist()) for point in (position, tip))
        for color, width in (((0, 0, 0), 6), (NORMAL_COLOR, 3)):
            cv2.arrowedLine(picture, start, end, color, width, cv2.LINE_AA, 0, 0.2)
        drawing.explain("normal, and a circle about it", NORMAL_COLOR)


def _write_status(drawing: Drawing, line: PoseLine, pose: RingPose | None) -> None:
    """Status, flags and reason; what the pose is in the camera frame, with standard deviations."""
    unused = [f"{name} {str(state).replace('_', ' ')}" for name, state in line.lasers.items() if state != "used"]
    texts = [f"{line.shot}: {line.status}"]
    texts += [", ".join(line.flag_names), line.reason or "", f"lasers: {', '.join(unused)}" if unused else ""]
    written = _write_rows(drawing, texts, STATUS_COLORS[line.status])
    if pose is None:
        return
    below = drawing.picture.shape[0] / drawing.scale - 12.0
    rows = [row for text in pose_texts(pose) for row in _wrapped(drawing, text)]
    room = int((below - 20.0) / ROW_PX) - written  # without one text over another
    for row, text in enumerate(reversed(rows[: max(room, 0)])):
        drawing.write(text, drawing.scale * np.array([8.0, below - ROW_PX * row]), WHITE)


def _write_legend(drawing: Drawing) -> None:
    """What the colours mean, in the lower right corner as far as there is room."""
    height, width = (int(size) for size in drawing.picture.shape[:2])
    for row, (text, color) in enumerate(reversed(drawing.legend.items())):
        position = np.array([float(width), height - drawing.scale * (12.0 + ROW_PX * (row + 1))])  # below: the scale
        box = drawing.box(text, position)
        if box[0] > 0.6 * width and box[1] > 0.4 * height and drawing.is_free(box):
            drawing.write(text, position, color)


def _draw_scale(drawing: Drawing, pose: RingPose, camera: Camera) -> None:
    """A bar of a round length at the distance of the grasp point, in the lower right corner."""
    distance_m = float(pose.grasp_m[2])
    if not distance_m > 0:
        return
    height, width = (int(size) for size in drawing.picture.shape[:2])
    px_per_m = float(camera.camera_matrix[0, 0]) / distance_m
    least_m = SCALE_SHARE * width / px_per_m
    power = 10.0 ** np.floor(np.log10(least_m))
    length_m = float(power * next(step for step in (1, 2, 5, 10) if step * power >= least_m))
    text = f"{1e3 * length_m:g} mm at the grasp point"
    right, row = width - 6, height - 4
    box = drawing.box(text, np.array([float(width), row - 6.0]))
    if not drawing.is_free(box):
        return
    drawing.write(text, np.array([float(width), row - 6.0]), WHITE)
    cv2.line(drawing.picture, (round(right - px_per_m * length_m), row), (right, row), WHITE, 3)


def write_labels(drawing: Drawing) -> None:
    """Each label at the best free place beside its point, or below it."""
    for text, point, color in drawing.labels:
        places = [drawing.scale * np.array(offset) for offset in _OFFSETS]
        places += [drawing.scale * np.array([10.0, 60.0 + ROW_PX * row]) for row in range(10)]
        (width, _), _ = cv2.getTextSize(_ascii(text), _FONT, 0.45 * drawing.scale, 1)
        positions = [point + place - (np.array([width, 0.0]) if place[0] < 0 else 0.0) for place in places]
        free = (position for position in positions if drawing.is_free(drawing.box(text, position)))
        drawing.write(text, next(free, positions[0]), color)


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


def _wrapped(drawing: Drawing, text: str) -> list[str]:
    """The text in rows that fit into the picture."""
    return textwrap.wrap(text, max(int((drawing.picture.shape[1] / drawing.scale - 12.0) / LETTER_PX), 8))


def _write_rows(drawing: Drawing, texts: Sequence[str], first: Color = WHITE) -> int:
    """Write texts from the upper left corner on, the first row in its own colour; returns the number of rows."""
    rows = [row for text in texts for row in _wrapped(drawing, text)]
    for number, text in enumerate(rows):
        position = drawing.scale * np.array([8.0, 20.0 + ROW_PX * number])
        drawing.write(text, position, WHITE if number else first)
    return len(rows)


def _fixed(points: Float64[Array, "n 2"]) -> list[tuple[int, int]]:
    """Points in OpenCV's fixed-point coordinates."""
    fixed: Int64[Array, "n 2"] = np.round(points * (1 << _BITS)).astype(np.int64)
    return [(x, y) for x, y in fixed.tolist()]
