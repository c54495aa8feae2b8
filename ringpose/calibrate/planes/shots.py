"""From shots of a board with stripes to assessed light planes: checks of the shots, laser names, comparison methods."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np

from ringpose.calibrate.boards.layout import marker_size_findings
from ringpose.calibrate.boards.patterns.image_patch import patch_around
from ringpose.calibrate.boards.views import BoardFinder, find_board, grey_8_bit
from ringpose.calibrate.planes.pipeline import PlanesModel, calibrate_planes
from ringpose.calibrate.planes.quality import PlanesAssessment
from ringpose.calibrate.planes.stripes.extraction import stripe_view
from ringpose.calibrate.planes.stripes.labels import laser_names, laser_order, lasers_in_masks
from ringpose.calibrate.planes.verdict import planes_verdict
from ringpose.errors import DataError, UsageError
from ringpose.types.arrays import Array, Float64, UInt, UInt8
from ringpose.types.board import Board, BoardView
from ringpose.types.calibration import StripeView, Verdict
from ringpose.types.image import Shot
from ringpose.types.options import PlanesMethod
from ringpose.types.rig import Camera

MARKER_BOARDS = ("four_markers", "aruco_grid")
"""Boards whose corners are those of single markers, as the paper's method needs them."""


STILL_PX = 0.3
"""Displacement up to which a board counts as at rest: a stripe across a corner or warm air can cause it. On rendered
boards at rest it is 0.01 px for any illumination."""

_CORNERS, _HALF_PATCH_PX, _REACH_PX = 16, 15, 12
"""Number of tracked corners, half size of their templates, and search range."""

_MIN_CORRELATION = 0.8
"""Normalised correlation below which a template is not found."""


def check_method(method: PlanesMethod, free_camera: bool, board: Board, camera: Camera) -> None:
    """Raise UsageError if the board or the camera does not support the method."""
    if free_camera and method is not PlanesMethod.JOINT:
        raise UsageError(
            "--free-camera", "only the joint method estimates the camera", "leave it out, or use --method joint"
        )
    if free_camera and camera.covariance is None:
        found = "the camera has no covariance"
        raise UsageError("--free-camera", found, "leave it out, or give a camera.yaml of ringpose calibrate-camera")
    if method is PlanesMethod.PAPER and board.kind not in MARKER_BOARDS:
        raise UsageError("--method paper", "averages the poses of single markers, and the board has none")


class StripeShots:
    """Accumulator of the shots of a calibration; the first determines the number of lasers if no names are given."""

    def __init__(
        self,
        board: Board,
        camera: Camera,
        names: str | None,
        order: str | None,
        surround_m: float = 0.0,
        find: BoardFinder = find_board,
    ) -> None:
        self.board = board
        self.find_board = find
        self.camera = camera
        self.given_names, self.given_order = names, order
        """Values of --laser-names and --laser-order."""
        self.surround_m = surround_m
        self.names: tuple[str, ...] = ()
        """Names of the lasers, by mask bit; empty before the first shot."""
        self.views: list[StripeView] = []
        self.any_without_stripe = False
        """Whether a shot shows the board and no stripe on it."""

    def add(self, shot: Shot, board: BoardView) -> StripeView:
        """Add a shot to the calibration and return the stripes on its board; DataError if the shot cannot be used."""
        height, width = shot.images.shape[1:]
        if (width, height) != (self.camera.image_width, self.camera.image_height):
            expected = f"{self.camera.image_width} x {self.camera.image_height}"
            found = f"{width} x {height} pixels, the camera has {expected}"
            raise DataError(shot.name, found, "give the camera that took the shots")
        self._check_names(shot)
        shift_px = board_shift_px(shot, board, self.board, self.find_board)
        if shift_px > STILL_PX:
            found = f"the board, or the camera, moved by {shift_px:.1f} px between its frames"
            raise DataError(shot.name, found, "left out: hold it still until all frames are taken")
        view = stripe_view(shot, board, self.board, self.camera, len(self.names), self.surround_m)
        self.views.append(view)
        self.any_without_stripe |= not any(len(px) for px in (*view.stripes_px, *view.unlabelled_px))
        return view

    def assessment(
        self,
        method: PlanesMethod,
        free_camera: bool = False,
        expected_rad: Sequence[float] = (),
        working_distance_m: float | None = None,
        without_board: Sequence[tuple[str, str]] = (),
    ) -> PlanesAssessment:
        """The light planes of all views, with verdict and with the paper's method for comparison."""
        order = laser_order(self.given_order, self.names) if self.names else None
        model = PlanesModel(names=self.names, method=method, order=order, free_camera=free_camera)
        pairs = [f"{first} to {second}" for first, second in pairwise(self.names)]
        if len(expected_rad) not in (0, len(pairs)):
            found = f"has {len(expected_rad)}, must have {len(pairs)}"
            raise UsageError("--expected-angles", found, f"give {', '.join(pairs)}")
        board = marker_size_findings([view.board for view in self.views])
        try:
            calibration = calibrate_planes(self.views, self.camera, model)
        except DataError as error:  # wrong sizes in the board file may be the reason
            remedies = [*Verdict(findings=board).advice, *([error.remedy] if error.remedy else [])]
            raise DataError(error.location, error.found, "; ".join(remedies)) from error
        paper = None
        if model.method is not PlanesMethod.PAPER and self.board.kind in MARKER_BOARDS:
            with suppress(DataError):
                paper = calibrate_planes(self.views, self.camera, replace(model, method=PlanesMethod.PAPER))
        return PlanesAssessment(
            calibration=calibration,
            verdict=planes_verdict(calibration, expected_rad, board, working_distance_m),
            paper=paper,
            without_board=without_board,
        )

    def _check_names(self, shot: Shot) -> None:
        """Determine the lasers' names with the first shot; later ones must not refer to other lasers."""
        number = lasers_in_masks(shot)
        if not (self.names or self.given_names or number):
            found = f"{shot.name} does not state how many lasers are on"
            raise UsageError("--laser-names", found, "give one name for each laser that there is, seen or not")
        self.names = self.names or laser_names(self.given_names, number)
        if number > len(self.names):
            found = f"a frame names laser {number}, there are {len(self.names)} ({', '.join(self.names)})"
            raise DataError(shot.name, found, "give all names with --laser-names, or shots of these lasers")


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
