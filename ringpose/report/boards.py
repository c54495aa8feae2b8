"""A board's corners drawn into its image."""

import textwrap
from collections.abc import Sequence

import cv2
import numpy as np

from ringpose.calibrate.boards.diagnostics import NoBoard
from ringpose.calibrate.boards.patterns.image_patch import grey_8_bit, reduced
from ringpose.types.arrays import Array, UInt, UInt8
from ringpose.types.board import BoardView
from ringpose.types.calibration import StripeView

_STRIPES = ((80, 160, 255), (80, 255, 80), (255, 160, 80))
"""Colours of the lasers' stripes (BGR)."""
_LETTER_PX = 19.0
"""Upper bound of a letter's width at scale 1."""
_UNLABELLED = (255, 80, 255)
_CORNER, _FIRST, _TEXT = (60, 60, 255), (60, 255, 60), (60, 255, 255)


THUMBNAIL_PX = 480
"""Approximate width of the images in a report, which shows three in a row."""


def thumbnail(image: UInt[Array, "row column"]) -> UInt8[Array, "small_row small_column"]:
    """The image in 8 bits, reduced for a report."""
    return grey_8_bit(reduced(image, max(round(image.shape[1] / THUMBNAIL_PX), 1)))


def board_overlay(image: UInt[Array, "row column"], view: BoardView | NoBoard) -> UInt8[Array, "row column color=3"]:
    """BGR image with a circle at each corner, the first one green; or with the reason why there are none."""
    drawn = cv2.cvtColor(grey_8_bit(image), cv2.COLOR_GRAY2BGR)
    if isinstance(view, NoBoard):
        for x, y in view.points_px:
            cv2.circle(drawn, (round(float(x) * 16), round(float(y) * 16)), 16 * 5, _TEXT, 1, cv2.LINE_AA, 4)
        return _with_text(drawn, (f"no board: {view.failure.value}", view.finding))
    for number, (x, y) in zip(view.ids, view.points_px, strict=True):
        color = _FIRST if number == view.ids[0] else _CORNER
        cv2.circle(drawn, (round(float(x) * 16), round(float(y) * 16)), 16 * 5, color, 1, cv2.LINE_AA, 4)
    return np.asarray(drawn, dtype=np.uint8)


def stripe_overlay(image: UInt[Array, "row column"], view: StripeView) -> UInt8[Array, "row column color=3"]:
    """BGR image with the board's corners and each laser's stripe centres in its colour; magenta if not assigned."""
    drawn = board_overlay(image, view.board)
    colored = [(_STRIPES[laser % len(_STRIPES)], px) for laser, px in enumerate(view.stripes_px)]
    for color, points_px in colored + [(_UNLABELLED, px) for px in view.unlabelled_px]:
        for x, y in points_px:
            cv2.circle(drawn, (round(float(x)), round(float(y))), 2, color, -1)
    return _with_text(drawn, view.remarks)


def _with_text(drawn: UInt8[Array, "row column color=3"], lines: Sequence[str]) -> UInt8[Array, "row column color=3"]:
    """The image with lines of text on a darkened strip at the top; long lines are wrapped."""
    width = drawn.shape[1]
    scale = max(width / 1600, 0.4)
    letters = int(width / (_LETTER_PX * scale)) - 2
    broken = [part for line in lines for part in textwrap.wrap(line, letters)]
    step = round(36 * scale)
    drawn[: len(broken) * step + step // 3 * bool(broken)] //= 3
    for line, text in enumerate(broken):
        origin = (step // 2, (line + 1) * step - step // 6)
        cv2.putText(drawn, text, origin, cv2.FONT_HERSHEY_SIMPLEX, scale, _TEXT, max(round(2 * scale), 1), cv2.LINE_AA)
    return drawn
