"""Reading of board images, shared by the calibration commands."""

from collections.abc import Callable, Sequence
from hashlib import sha256
from pathlib import Path

from ringpose.calibrate.boards.diagnostics import NoBoard
from ringpose.calibrate.boards.search import BoardSearch
from ringpose.calibrate.boards.views import board_image
from ringpose.cli import messages
from ringpose.cli.batch import Batch
from ringpose.cli.progress import with_progress
from ringpose.errors import NO_POSE, DataError
from ringpose.files.atomic import make_folder, reject_inputs
from ringpose.files.images.codecs import write_image
from ringpose.files.images.shots import SHOT_SUFFIXES, read_shot
from ringpose.files.inputs import Input, path_of_input
from ringpose.files.inputs import inputs as named
from ringpose.report.boards import board_overlay
from ringpose.types.arrays import Array, UInt
from ringpose.types.board import Board, BoardView
from ringpose.types.image import Shot


class BoardImages:
    """The views read so far, and the images without a board."""

    def __init__(self, board: Board, overlay: Path | None, *, channel: str | None, force: bool) -> None:
        self.board = board
        self.overlay = None if overlay is None else make_folder(overlay)
        self.channel = channel
        self.force = force
        self.outputs: tuple[Path | None, ...] = ()
        """Output files of the command, which must not be inputs."""
        self.luminance_too = False
        """Look for the board in a colour image's luminance where its channel, that of a laser, shows none."""
        self.find_board = BoardSearch()
        self.views: list[BoardView] = []
        self.names: dict[str, str] = {}
        self.paths: list[Path] = []
        self.without_board: list[tuple[str, str]] = []
        self.width = 0
        self.height = 0
        self.last = ""
        """Result of the last image, as text."""

    def read(self, item: Input) -> tuple[Shot, BoardView] | None:
        """The shot of an input and its view of the board; None if it shows none, which is recorded."""
        if isinstance(item, Path):
            reject_inputs((*self.outputs, self.overlay and self.overlay / f"{item.stem}.png"), [item])
        shot = read_shot(path_of_input(item), self.channel)
        self._check_size(shot)
        self._reject_repeated(shot)
        image = board_image(shot)
        found = self._board_in(image, shot.name, item)
        if isinstance(item, Path):
            self.paths.append(item)
        if self.overlay is not None:
            write_image(self.overlay / f"{shot.name}.png", board_overlay(image, found), force=self.force)
        if isinstance(found, NoBoard):
            self.without_board.append((shot.name, found.value))
            self.last = f"{shot.name}: no board: {found.value}"
            return None
        self.views.append(found)
        self.last = f"{shot.name}: {len(found.ids)} corners"
        return shot, found

    def read_each(
        self,
        inputs: Sequence[str],
        batch: Batch,
        read: Callable[[Input], object] | None = None,
        *,
        quiet: bool = False,
        verbose: bool = False,
    ) -> None:
        """Read all inputs, with `read` if it is given, and report images without a board on stderr.

        If no input could be read, the command ends here; the errors have been reported.
        """
        items = batch.valid_inputs(named(inputs, SHOT_SUFFIXES), repeats_allowed=False)
        with self.find_board:
            for item in with_progress(items, "images", quiet):
                with batch.guarded():
                    (read or self.read)(item)
                    if verbose:
                        messages.echo(self.last)
        for name, reason in self.without_board:
            messages.echo(f"{name}: no board: {reason}")
        batch.record_status(NO_POSE if self.without_board else 0)
        if not self.names and batch.status:
            batch.finish()

    def _board_in(self, image: UInt[Array, "row column"], name: str, item: Input) -> BoardView | NoBoard:
        found = self.find_board(image, self.board, name)
        if not (isinstance(found, NoBoard) and self.channel and self.luminance_too):
            return found
        besides = self.find_board(board_image(read_shot(path_of_input(item))), self.board, name)
        return found if isinstance(besides, NoBoard) else besides

    def _reject_repeated(self, shot: Shot) -> None:
        """Reject an image that was read before, and a second overlay of the same name.

        A repeated image would reduce the uncertainty.
        """
        digest = sha256(shot.images.tobytes()).hexdigest()
        if digest in self.names:
            raise DataError(shot.name, f"is the same image as {self.names[digest]}", "give it once")
        if self.overlay is not None and shot.name in self.names.values():
            raise DataError(shot.name, "another image has this name, too", "rename one, or leave out --overlay")
        self.names[digest] = shot.name

    def _check_size(self, shot: Shot) -> None:
        height, width = shot.images.shape[1:]
        if not self.width:
            self.width, self.height = width, height
        if (width, height) != (self.width, self.height):
            found = f"{width} x {height} pixels, the others have {self.width} x {self.height}"
            raise DataError(shot.name, found, "calibrate with images of one camera and one size")
