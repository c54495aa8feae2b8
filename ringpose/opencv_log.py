"""Suppression of OpenCV's log on stderr where ringpose reports the same problem as an error."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import cv2

_SILENT = 0
"""LOG_LEVEL_SILENT in all versions of OpenCV."""


@contextmanager
def silent_opencv() -> Iterator[None]:
    """Silence OpenCV's log while the block runs, then restore its level.

    The function that sets the level is `cv2.setLogLevel` up to version 4.12 and `cv2.utils.logging.setLogLevel` from
    4.13 on. Messages of the image codecs themselves (libpng, libjpeg) do not go through this log.
    """
    opencv: Any = cv2
    set_level = opencv.setLogLevel if hasattr(opencv, "setLogLevel") else opencv.utils.logging.setLogLevel
    level = set_level(_SILENT)
    try:
        yield
    finally:
        set_level(level)
