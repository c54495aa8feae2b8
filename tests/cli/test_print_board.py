"""`--print-board` of the calibrating commands: what is written, and what is refused."""

import pytest
import yaml

from ringpose.cli.main import main


def test_a_board_is_printed_and_its_missing_file_is_written(empty_folder, capsys):
    status = main(["calibrate-planes", "--print-board", "page.pdf", "--board", "new_board.yaml"])

    assert status == 0
    assert yaml.safe_load((empty_folder / "new_board.yaml").read_text())["kind"] == "four_markers"
    assert "page A4 landscape, 297 x 210 mm" in capsys.readouterr().err
    assert (empty_folder / "page.pdf").stat().st_size > 1000


@pytest.mark.parametrize("command", ["calibrate-camera", "calibrate-planes"])
@pytest.mark.parametrize(
    ("words", "status", "named"),
    [
        (["page.pdf", "--board", "new.yaml", "views", "--output", "out.yaml"], 2, "leave out the inputs, --output"),
        (["page.svg", "--board", "new.yaml"], 2, "page.svg"),
        (["missing/page.pdf", "--board", "new.yaml"], 73, "missing"),
        (["there.pdf", "--board", "new.yaml"], 73, "there.pdf: exists already"),
        (["there.pdf", "--board", "there.pdf", "--force"], 73, "there.pdf: is an input, too"),
    ],
)
def test_a_rejected_print_writes_nothing(command, words, status, named, empty_folder, capsys):
    text = "{kind: chessboard, squares_x: 9, squares_y: 6, square_m: 0.02}"
    (empty_folder / "there.pdf").write_text(text)

    assert main([command, "--print-board", *words]) == status
    assert named in capsys.readouterr().err
    assert [(file.name, file.read_text()) for file in empty_folder.iterdir()] == [("there.pdf", text)]
