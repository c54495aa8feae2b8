"""Inputs of the cases (cases.yaml): carried files, and functions that make what is too large to carry."""

import shutil
from collections.abc import Callable
from pathlib import Path

CARRIED = Path(__file__).parent / "files"
DATA = Path(__file__).parents[1] / "data"


def _copied_data(path: Path) -> None:
    shutil.copytree(DATA / path.name, path)


BUILT: dict[str, Callable[[Path], None]] = {
    "rig_b": _copied_data,
    "calib_b": _copied_data,
}
"""For each file or folder that is not carried, the function that makes it at a path."""


def make_inputs(words: list[str], folder: Path) -> None:
    """Make the inputs that are named in the words of a command line, and copy all carried files."""
    shutil.copytree(CARRIED, folder, dirs_exist_ok=True)
    for name in dict.fromkeys(Path(word).parts[0] for word in words if word):
        if name in BUILT:
            BUILT[name](folder / name)
