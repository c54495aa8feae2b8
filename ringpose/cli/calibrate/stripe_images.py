"""Shots of a board with stripes, as `ringpose calibrate-planes` reads them."""

from dataclasses import replace
from itertools import pairwise

from ringpose.calibrate.boards.motion import STILL_PX, board_shift_px
from ringpose.calibrate.boards.overlay import stripe_overlay
from ringpose.calibrate.boards.pose import board_pose
from ringpose.calibrate.boards.views import dark_image
from ringpose.calibrate.planes.board_surface import board_surface
from ringpose.calibrate.planes.labels import THREE, laser_names, laser_order, lasers_named
from ringpose.calibrate.planes.pipeline import PlanesModel, calibrate_planes
from ringpose.calibrate.planes.stripes import stripe_view, stripes_seen
from ringpose.cli import messages
from ringpose.cli.calibrate.board_views import BoardImages
from ringpose.errors import DataError, UsageError
from ringpose.files.images import write_image
from ringpose.files.inputs import Input
from ringpose.types.board import BoardView
from ringpose.types.calibration import PlanesCalibration, StripeView
from ringpose.types.camera import Camera
from ringpose.types.image import Shot
from ringpose.types.options import PlanesMethod

MARKER_BOARDS = ("four_markers", "aruco_grid")
"""Boards whose corners are those of markers, which the paper's method takes one by one."""


class StripeImages:
    """The views gathered so far; the first shot says how many lasers there are."""

    def __init__(
        self, images: BoardImages, camera: Camera, names: str | None, order: str | None, surround_m: float
    ) -> None:
        self.images = images
        self.images.luminance_too = True
        self.camera = camera
        self.views: list[StripeView] = []
        self.given = (names, order)
        self.surround_m = surround_m
        self.names: tuple[str, ...] = ()
        self.without_stripe = False
        """Whether a shot of the board showed no stripe on it: no laser learns from that shot."""

    def read(self, item: Input) -> None:
        """Add the view that a shot shows."""
        read = self.images.read(item)
        if read is None:
            return
        shot, view = read
        self._check(shot, view)
        shift_px = board_shift_px(shot, view, self.images.board)
        if shift_px > STILL_PX:
            moved = f"the board, or the camera, moved by {shift_px:.1f} px between its frames"
            raise DataError(shot.name, moved, "left out: hold it still until all frames are taken")
        seen = stripe_view(shot, view, self.images.board, self.camera, len(self.names), self.surround_m)
        self.views.append(seen)
        found = sum(len(px) > 0 for px in (*seen.stripes_px, *seen.unlabelled_px))
        self.without_stripe |= not found
        self.images.last += f", {found} stripes" + "".join(f"; {remark}" for remark in seen.remarks)
        if self.images.overlay is not None:
            drawn = stripe_overlay(shot.images.max(axis=0), seen)
            write_image(self.images.overlay / f"{shot.name}.png", drawn, force=True)

    def require_method(self, method: PlanesMethod, free_camera: bool) -> None:
        """Refuse, before any shot is read, what the board or the camera cannot give."""
        if free_camera and (method is not PlanesMethod.JOINT or self.camera.covariance is None):
            found = "the camera has no covariance" if method is PlanesMethod.JOINT else "only the joint method frees it"
            raise UsageError("--free-camera", found, "calibrate the camera with ringpose calibrate-camera")
        if method is PlanesMethod.PAPER and self.images.board.kind not in MARKER_BOARDS:
            raise UsageError("--method paper", "averages the poses of single markers, and the board has none")

    def model(self, method: PlanesMethod, free_camera: bool = False) -> PlanesModel:
        """What is to be estimated."""
        order = laser_order(self.given[1], self.names) if self.names else None
        return PlanesModel(names=self.names, method=method, order=order, free_camera=free_camera)

    def require_angles(self, count: int) -> None:
        """Refuse expected angles that are not one for each pair of neighbouring lasers; none at all are welcome."""
        pairs = [f"{first} to {second}" for first, second in pairwise(self.names)]
        if count not in (0, len(pairs)):
            raise UsageError("--expected-angles", f"has {count}, must have {len(pairs)}", f"give {', '.join(pairs)}")

    def by_the_paper(self, model: PlanesModel) -> PlanesCalibration | None:
        """The same views by the paper's method, to compare; None where it has nothing to say."""
        if model.method is PlanesMethod.PAPER or self.images.board.kind not in MARKER_BOARDS:
            return None
        try:
            return calibrate_planes(self.views, self.camera, replace(model, method=PlanesMethod.PAPER))
        except DataError:
            return None

    def say_number(self) -> None:
        """How many lasers there are, where that is few and only the masks say so: a third may be dark or unwired."""
        if self.given[0] is None and 0 < len(self.names) < len(THREE):
            number = f"{len(self.names)} laser{'s' * (len(self.names) > 1)}"
            names = ", ".join(self.names)
            messages.say(f"{number} by the shots' masks ({names}); if there are more, name all (--laser-names)")

    def say_remarks(self) -> None:
        """What each shot is missing, and why: where no plane comes of them, that is the reason."""
        for view in self.views:
            for remark in view.remarks:
                messages.say(f"{view.board.name}: {remark}")

    def _refuse_unnamed(self, shot: Shot, view: BoardView) -> None:
        """All images of a set say as little of their lasers: it is said once, with what the first shows."""
        surface = board_surface(shot, self.images.board, board_pose(view, self.camera), self.camera, self.surround_m)
        number = stripes_seen(shot.images.max(axis=0), dark_image(shot), surface)
        stripes = f"{number} stripe{'s' * (number != 1)}" if number else "no stripe"
        found = f"{shot.name} does not say how many lasers are on; its board shows {stripes}"
        raise UsageError("--laser-names", found, "give one name for each laser that there is, seen or not")

    def _check(self, shot: Shot, view: BoardView) -> None:
        size = (shot.images.shape[2], shot.images.shape[1])
        wanted = (self.camera.image_width, self.camera.image_height)
        if size != wanted:
            found = f"{size[0]} x {size[1]} pixels, the camera has {wanted[0]} x {wanted[1]}"
            raise DataError(shot.name, found, "give the camera that took the shots")
        highest = lasers_named(shot)
        if not (self.names or self.given[0] or highest):
            self._refuse_unnamed(shot, view)
        self.names = self.names or laser_names(self.given[0], highest)
        if highest > len(self.names):
            found = f"a frame names laser {highest}, there are {len(self.names)} ({', '.join(self.names)})"
            raise DataError(shot.name, found, "give all names with --laser-names, or shots of these lasers")
