"""Views of the four-marker board with all lasers on, from tests/data, and the command that calibrates with them."""

import shutil
from pathlib import Path

import yaml

from ringpose.cli.main import main

ORDER = ("--laser-order", "right,middle,left")


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
