"""From shots of a board with stripes to assessed light planes: checks of the shots, laser names, comparison methods."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

from ringpose.calibrate.boards.layout import marker_size_findings
from ringpose.calibrate.boards.motion import STILL_PX, board_shift_px
from ringpose.calibrate.boards.pose import board_pose
from ringpose.calibrate.boards.views import dark_image
from ringpose.calibrate.planes.pipeline import PlanesModel, calibrate_planes
from ringpose.calibrate.planes.quality import PlanesAssessment
from ringpose.calibrate.planes.stripes.board_surface import board_surface
from ringpose.calibrate.planes.stripes.extraction import stripe_view, stripes_seen
from ringpose.calibrate.planes.stripes.labels import laser_names, laser_order, lasers_in_masks
from ringpose.calibrate.planes.verdict import planes_verdict
from ringpose.errors import DataError, UsageError
from ringpose.types.board import Board, BoardView
from ringpose.types.calibration import StripeView, Verdict
from ringpose.types.image import Shot
from ringpose.types.options import PlanesMethod
from ringpose.types.rig import Camera

MARKER_BOARDS = ("four_markers", "aruco_grid")
"""Boards whose corners are those of single markers, as the paper's method needs them."""


def check_method(method: PlanesMethod, free_camera: bool, board: Board, camera: Camera) -> None:
    """Raise UsageError if the board or the camera does not support the method."""
    if free_camera and method is not PlanesMethod.JOINT:
        found = "only the joint method estimates the camera"
        raise UsageError("--free-camera", found, "calibrate the camera with ringpose calibrate-camera")
    if free_camera and camera.covariance is None:
        found = "the camera has no covariance"
        raise UsageError("--free-camera", found, "calibrate the camera with ringpose calibrate-camera")
    if method is PlanesMethod.PAPER and board.kind not in MARKER_BOARDS:
        raise UsageError("--method paper", "averages the poses of single markers, and the board has none")


class StripeShots:
    """Accumulator of the shots of a calibration; the first determines the number of lasers if no names are given."""

    def __init__(
        self, board: Board, camera: Camera, names: str | None, order: str | None, surround_m: float = 0.0
    ) -> None:
        self.board = board
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
        self._check_names(shot, board)
        shift_px = board_shift_px(shot, board, self.board)
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

    def _check_names(self, shot: Shot, board: BoardView) -> None:
        """Determine the lasers' names with the first shot; later ones must not refer to other lasers."""
        number = lasers_in_masks(shot)
        if not (self.names or self.given_names or number):
            surface = board_surface(shot, self.board, board_pose(board, self.camera), self.camera, self.surround_m)
            count = stripes_seen(shot.images.max(axis=0), dark_image(shot), surface)
            stripes = f"{count} stripe{'s' * (count != 1)}" if count else "no stripe"
            found = f"{shot.name} does not say how many lasers are on; its board shows {stripes}"
            raise UsageError("--laser-names", found, "give one name for each laser that there is, seen or not")
        self.names = self.names or laser_names(self.given_names, number)
        if number > len(self.names):
            found = f"a frame names laser {number}, there are {len(self.names)} ({', '.join(self.names)})"
            raise DataError(shot.name, found, "give all names with --laser-names, or shots of these lasers")
