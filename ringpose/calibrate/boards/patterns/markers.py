"""ArUco markers: dictionaries and detection."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

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
    """The board's dictionary, predefined in OpenCV or read from a file; it has all the board's markers."""
    name = board.dictionary or ""
    if board.marker_bits:
        dictionary = _custom_dictionary(board.marker_bits)
    elif name.startswith("DICT_") and hasattr(cv2.aruco, name):
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    else:
        remedy = "give one of OpenCV's, for example DICT_4X4_50, or a dictionary file"
        raise DataError("board", f'no dictionary "{name}"', remedy)
    found, needed = len(dictionary.bytesList), marker_count(board)
    if found < needed:
        finding = f'dictionary "{board.dictionary}" has {found} markers, the board has {needed}'
        raise DataError("board", finding, "give a larger dictionary, or correct the number of squares")
    return dictionary


def _custom_dictionary(marker_bits: tuple[str, ...]) -> cv2.aruco.Dictionary:
    """A dictionary that corrects up to (d - 1) / 2 wrong bits, d the minimum Hamming distance of its markers."""
    side = math.isqrt(len(marker_bits[0]))
    bits = np.array([[int(bit) for bit in marker] for marker in marker_bits], dtype=np.uint8).reshape(-1, side, side)
    rows = [cv2.aruco.Dictionary.getByteListFromBits(marker) for marker in bits]
    # The minimum over two markers in any rotation, and over a marker and itself rotated.
    rotated = np.stack([np.rot90(bits, turns, axes=(1, 2)) for turns in range(4)])
    distance = np.sum(rotated[:, :, None] != bits, axis=(-2, -1))
    distance[0][np.diag_indices(len(bits))] = bits[0].size
    return cv2.aruco.Dictionary(np.concatenate(rows), side, (int(distance.min()) - 1) // 2)


def marker_count(board: Board) -> int:
    """Number of markers on the board; zero for boards without markers."""
    if board.kind == "four_markers":
        return 4
    squares = (board.squares_x or 0) * (board.squares_y or 0)
    if board.kind == "aruco_grid":
        return squares
    return squares // 2 if board.kind == "charuco" else 0


def find_markers(image: UInt8[Array, "row column"], dictionary: cv2.aruco.Dictionary) -> Markers:
    """All markers of the dictionary found in the image, with sub-pixel corners."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    found, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(image)
    return markers_of(found, ids)


def markers_of(found: Sequence[Any] | None, ids: Any) -> Markers:
    """OpenCV's detections, sorted by number."""
    if found is None or ids is None or not len(ids):
        return Markers(ids=np.empty(0, dtype=np.int64), corners_px=np.empty((0, 4, 2)))
    corners = np.stack([np.asarray(one, dtype=np.float64).reshape(4, 2) for one in found])
    order = np.argsort(np.asarray(ids).ravel(), kind="stable")
    return Markers(ids=np.asarray(ids).ravel().astype(np.int64)[order], corners_px=corners[order])
