"""Drawings of calibration boards as PDF, at true scale."""

from pathlib import Path

from ringpose.calibrate.boards.drawing import BoardDrawing
from ringpose.errors import UsageError
from ringpose.files import atomic

POINT_M = 0.0254 / 72
"""The unit of PDF."""


def write_board_print(path: Path, drawing: BoardDrawing, *, force: bool = False) -> None:
    """One page of the drawing's size, which viewers are asked to print without scaling."""
    require_pdf(path)
    with atomic.replacing(path, force) as stream:
        stream.write(pdf(drawing))


def require_pdf(path: Path) -> None:
    """Refuse a file that would not be recognised as PDF."""
    if path.suffix.lower() != ".pdf":
        found = f"{path.name} is not a .pdf"
        raise UsageError("--print-board", found, "name it so; pdftocairo converts it to SVG or PNG at the same scale")


def pdf(drawing: BoardDrawing) -> bytes:
    """The file's bytes; all that is black is one path, so that no seam shows between neighbours."""
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
        text = label.text.encode("latin-1", "replace").decode("latin-1")  # all that the font has
        canvas.drawString(label.x_m / POINT_M, top - label.y_m / POINT_M, text)
    return bytes(canvas.getpdfdata())
