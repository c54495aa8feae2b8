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
    status = main(["calibrate-planes", "--print-board", "page.pdf", "--board", "new_board.yaml"])

    assert status == 0
    assert yaml.safe_load((folder / "new_board.yaml").read_text())["kind"] == "four_markers"
    assert "page A4 lying, 297 x 210 mm" in capsys.readouterr().err
    assert (folder / "page.pdf").stat().st_size > 1000


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


@pytest.mark.parametrize(("page", "refused"), [("page.svg", 2), ("missing/page.pdf", 73), ("there.pdf", 73)])
def test_no_board_is_written_for_a_page_that_is_refused(page, refused, folder):
    (folder / "there.pdf").touch()

    status = main(["calibrate-planes", "--print-board", page, "--board", "new_board.yaml"])

    assert (status, [file.name for file in folder.iterdir()]) == (refused, ["there.pdf"])


def test_a_page_in_the_place_of_its_board_file_is_refused(folder, capsys):
    text = "{kind: chessboard, squares_x: 9, squares_y: 6, square_m: 0.02}"
    (folder / "board.pdf").write_text(text)

    status = main(["calibrate-camera", "--print-board", "board.pdf", "--board", "board.pdf", "--force"])

    assert (status, capsys.readouterr().err) == (
        73,
        "ringpose: board.pdf: is an input, too; choose another output\n",
    )
    assert (folder / "board.pdf").read_text() == text
