"""Outputs of the calibrating commands that cannot be written: an input is not replaced, not even with --force."""

import os
import shutil
from pathlib import Path
from typing import NoReturn

import pytest

from ringpose.cli.main import main

CAMERA = ("calibrate-camera", "views", "--board", "camera_board.yaml", "--force")
PLANES = ("calibrate-planes", "planes", "--board", "plane_board.yaml", "--camera", "camera.yaml", "--force")
IMAGE = "views/cam_B_00.png"


@pytest.fixture
def folder(plane_folder, carried_data):
    """A working folder with views for both commands, and a link to one of them."""
    (plane_folder / "views").mkdir()
    shutil.copy(carried_data / "calib_b" / "camera" / "cam_B_00.png", plane_folder / "views")
    shutil.copy(carried_data / "calib_b" / "camera_board.yaml", plane_folder)
    (plane_folder / "link.png").symlink_to(IMAGE)
    return plane_folder


@pytest.mark.parametrize(
    ("words", "output", "kept"),
    [
        ((*CAMERA, "--output", "camera_board.yaml"), "camera_board.yaml", "camera_board.yaml"),
        ((*CAMERA, "--output", IMAGE), IMAGE, IMAGE),
        ((*CAMERA, "--output", "link.png"), "link.png", IMAGE),
        ((*CAMERA, "--output", "c.yaml", "--overlay", "views"), IMAGE, IMAGE),
        ((*PLANES, "--output", "camera.yaml"), "camera.yaml", "camera.yaml"),
        ((*PLANES, "--output", "plane_board.yaml"), "plane_board.yaml", "plane_board.yaml"),
        ((*PLANES, "--output", "r.yaml", "--mount", "m.yaml", "--report", "m.yaml"), "m.yaml", "m.yaml"),
        ((*PLANES, "--output", "planes/pln_B_01.npz"), "planes/pln_B_01.npz", "planes/pln_B_01.npz"),
        (("convert-camera", "camera.yaml", "--format", "ros", "-o", "camera.yaml", "--force"), *2 * ["camera.yaml"]),
    ],
)
def test_an_output_that_is_an_input_is_rejected(folder, capsys, words, output, kept):
    (folder / "m.yaml").write_text("mount: {}")
    before = Path(kept).read_bytes()

    status = main(words)

    assert (status, capsys.readouterr().err) == (
        73,
        f"ringpose {words[0]}: {output}: is an input, too; choose another output\n",
    )
    assert Path(kept).read_bytes() == before


def test_an_input_without_permission_cannot_be_opened(folder, capsys, monkeypatch):
    def refuse(file: Path, *_: str) -> NoReturn:
        raise PermissionError(f"{file}")

    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(Path, "open", refuse)

    status = main([*CAMERA, "--output", "c.yaml"])

    finding = "ringpose calibrate-camera: camera_board.yaml: cannot be opened: permission denied\n"
    assert (status, capsys.readouterr().err) == (66, finding)
