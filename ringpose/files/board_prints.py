"""Printable calibration boards: PDF at true scale."""

from pathlib import Path

from ringpose.calibrate.boards.drawing import BoardDrawing
from ringpose.errors import UsageError
from ringpose.files import atomic

POINT_M = 0.0254 / 72
"""Unit of length in PDF, 1/72 inch, in metres."""


def write_board_print(path: Path, drawing: BoardDrawing, *, force: bool = False) -> None:
    """Write one page of the drawing's size, with a request to viewers to print it without scaling."""
    require_pdf(path)
    with atomic.replacing(path, force) as stream:
        stream.write(pdf(drawing))


def require_pdf(path: Path) -> None:
    """Reject an output whose name does not end with .pdf."""
    if path.suffix.lower() != ".pdf":
        found = f"{path.name} is not a .pdf"
        raise UsageError(
            "--print-board",
            found,
            "end it with .pdf; pdftocairo converts it to SVG or PNG at the same scale",
        )


def pdf(drawing: BoardDrawing) -> bytes:
    """The PDF file; all black shapes are one path, so that viewers show no seams between adjacent squares."""
    from reportlab.pdfgen.canvas import Canvas

    top = drawing.height_m / POINT_M
    canvas = Canvas("", pagesize=(drawing.width_m / POINT_M, top), pdfVersion=(1, 7))
    canvas.setViewerPreference("PrintScaling", "None")
    canvas.setTitle("Calibration board")
    black = canvas.beginPath()
    for x, y, width, height in (drawing.rectangles_m / POINT_M).tolist():
        black.rect(x, top - y - height, width, height)
    for x, y, radius in (drawing.circles_m / POINT_M).tolist():
        black.circle(x, top - y, radius)
    canvas.drawPath(black, stroke=0, fill=1)
    for label in drawing.labels:
        canvas.setFont("Helvetica", label.height_m / POINT_M)
        text = label.text.encode("latin-1", "replace").decode("latin-1")  # the characters of the font
        canvas.drawString(label.x_m / POINT_M, top - label.y_m / POINT_M, text)
    return bytes(canvas.getpdfdata())
