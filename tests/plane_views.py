"""Views of the four-marker board with all lasers on, from tests/data, and the command that calibrates with them."""

import contextlib
import io
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import yaml

from ringpose.cli.main import main

ORDER = ("--laser-order", "right,middle,left")


@dataclass(frozen=True)
class Run:
    """A command that has run in a folder: its exit status and output."""

    folder: Path
    status: int
    out: str
    err: str


def run_in(folder: Path, command: Callable[[], int]) -> Run:
    """Run a command in a folder."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = command()
    return Run(folder, status, out.getvalue(), err.getvalue())


def copy_views(carried_data: Path, folder: Path) -> None:
    """Put views, board and true camera (in the true rig) into a working folder."""
    shutil.copytree(carried_data / "calib_b" / "planes", folder / "planes")
    shutil.copy(carried_data / "calib_b" / "plane_board.yaml", folder)
    shutil.copy(carried_data / "rig_b" / "rig.yaml", folder / "camera.yaml")


def calibrate(*words: str) -> int:
    """Calibrate in the working folder."""
    files = ["--camera", "camera.yaml", "--board", "plane_board.yaml", "--output", "rig.yaml"]
    return main(["calibrate-planes", *files, *words])


def calibrated(*words: str) -> int:
    """The command with the board alone."""
    return main(["calibrate-planes", "--board", "plane_board.yaml", *words])


def written(folder: Path) -> dict:
    """The rig that was written."""
    return yaml.safe_load((folder / "rig.yaml").read_text())
