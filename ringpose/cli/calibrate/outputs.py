"""Outputs and shared options of the calibration commands: verdict, printed board, options that select a mode."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from ringpose.cli.app import Command, check_report, file_option

if TYPE_CHECKING:
    from ringpose.types.calibration import Verdict


def reject_existing_outputs(output: Path, report: Path | None, force: bool, read: Iterable[Path]) -> None:
    """Reject, before the computation, outputs that exist or are inputs, and a report without matplotlib."""
    from ringpose.errors import UsageError
    from ringpose.files.atomic import reject_existing, reject_inputs

    reject_inputs((output, report), read)
    reject_existing(output, force)
    if report is not None and report.resolve() == output.resolve():
        raise UsageError("--report", f"{report} is the output, too", "give each its own file")
    check_report(report, force)


def report_verdict(verdict: "Verdict", summary: Sequence[str], *, quiet: bool) -> int:
    """Write the summary to stderr and return the exit status; `quiet` does not suppress the verdict `redo`."""
    from ringpose.calibrate.acceptance import verdict_lines
    from ringpose.cli import messages
    from ringpose.errors import NO_POSE
    from ringpose.types.calibration import Grade

    bad = verdict.grade is Grade.REDO
    for line in verdict_lines(verdict)[:bad] if quiet else summary:
        messages.echo(line)
    return NO_POSE if bad else 0


LASERS = "The lasers"
"""Heading of their options in the help."""

LaserNames = Annotated[
    str | None,
    typer.Option(
        "--laser-names",
        metavar="NAMES",
        help="Names by mask bit, comma between, as left,middle,right.",
        rich_help_panel=LASERS,
    ),
]
LaserOrder = Annotated[
    str | None,
    typer.Option(
        "--laser-order",
        metavar="NAMES",
        help="Order of the stripes down the image, if all lasers are on.",
        rich_help_panel=LASERS,
    ),
]
PrintBoard = Annotated[Path | None, file_option("--print-board", meaning="Only draw the board at true scale, as PDF.")]


def print_board(path: Path, board_file: Path, usual: str, *, force: bool, quiet: bool) -> None:
    """Draw the board of a board file; where there is no such file, one that fits A4 is written first.

    `usual` is the kind of the board that is written.
    """
    from ringpose.cli import messages
    from ringpose.errors import UsageError
    from ringpose.files import atomic
    from ringpose.files.boards import read_board, write_board
    from ringpose.report.board_print import A4_BOARDS, board_drawing, pdf

    if path.suffix.lower() != ".pdf":
        remedy = "end it with .pdf; pdftocairo converts it to SVG or PNG at the same scale"
        raise UsageError("--print-board", f"{path.name} is not a .pdf", remedy)
    atomic.reject_inputs([path], [board_file])
    atomic.reject_existing(path, force)
    if not board_file.exists():
        write_board(board_file, A4_BOARDS[usual])
    drawing = board_drawing(read_board(board_file))
    with atomic.replacing(path, force) as stream:
        stream.write(pdf(drawing))
    if not quiet:
        size = f"{1e3 * drawing.width_m:.0f} x {1e3 * drawing.height_m:.0f} mm"
        messages.echo(f"{path}: page {drawing.page}, {size}: print at 100 %, on a flat sheet")
        messages.echo(f"{board_file}: correct the sizes by what the printed rulers measure")


_Given = TypeVar("_Given")


def given(value: _Given | None, name: str, remedy: str = "") -> _Given:
    """The value of an argument that is required unless the command only prints a board."""
    from ringpose.errors import UsageError

    if not value:
        raise UsageError(name, "is missing", remedy)
    return value


def session_names(inputs: list[str]) -> str | None:
    """The names that the sessions of the inputs give to their lasers, comma between; None if they state none."""
    from ringpose.types.options import STDIN
    from ringpose.types.session import SESSION_FILE

    paths = [Path(name) for name in inputs if name != STDIN]
    folders = dict.fromkeys(path if path.is_dir() else path.parent for path in paths)
    sessions = [folder for folder in folders if (folder / SESSION_FILE).is_file()]
    if not sessions:
        return None
    from ringpose.errors import UsageError
    from ringpose.files.images.sessions import read_session

    captures = [capture for folder in sessions for capture in read_session(folder).captures]
    stated = {",".join(capture.laser_names) for capture in captures if capture.laser_names}
    if len(stated) > 1:
        finding = f"is missing, and the sessions of the shots differ: {'; '.join(sorted(stated))}"
        raise UsageError("--laser-names", finding, "give the names in the order of the masks' bits")
    return next(iter(stated), None)


PRINTING = frozenset(("print_board", "board", "force", "verbose", "quiet"))
"""Options that are allowed with `--print-board`."""

CHECKING = frozenset(
    ("check", "inputs", "board", "laser_order", "surround", "overlay", "channel", "force", "verbose", "quiet")
)
"""Options that are allowed with `--check`."""

UPDATING = (CHECKING - {"check"}) | {"update", "output"}
"""Options that are allowed with `--update`."""

_MODES = {
    "print_board": ("--print-board", "only draws the board", PRINTING),
    "check": ("--check", "only compares, with the rig's own camera", CHECKING),
    "update": ("--update", "keeps the rig's camera and lasers", UPDATING),
}

_NONE: tuple[Any, ...] = (None, (), [])


class CommandWithModes(Command):
    """A command that rejects options that its mode would ignore."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        from ringpose.errors import UsageError

        for mode, (name, finding, allowed) in _MODES.items():
            others = [words for key, words in _given(ctx).items() if key not in allowed]
            if ctx.params.get(mode) is not None and others:
                raise UsageError(name, finding, f"leave out {', '.join(others)}")
        return super().invoke(ctx)


def _given(ctx: Any) -> dict[str, str]:
    """What the command line gives, by its name in the code: the option as it is written, or the inputs.

    Typer 0.26.0 to 0.26.6 name the command line as the source of inputs that are not there.
    """
    return {
        parameter.name: max(parameter.opts, key=len) if parameter.param_type_name == "option" else "the inputs"
        for parameter in ctx.command.params
        if ctx.get_parameter_source(parameter.name).name == "COMMANDLINE"
        and ctx.params.get(parameter.name) not in _NONE
    }
