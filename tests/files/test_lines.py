"""Drawn lines of photographs."""

from pathlib import Path

import pytest

from ringpose.errors import DataError, NoInputError
from ringpose.files.images.lines import annotation_path, read_lines


@pytest.fixture
def written(tmp_path):
    def write(text: str) -> Path:
        file = tmp_path / "photograph.csv"
        file.write_text(text)
        return file

    return write


def test_a_row_is_a_line(written):
    lines = read_lines(written("1,2,3,4\n5.5,6,7,8,3,more\n\n"))

    assert lines.tolist() == [[[1, 2], [3, 4]], [[5.5, 6], [7, 8]]]


def test_a_heading_is_passed_over(written):
    assert len(read_lines(written("x1,y1,x2,y2,vp (MATLAB)\n1,2,3,4,0\n"))) == 1


def test_an_origin_of_one_is_taken_off(written):
    assert read_lines(written("1,2,3,4\n"), origin_px=1.0).tolist() == [[[0, 1], [2, 3]]]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "photograph.csv: has no line"),
        ("x1,y1,x2,y2\n", "photograph.csv: has no line"),
        ("1,2,3,4\n1,2,3\n", "photograph.csv:2: must have four numbers"),
        ("1,2,3,4\n1,2,3,nan\n", "photograph.csv:2: must have four numbers"),
        ("1,2,3,4\n1,2,three,4\n", "photograph.csv:2: must have four numbers"),
    ],
)
def test_what_is_no_line_is_named(written, text, complaint):
    with pytest.raises(DataError, match=complaint):
        read_lines(written(text))


def test_a_folder_has_a_file_for_each_image(written, tmp_path):
    file = written("1,2,3,4\n")

    assert annotation_path(Path("somewhere/photograph.jpg"), tmp_path) == file
    assert annotation_path(Path("somewhere/other.jpg"), file) == file


def test_an_image_without_its_lines_is_named(tmp_path):
    with pytest.raises(NoInputError, match=r"other\.csv: does not exist"):
        annotation_path(Path("other.jpg"), tmp_path)
