import gzip
import io
import os

import pytest

from ringpose.errors import DataError, NoInputError
from ringpose.files import inputs as stdin
from ringpose.files.inputs import Record, inputs


def test_a_folder_yields_its_files_by_name(tmp_path):
    for name in ("b.npz", "a.png", "c.txt", ".d.npz", "e.NPZ"):
        (tmp_path / name).touch()

    found = list(inputs([tmp_path], (".npz", ".png")))

    assert [path.name for path in found] == ["a.png", "b.npz", "e.NPZ"]


def test_a_folder_yields_its_files_by_the_numbers_in_their_names(tmp_path):
    names = ["2.png", "10.png", "view_2.png", "view_9_b.png", "view_10_a.png", "view_010_b.png"]
    for name in reversed(names):
        (tmp_path / name).touch()

    assert [path.name for path in inputs([tmp_path], (".png",))] == names


def test_missing_inputs_are_yielded_as_problems(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", None)
    (tmp_path / "a.npz").touch()

    problems = list(inputs(["", "-", "missing.jsonl"], (".jsonl",)))

    assert [type(problem) for problem in problems] == 3 * [NoInputError]


def test_a_named_pipe_is_yielded_as_a_problem_without_being_read(tmp_path):
    os.mkfifo(tmp_path / "records")

    (found,) = inputs([tmp_path / "records"], [".jsonl"])

    assert isinstance(found, NoInputError)
    assert "pipe" in str(found)


def test_stdin_names_files_folders_and_records(tmp_path, monkeypatch):
    (tmp_path / "a.npz").touch()
    monkeypatch.setattr("sys.stdin", io.StringIO(f'{tmp_path}\n\n{{"shot": "b"}}\nc d.png\n'))

    first, record, last = inputs(["-"], (".npz",))

    assert first == tmp_path / "a.npz"
    assert record == Record("standard input:3", {"shot": "b"})
    assert str(last) == "c d.png"


def test_an_invalid_record_is_yielded_as_a_problem(monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO('{"shot": \n{"shot": "b"}\n'))

    problem, record = inputs(["-"], ())

    assert isinstance(problem, DataError)
    assert record == Record("standard input:2", {"shot": "b"})


@pytest.mark.parametrize(("name", "compressed"), [("d.jsonl", False), ("d.jsonl", True), ("d.jsonl.gz", True)])
def test_a_file_of_records_yields_them_whether_it_is_compressed_or_not(tmp_path, name, compressed):
    content = b'{"shot": "a"}\n\n{"shot": "b"}\n'
    (tmp_path / name).write_bytes(gzip.compress(content) if compressed else content)

    found = list(inputs([tmp_path / name], (".jsonl",)))

    assert found == [Record(f"{tmp_path / name}:1", {"shot": "a"}), Record(f"{tmp_path / name}:3", {"shot": "b"})]


def test_an_endless_line_is_rejected(tmp_path, monkeypatch):
    with (tmp_path / "endless").open("wb") as stream:
        stream.truncate(2**30)

    with (tmp_path / "endless").open() as stream:
        monkeypatch.setattr("sys.stdin", stream)
        with pytest.raises(DataError, match=r"standard input: .* 32 MiB"):
            list(inputs(["-"], ()))


def test_lines_longer_than_a_chunk_are_complete(tmp_path, monkeypatch):
    names = ["a" * 200_000, "b", "", "c" * 70_000]
    (tmp_path / "names").write_text("\n".join(names))

    with (tmp_path / "names").open() as stream:
        monkeypatch.setattr("sys.stdin", stream)
        assert "".join(stdin.lines()) == "\n".join(names)


@pytest.mark.parametrize("name", ["a.jsonl", "a.jsonl.gz"])
@pytest.mark.parametrize(
    ("content", "found"), [(b"\n" * 200_000, "100000 empty lines"), (b" " * 2**25 + b"\n", "32 MiB or more")]
)
def test_endless_blank_lines_and_endless_lines_are_refused(tmp_path, name, content, found):
    (tmp_path / name).write_bytes(gzip.compress(content) if name.endswith(".gz") else content)

    (problem,) = inputs([tmp_path / name], [".jsonl"])

    assert found in problem.finding
