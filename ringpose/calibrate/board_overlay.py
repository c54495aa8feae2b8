"""A board's corners drawn into its image."""

import cv2
import numpy as np
from jaxtyping import UInt, UInt8

from ringpose.calibrate.board_views import NoBoard, grey_8_bit
from ringpose.types.arrays import Array
from ringpose.types.board import BoardView

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
