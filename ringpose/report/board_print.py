"""A calibration board laid out on a page at true scale, with rulers to check the print by, as PDF."""

from dataclasses import dataclass

import numpy as np

from ringpose.geometry.board import LAYOUTS, board_print, corner_points, outline_m
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import Board

PAGES_M = {
    "A4": (0.210, 0.297),
    "A3": (0.297, 0.420),
    "A2": (0.420, 0.594),
    "A1": (0.594, 0.841),
    "A0": (0.841, 1.189),
}
"""Short and long side of the pages that are tried, in metres, the smallest first."""

RIM_M = 0.010
"""Width of the white rim around the board: markers at its edge need it, and printers do not print to the edge."""

RULER_M = 0.014
"""Width of the strips below and to the left of the board, beyond the rim, for the rulers with their numbers."""

TEXT_M = 0.008
"""Height of the strip below the lower ruler, for the description of the board."""

CIRCLE_SHARE = 0.5
"""Diameter of the circles of a circle grid over the spacing of their rows."""

A4_BOARDS = {
    "charuco": Board(
        kind="charuco", squares_x=9, squares_y=6, square_m=0.027, marker_m=0.02, dictionary="DICT_5X5_100"
    ),
    "four_markers": Board(
        kind="four_markers", width_m=0.25, height_m=0.165, marker_m=0.045, margin_m=0.005, dictionary="DICT_4X4_50"
    ),
}
"""Boards that fit on a page of A4, by kind."""

POINT_M = 0.0254 / 72
"""Unit of length in PDF, 1/72 inch, in metres."""

_LETTERS_M = 0.0028
_TICK_M = 0.00015


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """A line of text; its left end and base line."""

    x_m: float
    y_m: float
    text: str
    height_m: float = _LETTERS_M


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardDrawing:
    """Black shapes on a white page; origin at the page's top-left corner, x right, y down."""

    page: str
    """The page's name, or its size."""
    width_m: float
    height_m: float
    rectangles_m: Float64[Array, "rectangle side=4"]
    """x, y, width, height; none overlaps another."""
    circles_m: Float64[Array, "circle side=3"]
    """Centre x, y and radius."""
    labels: tuple[Label, ...]
    origin_m: tuple[float, float]
    """Position of the board frame's origin on the page."""


def board_drawing(board: Board) -> BoardDrawing:
    """The board in the middle of the smallest page that holds it with its rulers, in portrait or landscape."""
    width_m, height_m = outline_m(board)
    needed_m = (width_m + 2 * RIM_M + RULER_M, height_m + 2 * RIM_M + RULER_M + TEXT_M)
    page, page_m = _page(needed_m)
    origin_m = ((page_m[0] - needed_m[0]) / 2 + RULER_M + RIM_M, (page_m[1] - needed_m[1]) / 2 + RIM_M)
    below_m = origin_m[1] + height_m + RIM_M
    across, numbers_x = _ruler(origin_m[0], below_m, width_m)
    down, numbers_y = _ruler(origin_m[1], origin_m[0] - RIM_M, height_m)
    shift = np.array([*origin_m, 0.0, 0.0])
    circles_m = np.empty((0, 3))
    if LAYOUTS[board.kind].pattern == "circles":
        centers_m = corner_points(board)[:, :2] + origin_m
        circles_m = np.column_stack([centers_m, np.full(len(centers_m), CIRCLE_SHARE * board.circle_spacing_m / 2)])
    upright = np.column_stack([down[:, 1] - down[:, 3], down[:, 0], down[:, 3], down[:, 2]])
    names = tuple(
        Label(x_m=origin_m[0] - RIM_M - 0.0125, y_m=number.x_m + _LETTERS_M, text=number.text) for number in numbers_y
    )
    words = Label(x_m=origin_m[0], y_m=below_m + RULER_M + _LETTERS_M, text=_description(board, page, page_m))
    return BoardDrawing(
        page=page,
        width_m=page_m[0],
        height_m=page_m[1],
        rectangles_m=np.concatenate([_black_rectangles(board) + shift, across, upright]),
        circles_m=circles_m,
        labels=(*numbers_x, *names, words),
        origin_m=origin_m,
    )


def _page(needed_m: tuple[float, float]) -> tuple[str, tuple[float, float]]:
    """Name and size of the smallest page that holds an area of this width and height."""
    for name, (short, long) in PAGES_M.items():
        for page_m, way in (((short, long), "portrait"), ((long, short), "landscape")):
            if needed_m[0] <= page_m[0] and needed_m[1] <= page_m[1]:
                return f"{name} {way}", page_m
    return "of its own size", needed_m


def _ruler(start_m: float, beside_m: float, length_m: float) -> tuple[Float64[Array, "tick side=4"], list[Label]]:
    """Ticks every 10 mm along x from `start_m`, hanging below `beside_m`, and numbers in millimetres every 50."""
    steps = np.arange(int(length_m / 0.01 + 1e-6) + 1)
    place = start_m + 0.01 * steps
    height = np.where(steps % 5 == 0, 0.006, 0.003)
    ticks = np.column_stack([place - _TICK_M / 2, np.full(len(steps), beside_m), np.full(len(steps), _TICK_M), height])
    numbers = [
        Label(x_m=float(x) + 0.0006, y_m=beside_m + 0.0095, text=f"{10 * int(step)}{' mm' if step == 0 else ''}")
        for x, step in zip(place, steps, strict=True)
        if step % 5 == 0
    ]
    return ticks, numbers


def _description(board: Board, page: str, page_m: tuple[float, float]) -> str:
    """A line of text with the board's kind and sizes; the rulers show whether the print has another scale."""
    sizes = {
        key.removesuffix("_m"): f"{1e3 * value:g} mm"
        for key in Board.__slots__
        if key.endswith("_m") and (value := getattr(board, key)) is not None
    }
    counts = f" {board.squares_x} x {board.squares_y}" if board.squares_x else ""
    text = ", ".join([f"{board.kind}{counts}", *([board.dictionary] if board.dictionary else [])])
    text += "".join(f", {key} {size}" for key, size in sizes.items())
    return f"{text}. Page {page}, {1e3 * page_m[0]:.0f} x {1e3 * page_m[1]:.0f} mm: print at 100 %, then measure."


def _black_rectangles(board: Board) -> Float64[Array, "rectangle side=4"]:
    """x, y, width and height in the board frame of the black parts of the print, neighbours in a row joined."""
    x_m, y_m, cells = board_print(board)
    rectangles = []
    for row, black in enumerate(cells[1:-1]):
        ends = np.flatnonzero(np.diff(black.astype(np.int8))).reshape(-1, 2)
        rectangles += [(x_m[a], y_m[row], x_m[b] - x_m[a], y_m[row + 1] - y_m[row]) for a, b in ends]
    return np.array(rectangles, dtype=np.float64).reshape(-1, 4)


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
