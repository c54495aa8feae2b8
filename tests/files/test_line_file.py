"""A file of lines appears when it is complete, and an interrupted one is continued."""

import pytest

from ringpose.errors import CannotCreateError
from ringpose.files.records.line_file import LineFile


def written(path, records, *, resume=False, fails=False):
    """Writes the records; returns those that were there already."""
    with LineFile(path, force=False, resume=resume) as file:
        earlier = [record for _, record in file.earlier()]
        for record in records:
            file.write(record)
        if fails:
            raise KeyboardInterrupt
    return earlier


def test_a_complete_file_has_its_name(tmp_path):
    written(tmp_path / "a.jsonl", [{"n": 1}, {"n": 2}])

    assert (tmp_path / "a.jsonl").read_text() == '{"n": 1}\n{"n": 2}\n'
    assert [path.name for path in tmp_path.iterdir()] == ["a.jsonl"]


def test_an_interrupted_file_is_continued_after_its_last_whole_line(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        written(tmp_path / "a.jsonl", [{"n": 1}, {"n": 2}], fails=True)
    assert [path.name for path in tmp_path.iterdir()] == ["a.jsonl.part"]
    with (tmp_path / "a.jsonl.part").open("a") as stream:
        stream.write('{"n": 3, "cut')

    assert written(tmp_path / "a.jsonl", [{"n": 3}], resume=True) == [{"n": 1}, {"n": 2}]

    assert (tmp_path / "a.jsonl").read_text() == '{"n": 1}\n{"n": 2}\n{"n": 3}\n'


def test_the_lines_of_an_interrupted_run_are_not_lost_unasked(tmp_path):
    (tmp_path / "a.jsonl.part").write_text('{"n": 1}\n')

    with pytest.raises(CannotCreateError, match=r"a\.jsonl\.part: is left of a run.*--resume"):
        written(tmp_path / "a.jsonl", [])

    assert (tmp_path / "a.jsonl.part").read_text() == '{"n": 1}\n'


def test_a_complete_file_is_not_continued(tmp_path):
    written(tmp_path / "a.jsonl", [{"n": 1}])

    with pytest.raises(CannotCreateError, match="exists already"):
        written(tmp_path / "a.jsonl", [], resume=True)
