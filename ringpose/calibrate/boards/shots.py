"""The board in the shots of a calibration: found in a process of its own, images of one camera, none given twice."""

from collections.abc import Callable
from hashlib import sha256

import cv2
import numpy as np

from ringpose.calibrate.boards.diagnostics import BoardFailure, NoBoard
from ringpose.calibrate.boards.patterns.image_patch import grey_8_bit, patch_around
from ringpose.calibrate.boards.views import BoardFinder, find_board
from ringpose.errors import DataError
from ringpose.processes import LimitedCalls, WorkerKilled
from ringpose.types.arrays import Array, Float64, UInt, UInt8
from ringpose.types.board import Board, BoardView, BoardViews
from ringpose.types.image import Shot, board_image

MAX_SEARCH_S, MAX_SEARCH_S_PER_PIXEL = 10, 1e-5
"""CPU time after which a search is given up: 22 s for 1.2 megapixels, where a board takes 2 s and an image without one
0.8 s; thrice that leaves room for slow processors."""

STILL_PX = 0.3
"""Displacement up to which a board counts as at rest: a stripe across a corner or warm air can cause it. On rendered
boards at rest it is 0.01 px for any illumination."""

_CORNERS, _HALF_PATCH_PX, _REACH_PX = 16, 15, 12
"""Number of tracked corners, half size of their templates, and search range."""

_MIN_CORRELATION = 0.8
"""Normalised correlation below which a template is not found."""


class BoardShots(BoardViews):
    """The views of a board that are found in the shots of one camera.

    Boards are found while the `with` block of this object runs, which ends the process that searches for them.
    """

    def __init__(self, board: Board, *, names_differ: bool = False) -> None:
        """With `names_differ`, a second image of the same name is an error: its overlay would replace the first."""
        super().__init__()
        self.board = board
        self.find_board = BoardSearch()
        self._names_differ = names_differ
        self._names: dict[str, str] = {}
        """Names of the images by their SHA-256."""

    def __enter__(self) -> "BoardShots":
        return self

    def __exit__(self, *_: object) -> None:
        self.find_board.__exit__()

    def add(self, shot: Shot, luminance: Callable[[], Shot] | None = None) -> BoardView | NoBoard:
        """The view of the board in a shot, or the reason why there is none; DataError if the shot cannot be used.

        `luminance` reads the shot without regard to colour: it is searched where the colour of a laser shows no board.
        """
        self._check_size(shot)
        self._reject_repeated(shot)
        view = self.find_board(board_image(shot), self.board, shot.name)
        if isinstance(view, NoBoard) and luminance is not None:
            by_luminance = self.find_board(board_image(luminance()), self.board, shot.name)
            view = view if isinstance(by_luminance, NoBoard) else by_luminance
        if isinstance(view, NoBoard):
            self.without_board.append((shot.name, view.value))
        else:
            self.views.append(view)
        return view

    def _check_size(self, shot: Shot) -> None:
        height, width = shot.images.shape[1:]
        if not self.image_width:
            self.image_width, self.image_height = width, height
        if (width, height) != (self.image_width, self.image_height):
            finding = f"{width} x {height} pixels, the others have {self.image_width} x {self.image_height}"
            raise DataError(shot.name, finding, "calibrate with images of one camera and one size")

    def _reject_repeated(self, shot: Shot) -> None:
        """Reject an image that was given before: it would reduce the uncertainty."""
        digest = sha256(shot.images.tobytes()).hexdigest()
        if digest in self._names:
            raise DataError(shot.name, f"is the same image as {self._names[digest]}", "give it once")
        if self._names_differ and shot.name in self._names.values():
            raise DataError(shot.name, "another image has this name, too", "rename one, or leave out --overlay")
        self._names[digest] = shot.name


class BoardSearch:
    """`find_board` for one image after the other, in one child process that lives as long as the `with` block."""

    def __init__(self) -> None:
        self._calls: LimitedCalls[BoardView | NoBoard] = LimitedCalls(find_board)

    def __enter__(self) -> "BoardSearch":
        return self

    def __exit__(self, *_: object) -> None:
        self._calls.__exit__()

    def __call__(self, image: UInt[Array, "row column"], board: Board, name: str) -> BoardView | NoBoard:
        """The board's corners in the image, or the reason why there are none (`find_board`)."""
        limit_s = MAX_SEARCH_S + int(MAX_SEARCH_S_PER_PIXEL * image.size)
        try:
            return self._calls(limit_s, image, board, name)
        except WorkerKilled:
            return NoBoard(failure=BoardFailure.GIVEN_UP, finding=f"after {limit_s} s of computing, or killed")


def board_shift_px(shot: Shot, view: BoardView, board: Board, find: BoardFinder = find_board) -> float:
    """Maximum displacement of the board from the first frame with the lasers off (else the first) to any other frame.

    NaN if no other frame shows the corners.
    """
    off = np.flatnonzero(shot.lasers == 0)
    first = int(off[0]) if len(off) else 0
    start = grey_8_bit(shot.images[first])
    others = [image for index, image in enumerate(shot.images) if index != first]
    shifts = [_shift_px(start, image, view, board, find) for image in others]
    return max((shift for shift in shifts if np.isfinite(shift)), default=float("nan"))


def _shift_px(
    start: UInt8[Array, "row column"],
    image: UInt[Array, "row column"],
    view: BoardView,
    board: Board,
    find: BoardFinder,
) -> float:
    """Median displacement of the corners by template matching; if that fails, by detecting the board again."""
    chosen = view.points_px[np.linspace(0, len(view.points_px) - 1, min(_CORNERS, len(view.points_px))).astype(int)]
    grey = grey_8_bit(image)
    moved = [shift for corner in chosen for shift in [_tracked(start, grey, corner)] if shift is not None]
    if len(moved) >= min(4, len(chosen)):
        return float(np.linalg.norm(np.median(moved, axis=0)))
    anew = find(image, board, view.name)
    if not isinstance(anew, BoardView):
        return float("nan")
    _, before, after = np.intersect1d(view.ids, anew.ids, return_indices=True)
    return float(np.linalg.norm(np.median(anew.points_px[after] - view.points_px[before], axis=0)))


def _tracked(
    start: UInt8[Array, "row column"], image: UInt8[Array, "row column"], corner: Float64[Array, "xy=2"]
) -> Float64[Array, "xy=2"] | None:
    """Displacement of the template around one corner; None if it is not found or exceeds the image."""
    column, row = np.rint(corner).astype(int).tolist()
    patch = patch_around(start, column, row, _HALF_PATCH_PX)
    search = patch_around(image, column, row, _HALF_PATCH_PX + _REACH_PX)
    if patch is None or search is None or patch.std() < 1.0 or search.std() < 1.0:
        return None
    correlation = np.asarray(cv2.matchTemplate(search, patch, cv2.TM_CCOEFF_NORMED), dtype=np.float64)
    y, x = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
    if correlation[y, x] < _MIN_CORRELATION or not (0 < x < 2 * _REACH_PX and 0 < y < 2 * _REACH_PX):
        return None
    across, down = (correlation[y, x - 1 : x + 2], correlation[y - 1 : y + 2, x])
    return np.array([x + _vertex(across), y + _vertex(down)]) - _REACH_PX


def _vertex(values: Float64[Array, "3"]) -> float:
    """Position of the maximum of the parabola through three values, the middle one largest."""
    before, top, after = values.tolist()
    curvature = before - 2 * top + after
    return 0.5 * (before - after) / curvature if curvature < 0 else 0.0
