"""`--print-board` of the calibrating commands: what is written, and what is refused."""

import pytest
import yaml

from ringpose.cli.main import main


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_board_is_printed_and_written_where_there_is_none(folder, capsys):
    status = main(["calibrate-planes", "--print-board", "page.svg", "--board", "new_board.yaml"])

    assert status == 0
    assert yaml.safe_load((folder / "new_board.yaml").read_text())["kind"] == "four_markers"
    assert "page A4 lying, 297 x 210 mm" in capsys.readouterr().err
    assert (folder / "page.svg").stat().st_size > 1000


def test_a_printed_board_is_not_replaced_unasked(folder, capsys):
    (folder / "page.pdf").write_text("precious")

    assert main(["calibrate-planes", "--print-board", "page.pdf", "--board", "new_board.yaml"]) == 73


@pytest.mark.parametrize("command", ["calibrate-camera", "calibrate-planes"])
def test_printing_refuses_what_it_would_leave_aside(command, folder, capsys):
    status = main([command, "views", "--print-board", "page.pdf", "--board", "board.yaml", "--output", "out.yaml"])

    assert status == 2
    assert capsys.readouterr().err == (
        "ringpose: --print-board: only draws the board; leave out the inputs, --output\n"
    )
    assert list(folder.iterdir()) == []
