"""Detection of ArUco markers."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from ringpose.types.arrays import Array, Float64, Int64, UInt8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Markers:
    """The markers of one image."""

    ids: Int64[Array, "marker"]
    corners_px: Float64[Array, "marker corner=4 xy=2"]
    """Clockwise from the marker's own top left."""


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
