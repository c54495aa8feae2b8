"""The line detectors of OpenCV and those of ringpose behind one interface.

Each takes an 8-bit image and returns segments in pixels; (0, 0) is the centre of the top-left pixel. The detectors of
OpenCV run with its default parameters.
"""

from collections.abc import Callable
from enum import StrEnum
from typing import Any

import cv2
import numpy as np

from ringpose.detect.line_segments import SegmentParameters, find_segments
from ringpose.detect.stripes import find_stripes
from ringpose.types.arrays import Array, Float64, UInt8
from ringpose.types.detection import Segments, Stripes
from ringpose.types.options import SegmentMethod

Detector = Callable[[UInt8[Array, "row column"]], Segments]


class DetectorName(StrEnum):
    """The detectors that are compared."""

    EDGE_DRAWING = "EdgeDrawing"
    """Akinlar and Topal 2012; the reference for times."""
    LSD = "LSD"
    """Grompone von Gioi et al. 2010."""
    FAST_LINES = "FastLineDetector"
    """Lee et al. 2014, without its merging, which takes seconds in clutter."""
    HOUGH = "Canny+HoughLinesP"
    LENGTH = "ringpose length"
    """The paper's detector."""
    REFINED = "ringpose refined"
    STRIPES = "ringpose stripes"
    """Stripe centres instead of the stripes' two edges."""


GIVES_CENTERS = (DetectorName.STRIPES,)
"""Detectors whose segments run along the centre of a stripe; those of the others run along its edges."""

LSD_SCALE = 0.8
"""Factor by which the LSD of OpenCV scales the image first, by default."""

LSD_SHIFT_PX = 0.5 / LSD_SCALE - 0.5
"""LSD divides positions by its scale as if the corner of pixel (0, 0) were the origin; relative to pixel centres they
are 0.125 px too small. Measured on stripes: 0.12 px."""

FAST_LINES_MIN_PX = 6
"""The FastLineDetector of OpenCV clears this many pixels at two corners, and throws if the image is smaller."""


def detector(name: DetectorName) -> Detector:
    """A detector that keeps its state between calls; it must not be shared between threads."""
    return _MAKERS[name]()


def stripe_segments(stripes: Stripes) -> Segments:
    """The least-squares line of each piece of a stripe from its first to its last column; rows have equal weight."""
    count, piece = len(stripes.laser), stripes.piece
    support = np.bincount(piece, minlength=count)
    x, y = stripes.position_px.T
    middle = np.bincount(piece, x, count) / support, np.bincount(piece, y, count) / support
    along = x - middle[0][piece]
    spread = np.bincount(piece, along**2, count)
    slope = np.bincount(piece, along * (y - middle[1][piece]), count) / np.where(spread > 0, spread, 1.0)
    last = np.cumsum(support) - 1
    ends = x[np.stack([last - support + 1, last])]
    rows = middle[1] + slope * (ends - middle[0])
    return Segments(
        start_px=np.column_stack([ends[0], rows[0]]),
        end_px=np.column_stack([ends[1], rows[1]]),
        support=support.astype(np.int64),
    )


def segments_of(lines: Any, shift_px: float = 0.0) -> Segments:
    """Segments from the lines that OpenCV returns: None, or x1, y1, x2, y2 with (4) or without (5) an axis of length 1.

    OpenCV does not report their support; it is taken as the number of pixels along the longer axis.
    """
    rows = np.zeros((0, 4)) if lines is None else np.asarray(lines, dtype=np.float64).reshape(-1, 4)
    ends: Float64[Array, "segment end=2 xy=2"] = rows.reshape(-1, 2, 2) + shift_px
    steps = np.abs(ends[:, 1] - ends[:, 0]).max(axis=1, initial=0.0)
    return Segments(start_px=ends[:, 0], end_px=ends[:, 1], support=np.rint(steps).astype(np.int64) + 1)


def _edge_drawing() -> Detector:
    drawing = cv2.ximgproc.createEdgeDrawing()

    def segments(image: UInt8[Array, "row column"]) -> Segments:
        drawing.detectEdges(image)
        return segments_of(drawing.detectLines())

    return segments


def _lsd() -> Detector:
    lsd = cv2.createLineSegmentDetector()
    return lambda image: segments_of(lsd.detect(image)[0], LSD_SHIFT_PX)


def _fast_lines() -> Detector:
    fast = cv2.ximgproc.createFastLineDetector()
    return lambda image: segments_of(fast.detect(image) if min(image.shape) >= FAST_LINES_MIN_PX else None)


def _hough() -> Detector:
    """Canny at 50 and 150; votes of 30, lines of at least 20 px across gaps of at most 5."""

    def segments(image: UInt8[Array, "row column"]) -> Segments:
        edges = cv2.Canny(image, 50, 150)
        return segments_of(cv2.HoughLinesP(edges, 1, np.pi / 180, 30, minLineLength=20, maxLineGap=5))

    return segments


_MAKERS: dict[DetectorName, Callable[[], Detector]] = {
    DetectorName.EDGE_DRAWING: _edge_drawing,
    DetectorName.LSD: _lsd,
    DetectorName.FAST_LINES: _fast_lines,
    DetectorName.HOUGH: _hough,
    DetectorName.LENGTH: lambda: lambda image: find_segments(image, SegmentParameters(), SegmentMethod.LENGTH),
    DetectorName.REFINED: lambda: lambda image: find_segments(image, SegmentParameters(), SegmentMethod.REFINED),
    DetectorName.STRIPES: lambda: lambda image: stripe_segments(find_stripes(image)),
}
