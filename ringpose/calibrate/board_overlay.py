"""A board's corners drawn into its image."""

import cv2
import numpy as np

from ringpose.calibrate.board_views import NoBoard, grey_8_bit
from ringpose.types.arrays import Array, UInt, UInt8
from ringpose.types.board import BoardView
from ringpose.types.calibration import StripeView

_STRIPES = ((80, 160, 255), (80, 255, 80), (255, 160, 80))
_UNLABELLED = (255, 80, 255)
_CORNER, _FIRST, _TEXT = (60, 60, 255), (60, 255, 60), (60, 255, 255)


def board_overlay(image: UInt[Array, "row column"], found: BoardView | NoBoard) -> UInt8[Array, "row column color=3"]:
    """BGR image: each corner a ring, the first one green; or the reason why there are none."""
    drawn = cv2.cvtColor(grey_8_bit(image), cv2.COLOR_GRAY2BGR)
    if isinstance(found, NoBoard):
        cv2.putText(drawn, found.value, (20, 40), cv2.FONT_HERSHEY_SIMPLEX, 0.8, _TEXT, 2, cv2.LINE_AA)
        return np.asarray(drawn, dtype=np.uint8)
    for number, (x, y) in zip(found.ids, found.points_px, strict=True):
        color = _FIRST if number == found.ids[0] else _CORNER
        cv2.circle(drawn, (round(float(x) * 16), round(float(y) * 16)), 16 * 5, color, 1, cv2.LINE_AA, 4)
    return np.asarray(drawn, dtype=np.uint8)


def stripe_overlay(image: UInt[Array, "row column"], view: StripeView) -> UInt8[Array, "row column color=3"]:
    """BGR image: the board's corners, and each laser's stripe centres in its colour; magenta if not told apart."""
    drawn = board_overlay(image, view.board)
    colored = [(_STRIPES[laser % len(_STRIPES)], px) for laser, px in enumerate(view.stripes_px)]
    for color, points_px in colored + [(_UNLABELLED, px) for px in view.unlabelled_px]:
        for x, y in points_px:
            cv2.circle(drawn, (round(float(x)), round(float(y))), 2, color, -1)
    for line, remark in enumerate(view.remarks):
        cv2.putText(drawn, remark, (20, 40 * (line + 1)), cv2.FONT_HERSHEY_SIMPLEX, 0.8, _TEXT, 2, cv2.LINE_AA)
    return drawn
