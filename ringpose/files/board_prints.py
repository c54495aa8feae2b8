"""Drawings of calibration boards as PDF, SVG or PNG, at true scale."""

import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from xml.sax.saxutils import escape

import cv2
import numpy as np

from ringpose.calibrate.board_drawing import BoardDrawing, Label
from ringpose.errors import UsageError
from ringpose.files import atomic
from ringpose.types.arrays import Array, Float64, UInt8

POINT_M = 0.0254 / 72
"""The unit of PDF."""

PIXELS_PER_METRE = 600 / 0.0254
"""Of PNG: what office printers print ..."""

MOST_PIXELS = 2e8
"""... unless the page gets larger than this."""

_CIRCLE = 0.5522847498
"""Length of a Bezier curve's handles that make a quarter of a unit circle."""

_CAP = 0.72
"""Height of a capital letter over the font's size."""


def write_board_print(path: Path, drawing: BoardDrawing, *, force: bool = False) -> None:
    """The drawing in the format that the file's suffix names."""
    require_format(path)
    with atomic.replacing(path, force) as stream:
        stream.write(_FORMATS[path.suffix.lower()](drawing))


def require_format(path: Path) -> None:
    """Refuse a file whose suffix names no format."""
    if path.suffix.lower() not in _FORMATS:
        raise UsageError("--print-board", f"{path.name} is no .pdf, .svg or .png", "name the file accordingly")


def pdf(drawing: BoardDrawing) -> bytes:
    """One page of the drawing's size, that viewers are asked to print without scaling."""
    width, height = drawing.width_m / POINT_M, drawing.height_m / POINT_M
    content = "\n".join(_pdf_content(drawing)).encode("latin-1", "replace")
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.4f} {height:.4f}] /Contents 4 0 R "
        "/Resources << /Font << /F << /Type /Font /Subtype /Type1 /BaseFont /Helvetica >> >> >> >>".encode(),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
    ]
    body, places = b"%PDF-1.7\n", []
    for number, each in enumerate(objects, 1):
        places.append(len(body))
        body += b"%d 0 obj\n%s\nendobj\n" % (number, each)
    table = "".join(f"{place:010d} 00000 n \n" for place in places)
    count = len(objects) + 1
    tail = f"xref\n0 {count}\n0000000000 65535 f \n{table}trailer\n<< /Size {count} /Root 1 0 R >>\n"
    return body + f"{tail}startxref\n{len(body)}\n%%EOF\n".encode()


def svg(drawing: BoardDrawing) -> bytes:
    """Lengths in millimetres; one path for all that is black, so that no seam shows between neighbours."""
    width, height = 1e3 * drawing.width_m, 1e3 * drawing.height_m
    rectangles = "".join(f"M{x:.5f} {y:.5f}h{w:.5f}v{h:.5f}h{-w:.5f}z" for x, y, w, h in 1e3 * drawing.rectangles_m)
    circles = "".join(f'<circle cx="{x:.5f}" cy="{y:.5f}" r="{r:.5f}"/>\n' for x, y, r in 1e3 * drawing.circles_m)
    labels = "".join(
        f'<text x="{1e3 * label.x_m:.3f}" y="{1e3 * label.y_m:.3f}" font-family="Helvetica, Arial, sans-serif" '
        f'font-size="{1e3 * label.height_m:.3f}">{escape(label.text)}</text>\n'
        for label in drawing.labels
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.4f}mm" height="{height:.4f}mm" '
        f'viewBox="0 0 {width:.4f} {height:.4f}">\n<rect width="100%" height="100%" fill="#fff"/>\n'
        f'<path d="{rectangles}"/>\n{circles}{labels}</svg>\n'
    ).encode()


def png(drawing: BoardDrawing) -> bytes:
    """600 dots per inch, less for pages over A2; edges between pixels are grey as they should be."""
    scale = min(PIXELS_PER_METRE, float(np.sqrt(MOST_PIXELS / (drawing.width_m * drawing.height_m))))
    image = _raster(drawing, scale)
    _, encoded = cv2.imencode(".png", image)
    data = encoded.tobytes()
    dots = struct.pack(">4sIIB", b"pHYs", round(scale), round(scale), 1)
    chunk = struct.pack(">I", 9) + dots + struct.pack(">I", zlib.crc32(dots))
    end_of_header = 33  # signature 8, IHDR 4 + 4 + 13 + 4
    return data[:end_of_header] + chunk + data[end_of_header:]


_FORMATS: dict[str, Callable[[BoardDrawing], bytes]] = {".pdf": pdf, ".svg": svg, ".png": png}


def _pdf_content(drawing: BoardDrawing) -> Iterator[str]:
    top = drawing.height_m / POINT_M
    for x, y, width, height in drawing.rectangles_m / POINT_M:
        yield f"{x:.5f} {top - y - height:.5f} {width:.5f} {height:.5f} re"
    for x, y, radius in drawing.circles_m / POINT_M:
        yield _pdf_circle(x, top - y, radius)
    yield "f"
    for label in drawing.labels:
        text = label.text.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
        x, y, size = label.x_m / POINT_M, top - label.y_m / POINT_M, label.height_m / POINT_M
        yield f"BT /F {size:.3f} Tf {x:.4f} {y:.4f} Td ({text}) Tj ET"


def _pdf_circle(x: float, y: float, radius: float) -> str:
    """Four Bezier curves, true to 0.03 % of the radius."""
    a = _CIRCLE * radius
    r = radius
    quarters = [
        (r, a, a, r, 0.0, r),
        (-a, r, -r, a, -r, 0.0),
        (-r, -a, -a, -r, 0.0, -r),
        (a, -r, r, -a, r, 0.0),
    ]
    curves = [
        f"{x + x1:.5f} {y + y1:.5f} {x + x2:.5f} {y + y2:.5f} {x + x3:.5f} {y + y3:.5f} c"
        for x1, y1, x2, y2, x3, y3 in quarters
    ]
    return " ".join([f"{x + r:.5f} {y:.5f} m", *curves, "h"])


def _raster(drawing: BoardDrawing, scale: float) -> UInt8[Array, "row column"]:
    rows, columns = round(drawing.height_m * scale), round(drawing.width_m * scale)
    black = np.zeros((rows, columns), dtype=np.float32)
    for x, y, width, height in drawing.rectangles_m * scale:
        first_row, down = _covered(y, y + height, rows)
        first_column, across = _covered(x, x + width, columns)
        black[first_row : first_row + len(down), first_column : first_column + len(across)] += np.outer(down, across)
    image = np.rint(255 * (1 - np.clip(black, 0, 1))).astype(np.uint8)
    for x, y, radius in drawing.circles_m * scale:
        center = (round(256 * (x - 0.5)), round(256 * (y - 0.5)))
        cv2.circle(image, center, round(256 * radius), 0, -1, cv2.LINE_AA, 8)
    for label in drawing.labels:
        _put(image, label, scale)
    return image


def _covered(begin: float, end: float, size: int) -> tuple[int, Float64[Array, "pixel"]]:
    """Share of each pixel that lies between begin and end, from the first pixel that does."""
    first, last = max(int(np.floor(begin)), 0), min(int(np.ceil(end)), size)
    edges = np.arange(first, last + 1)
    return first, np.diff(np.clip(edges, begin, end)).astype(np.float64)


def _put(image: UInt8[Array, "row column"], label: Label, scale: float) -> None:
    height_px = _CAP * label.height_m * scale
    font_scale = height_px / cv2.getTextSize("H", cv2.FONT_HERSHEY_SIMPLEX, 1.0, 1)[0][1]
    place = (round(label.x_m * scale), round(label.y_m * scale))
    thickness = max(1, round(height_px / 10))
    cv2.putText(image, label.text, place, cv2.FONT_HERSHEY_SIMPLEX, font_scale, 0, thickness, cv2.LINE_AA)
