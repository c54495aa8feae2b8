"""ArUco markers in an image."""

from dataclasses import dataclass

import cv2
import numpy as np

from ringpose.errors import DataError
from ringpose.types.arrays import Array, Float64, Int64, UInt8
from ringpose.types.board import Board


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Markers:
    """The markers of one image."""

    ids: Int64[Array, "marker"]
    corners_px: Float64[Array, "marker corner=4 xy=2"]
    """Clockwise from the marker's own top left."""


def marker_dictionary(board: Board) -> cv2.aruco.Dictionary:
    """OpenCV's predefined dictionary of the board."""
    name = board.dictionary or ""
    number = getattr(cv2.aruco, name, None) if name.startswith("DICT_") else None
    if number is None:
        raise DataError("board", f'no dictionary "{name}"', "give one of OpenCV's, as DICT_4X4_50")
    return cv2.aruco.getPredefinedDictionary(number)


def find_markers(image: UInt8[Array, "row column"], dictionary: cv2.aruco.Dictionary) -> Markers:
    """All the dictionary's markers that the image shows, their corners refined to sub-pixel."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    found, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(image)
    if ids is None or not len(ids):
        return Markers(ids=np.empty(0, dtype=np.int64), corners_px=np.empty((0, 4, 2)))
    corners = np.stack([np.asarray(one, dtype=np.float64).reshape(4, 2) for one in found])
    order = np.argsort(np.asarray(ids).ravel(), kind="stable")
    return Markers(ids=np.asarray(ids).ravel().astype(np.int64)[order], corners_px=corners[order])
