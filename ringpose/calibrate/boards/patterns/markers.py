"""Detection of ArUco markers, and checks of their layout against the board."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from ringpose.geometry.board import marker_corners, marker_ids
from ringpose.types.arrays import Array, Float64, Int64, UInt8
from ringpose.types.board import MAX_SQUARES, Board


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Markers:
    """The markers of one image."""

    ids: Int64[Array, "marker"]
    corners_px: Float64[Array, "marker corner=4 xy=2"]
    """Clockwise from the marker's own top left."""


def find_markers(image: UInt8[Array, "row column"], dictionary: cv2.aruco.Dictionary, border_cells: int = 1) -> Markers:
    """All markers of the dictionary found in the image, with sub-pixel corners."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border_cells
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(image)
    return markers_of(corners, ids)


def markers_of(quadrangles: Sequence[Any] | None, ids: Any) -> Markers:
    """OpenCV's detections, sorted by number."""
    if quadrangles is None or ids is None or not len(ids):
        return Markers(ids=np.empty(0, dtype=np.int64), corners_px=np.empty((0, 4, 2)))
    corners = np.stack([np.asarray(one, dtype=np.float64).reshape(4, 2) for one in quadrangles])
    order = np.argsort(np.asarray(ids).ravel(), kind="stable")
    return Markers(ids=np.asarray(ids).ravel().astype(np.int64)[order], corners_px=corners[order])


def board_markers(board: Board, markers: Markers) -> Markers:
    """The board's own markers by their place in the order of `marker_corners`.

    Of a number that occurs twice, it is ambiguous which of the markers is the board's: it is left out.
    """
    places = {number: place for place, number in enumerate(marker_ids(board))}
    _, index, count = np.unique(markers.ids, return_inverse=True, return_counts=True)
    is_own = np.isin(markers.ids, marker_ids(board)) & (count[index] == 1)
    own_places = np.array([places[number] for number in markers.ids[is_own].tolist()], dtype=np.int64)
    return Markers(ids=own_places, corners_px=markers.corners_px[is_own])


# Comparison with the board

MAX_CENTER_ERROR = 0.25
"""Maximum median distance of the markers' centres from the board's, in sides of a marker: 0.02 with distortion, above 1
for another board."""

MAX_NEAR_PLACE = 0.5
"""Maximum distance of a marker's corners from where further rows of the board have them, in sides of a marker:
distortion displaces them by less than 0.2; markers of another board that happen to lie so near have other numbers."""

CORNER_ERROR_PX = 1.0
"""Bound of the inward bias of unrefined corners: blurred markers 40 px wide become 1.3 px too narrow."""

_MIN_MARKERS = 4
"""Minimum number of markers whose centres determine a homography, by which the layout is checked."""

_MAX_SQUARES = 40
"""Largest number of columns that is tried when the markers do not fit the board file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkerLayout:
    """Agreement of the detected markers with the board, in the board frame fitted to their centres."""

    center_error: float
    """Median distance of a marker's centre from its position on the board, in sides of a marker."""
    size_ratio: tuple[float, float]
    """Median width and height of the markers over those of the board; 1 if the deviation is not significant."""


def marker_layout(board: Board, markers: Markers) -> MarkerLayout | None:
    """Agreement of the board's own markers with the board; None if they are too few or collinear."""
    center_m = marker_corners(board)[markers.ids][..., :2].mean(axis=1)
    if len(center_m) < _MIN_MARKERS or np.linalg.matrix_rank(center_m - center_m.mean(axis=0), tol=1e-6) < 2:
        return None
    # Intersections of the markers' diagonals: projections of their centres in any perspective.
    corners = markers.corners_px
    along, across, offset = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1], corners[:, 1] - corners[:, 0]
    determinant = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
    share = (offset[:, 0] * across[:, 1] - offset[:, 1] * across[:, 0]) / determinant
    centers_px = corners[:, 0] + share[:, None] * along
    board_from_image: Any = cv2.findHomography(centers_px, center_m)[0]
    if board_from_image is None:
        return None
    seen_m = cv2.perspectiveTransform(centers_px[None], board_from_image)[0]
    corners_m = cv2.perspectiveTransform(corners.reshape(1, -1, 2), board_from_image).reshape(-1, 4, 2)
    sides_m = np.linalg.norm(np.diff(marker_corners(board)[markers.ids], axis=1), axis=-1).mean(axis=1)
    side_px = np.median(np.linalg.norm(np.diff(corners, axis=1), axis=-1))
    ratios = []
    for start, end in (([0, 3], [1, 2]), ([0, 1], [3, 2])):  # horizontal sides, vertical sides
        ratio = float(np.median(np.linalg.norm(corners_m[:, end] - corners_m[:, start], axis=-1) / sides_m[:, None]))
        # For markers of this size, the bias of the corners can explain smaller deviations.
        ratios.append(ratio if abs(ratio - 1) * side_px > 2 * CORNER_ERROR_PX else 1.0)
    center_error = float(np.median(np.linalg.norm(seen_m - center_m, axis=-1) / sides_m))
    return MarkerLayout(center_error=center_error, size_ratio=(ratios[0], ratios[1]))


def other_layout(board: Board, markers: Markers) -> str | None:
    """If the markers do not lie as on the board: the numbers of squares that would fit, as text; else None.

    Of too few markers, or collinear ones, the corners must lie as on the board: in a mirrored image, two or three
    markers can pass for others of the board, and corners of theirs would be numbered wrongly.
    """
    layout = marker_layout(board, markers)
    if layout is None:
        return "" if len(markers.ids) > 1 and _corner_error(board, markers) > MAX_CENTER_ERROR else None
    if layout.center_error < MAX_CENTER_ERROR:
        return None
    for other in _other_boards(board, int(markers.ids.max())):
        layout_on_other = marker_layout(other, markers)
        if layout_on_other is not None and layout_on_other.center_error < MAX_CENTER_ERROR:
            legacy = f", legacy_pattern: {str(other.legacy_pattern).lower()}" * (other.kind == "charuco")
            return f"but as with squares_x: {other.squares_x}, squares_y: {other.squares_y}{legacy}"
    return "nor with any other squares_x" if board.squares_x else ""


def _corner_error(board: Board, markers: Markers) -> float:
    """Median distance of the markers' corners from their places on the board, in sides of a marker in the image."""
    corners_m = marker_corners(board)[markers.ids].reshape(-1, 3)[:, :2]
    expected_px = _projected(corners_m, corners_m, markers.corners_px.reshape(-1, 2))
    if expected_px is None:
        return float("inf")
    error_px = np.linalg.norm(expected_px - markers.corners_px.reshape(-1, 2), axis=-1)
    return float(np.median(error_px)) / _side_px(markers)


def _projected(
    points_m: Float64[Array, "point xy=2"],
    corners_m: Float64[Array, "corner xy=2"],
    corners_px: Float64[Array, "corner xy=2"],
) -> Float64[Array, "point xy=2"] | None:
    """Points on the board in the image, by the homography of these corners; None if there is none."""
    image_from_board: Any = cv2.findHomography(corners_m, corners_px)[0]
    if image_from_board is None:
        return None
    return np.asarray(cv2.perspectiveTransform(points_m[None], image_from_board)[0], dtype=np.float64)


def _side_px(markers: Markers) -> float:
    return float(np.median(np.linalg.norm(np.diff(markers.corners_px, axis=1), axis=-1)))


def rows_beyond(board: Board, own: Markers, markers: Markers) -> int | None:
    """Number of rows of the board in the image, if markers with numbers beyond the board lie as in further rows of it.

    `own` are the board's among the `markers`.
    """
    rows, is_other = board.squares_y, markers.ids >= len(marker_corners(board))
    if board.markers or not rows or len(own.ids) < 2 or not is_other.any():
        return None
    others = Markers(ids=markers.ids[is_other], corners_px=markers.corners_px[is_other])
    # Two rows are added at a time: the squares of a legacy ChArUco board have colours by the parity of its rows.
    larger = (replace(board, squares_y=more) for more in range(rows + 2, MAX_SQUARES + 2, 2))
    whole = next((one for one in larger if len(marker_corners(one)) > int(others.ids.max())), None)
    if whole is None:
        return None
    corners_m = marker_corners(whole)[..., :2]
    # On an AprilGrid the added rows are above marker 0, so that places count from the larger board's corner.
    places_m = corners_m[own.ids].reshape(-1, 2), corners_m[others.ids].reshape(-1, 2)
    expected_px = _projected(places_m[1], places_m[0], own.corners_px.reshape(-1, 2))
    if expected_px is None:
        return None
    error_px = np.linalg.norm(expected_px.reshape(-1, 4, 2) - others.corners_px, axis=-1).max(axis=1)
    beyond = others.ids[error_px < MAX_NEAR_PLACE * _side_px(others)]
    return next(
        (
            more
            for more in range(rows + 1, (whole.squares_y or 0) + 1)
            if len(beyond) and len(marker_corners(replace(board, squares_y=more))) > int(beyond.max())
        ),
        None,
    )


def _other_boards(board: Board, last: int) -> Iterator[Board]:
    """Boards that have a marker with the number `last`, for comparison with an image that does not fit the board file.

    First the board itself, then with rows and columns exchanged, then with other numbers of columns; a ChArUco board
    in both of OpenCV's patterns.
    """
    if not board.squares_x or not board.squares_y:
        return
    swapped = (board.squares_y, board.squares_x)
    counts = [(board.squares_x, board.squares_y), swapped, *((x, board.squares_y) for x in range(2, _MAX_SQUARES))]
    for squares_x, squares_y in counts:
        for legacy in (board.legacy_pattern, not board.legacy_pattern) if board.kind == "charuco" else (False,):
            other = replace(board, squares_x=squares_x, squares_y=squares_y, legacy_pattern=legacy)
            if last < len(marker_corners(other)):
                yield other
