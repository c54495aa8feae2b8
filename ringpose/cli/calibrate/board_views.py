"""Reading of board images, shared by the calibration commands."""

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from ringpose.calibrate.boards.diagnostics import NoBoard
from ringpose.calibrate.boards.shots import BoardShots
from ringpose.cli import messages
from ringpose.cli.batch import Batch, with_progress
from ringpose.errors import UsageError
from ringpose.files.atomic import make_folder, reject_inputs
from ringpose.files.images.codecs import write_image
from ringpose.files.images.shots import SHOT_SUFFIXES, read_shots
from ringpose.files.inputs import Input, path_of_input
from ringpose.files.inputs import inputs as named
from ringpose.report.boards import board_overlay, thumbnail
from ringpose.types.arrays import Array, UInt8
from ringpose.types.board import BoardView, BoardViews
from ringpose.types.image import Shot, board_image


class BoardReader:
    """Reads shots of a board, and draws what is found."""

    def __init__(
        self,
        boards: BoardShots,
        *,
        overlay: Path | None,
        channel: str | None,
        luminance_too: bool = False,
        outputs: Sequence[Path | None],
        force: bool,
        thumbnails_too: bool = False,
    ) -> None:
        """`outputs` of the command must not be inputs.

        With `luminance_too`, an image whose channel, that of a laser, shows no board is searched by its luminance.
        """
        self.paths: list[Path] = []
        """The files read."""
        self.thumbnails: dict[str, UInt8[Array, "row column"] | None] = {}
        """By name, small images for a report, if wanted; None for a name of several images."""
        self._thumbnails_too = thumbnails_too
        self._boards, self._force = boards, force
        self._overlay = None if overlay is None else make_folder(overlay)
        self._channel, self._luminance_too = channel, luminance_too
        self._outputs = outputs

    def read_each(
        self,
        inputs: Sequence[str],
        batch: Batch,
        on_view: Callable[[Shot, BoardView], str] = lambda _, view: f"{len(view.ids)} corners",
        *,
        quiet: bool,
        verbose: bool,
    ) -> None:
        """Read all inputs, and report images without a board on stderr.

        `on_view` takes each shot that shows the board and returns the result as text. If no input could be read, the
        command ends here; the errors have been reported.
        """
        boards = self._boards
        items = batch.valid_inputs(named(inputs, SHOT_SUFFIXES), repeats_allowed=False)
        with boards:
            for item in with_progress(items, "images", quiet):
                with batch.guarded():
                    for index, shot in enumerate(self._shots(item)):
                        with batch.guarded():
                            view = self._view(shot, partial(_by_luminance, item, index))
                            finding = f"no board: {view.value}" if isinstance(view, NoBoard) else on_view(shot, view)
                            if verbose:
                                messages.echo(f"{shot.name}: {finding}")
        report_missing(boards, batch)

    def _shots(self, item: Input) -> list[Shot]:
        """The shot in an input; a TIFF file has one for each page."""
        path = path_of_input(item)
        reject_inputs((*self._outputs, self._overlay and self._overlay / f"{path.stem}.png"), [path])
        shots = read_shots(path, self._channel)
        self.paths.append(path)
        return shots

    def _view(self, shot: Shot, by_luminance: Callable[[], Shot]) -> BoardView | NoBoard:
        view = self._boards.add(shot, by_luminance if self._channel and self._luminance_too else None)
        if self._thumbnails_too:
            known = shot.name in self.thumbnails
            self.thumbnails[shot.name] = None if known else thumbnail(shot.images.max(axis=0))
        if self._overlay is not None:
            drawn = board_overlay(board_image(shot), view)
            write_image(self._overlay / f"{shot.name}.png", drawn, force=self._force)
        return view


def _by_luminance(item: Input, index: int) -> Shot:
    return read_shots(path_of_input(item))[index]


def report_missing(boards: BoardViews, batch: Batch) -> None:
    """Report images without a board; the command ends here if no input could be read, and its errors are reported."""
    for name, reason in boards.without_board:
        messages.echo(f"{name}: no board: {reason}")
    if not (boards.views or boards.without_board) and batch.status:
        batch.finish()


def listed_views(
    inputs: Sequence[str], board: Path | None, image_size: str | None, batch: Batch, without: Mapping[str, object]
) -> BoardViews:
    """The views in lists of corners; `without` are options that need images, by name, and must not be given."""
    from ringpose.files.boards import read_board
    from ringpose.files.corner_lists import is_corner_list, read_corner_lists

    images = [name for name in inputs if not is_corner_list(name)]
    if images:
        raise UsageError("INPUT", f"{images[0]} is no list of corners, and others are", "give images or lists")
    for name, value in without.items():
        if value is not None:
            raise UsageError(name, "needs images, and lists of corners are given", "leave it out")
    size = re.fullmatch(r"(\d{1,5})x(\d{1,5})", image_size or "")
    if size is None or "0" in size.groups():
        finding = f"is {image_size!r}" if image_size else "is missing: lists of corners do not state it"
        raise UsageError("--image-size", finding, "give width and height in pixels, as 640x480")
    boards = BoardViews()
    with batch.guarded():
        places = None if board is None else read_board(board)
        boards = read_corner_lists([Path(name) for name in inputs], places, (int(size[1]), int(size[2])))
    report_missing(boards, batch)
    return boards
