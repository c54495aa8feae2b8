"""`--print-board` of the calibrating commands: a board file -> a page to print."""

from pathlib import Path
from typing import Annotated, TypeVar

import typer

OptionalInputs = Annotated[
    list[str] | None,
    typer.Argument(metavar="INPUT...", help="Files or folders; - reads names from stdin, one a line."),
]
OptionalOutput = Annotated[
    Path | None, typer.Option("--output", "-o", readable=False, metavar="FILE", help="Where the result is written.")
]
PrintBoard = Annotated[
    Path | None,
    typer.Option("--print-board", readable=False, metavar="FILE", help="Only draw the board at true scale, as PDF."),
]


def print_board(path: Path, board_file: Path, usual: str, *, force: bool, quiet: bool) -> None:
    """Draw the board of a board file; where there is no such file, one that fits A4 is written first.

    `usual` is the kind of that board.
    """
    from ringpose.calibrate.board_drawing import A4_BOARDS, board_drawing
    from ringpose.cli import messages
    from ringpose.files.atomic import refuse_existing, refuse_inputs
    from ringpose.files.board_prints import require_pdf, write_board_print
    from ringpose.files.boards import read_board, write_board

    require_pdf(path)
    refuse_inputs([path], [board_file])
    refuse_existing(path, force)
    if not board_file.exists():
        write_board(board_file, A4_BOARDS[usual])
    drawing = board_drawing(read_board(board_file))
    write_board_print(path, drawing, force=force)
    if not quiet:
        size = f"{1e3 * drawing.width_m:.0f} x {1e3 * drawing.height_m:.0f} mm"
        messages.say(f"{path}: page {drawing.page}, {size}: print at 100 %, on a flat sheet")
        messages.say(f"{board_file}: correct the sizes by what the printed rulers measure")


_Given = TypeVar("_Given")


def given(value: _Given | None, name: str) -> _Given:
    """What a command cannot do without unless it only prints a board."""
    from ringpose.errors import UsageError

    if not value:
        raise UsageError(name, "is missing")
    return value
