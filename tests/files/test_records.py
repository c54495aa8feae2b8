import io
import json
import math
from pathlib import Path

import numpy as np
import pytest

from ringpose.errors import DataError
from ringpose.files import records
from ringpose.files.inputs import inputs


def test_line_numbers_count_blank_lines():
    assert [location for location, _ in records.read(["{}\n", "\n", "{}\n"], "x")] == ["x:1", "x:3"]


def test_record_is_one_line_of_strict_json(capsys):
    records.write(
        {"a": np.array([1.5, math.nan, -math.inf]), "b": np.float64(math.inf), "c": (1, np.int64(2)), "d": "ä\n"}
    )

    out = capsys.readouterr().out

    assert out.count("\n") == 1
    assert json.loads(out) == {"a": [1.5, None, None], "b": None, "c": [1, 2], "d": "ä\n"}


@pytest.mark.parametrize("text", ["\udcff.npz", "ä", "\u2028"])
def test_a_line_is_ascii_whatever_a_file_is_called(text):
    line = records.line_of({"shot": text, "more": {text: [text, 2**70, math.nan]}})

    assert line.isascii()
    assert json.loads(line) == {"shot": text, "more": {text: [text, 2**70, None]}}


def test_lines_are_read_one_by_one_with_their_location():
    lines = iter(['{"a": 1}\n', "\n", '{"a": 2}\n'])

    first = next(records.read(lines, "poses.jsonl"))

    assert first == ("poses.jsonl:1", {"a": 1})
    assert next(lines) == "\n"


@pytest.mark.parametrize(
    ("line", "finding"),
    [
        ('{"a": NaN}', "has null or NaN among its numbers; leave out what is not known"),
        ('{"a": -Infinity}', "-Infinity is not a number"),
        ('{"a": 1, "a": 2}', "the key 'a' occurs twice"),
        ('{"a": 1', "is not valid JSON"),
        ("[1]", "is not a record"),
        ("[" * 100_000, "is not valid JSON"),
    ],
)
def test_an_invalid_line_is_rejected_with_its_location(line, finding):
    with pytest.raises(DataError) as caught:
        list(records.read([line], "x"))

    assert str(caught.value).startswith("x:1: ")
    assert finding in str(caught.value)


@pytest.mark.parametrize(("name", "line"), [("s/a.npz", "s/a.npz"), ("{s/a.npz", "./{s/a.npz"), (" {.npz", "./ {.npz")])
def test_a_written_name_is_read_back(capsys, monkeypatch, name, line):
    records.write_name(Path(name))

    written = capsys.readouterr().out
    assert written == f"{line}\n"
    monkeypatch.setattr("sys.stdin", io.StringIO(written))
    assert list(inputs(["-"], (".npz",))) == [Path(name)]


@pytest.mark.parametrize("name", ["a\nb.npz", "a\r/b.npz"])
def test_a_name_with_a_line_break_is_rejected(capsys, name):
    with pytest.raises(DataError, match="has a line break; rename it"):
        records.write_name(Path(name))

    assert capsys.readouterr().out == ""
