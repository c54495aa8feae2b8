"""Each case of cases.yaml has its exit status and its message, and leaves nothing invalid behind."""

import io
import json
import re
import shlex
from pathlib import Path
from typing import NamedTuple

import pytest
import yaml
from cases.inputs import make_inputs
from schemas import validated

from ringpose.cli.main import main

TABLE = yaml.safe_load(Path(__file__).with_name("cases.yaml").read_text())
ROWS = {f"{subject}: {row['case']}": row for subject, rows in TABLE.items() for row in rows}
"""The rows of the table by subject and case."""

REQUIRED, OPTIONAL = (
    {"case", "run", "status", "source"},
    {"says", "stdin", "reason", "records", "prints", "lines", "leaves"},
)


class Ended(NamedTuple):
    """What a command has returned, written and left behind."""

    status: int
    out: list[str]
    err: list[str]
    left: set[str]
    """Names of the files and folders that it has made in its working folder."""


@pytest.fixture
def ended(request, tmp_path, monkeypatch, capfd):
    """Runs the command line of a row in a folder with its inputs."""

    def run(row) -> Ended:
        line = re.sub(r"\{(\w+)\}", lambda match: str(request.getfixturevalue(match[1])), row["run"])
        words = shlex.split(line)
        make_inputs(words, tmp_path)
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr("sys.stdin", io.StringIO(row.get("stdin", "")))
        before = {path.name for path in tmp_path.iterdir()}
        capfd.readouterr()
        status = main(words)
        out, err = (text.splitlines() for text in capfd.readouterr())
        return Ended(status, out, err, {path.name for path in tmp_path.iterdir()} - before)

    return run


LONG = ("files and records exchanged: mirrored images of a board with markers",)
"""Rows that take half a second or more."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in LONG else name for name in ROWS]
)
def test_case_has_its_status_and_its_message(ended, name):
    row = ROWS[name]

    status, out, err, left = ended(row)

    assert status == row["status"], err
    message = "\n".join(err)
    for word in row.get("says", []):
        assert word in message
    assert all(re.match("ringpose( [a-z-]+)?: ", line) for line in err)
    assert len(err) == row.get("lines", 1 if "says" in row else 0), err
    assert len(out) == row.get("prints", len(out))
    records = [_record(line) for line in out if line.startswith("{")]
    assert len(records) == row.get("records", 1 if "reason" in row else len(records))
    assert row.get("reason", "") in (records[0]["reason"] or "" if "reason" in row else "")
    if status not in (0, 3):
        assert left == set(row.get("leaves", []))


def test_rows_have_only_the_keys_of_the_table():
    assert len(ROWS) == sum(map(len, TABLE.values())), "a case occurs twice in its subject"
    for row in ROWS.values():
        assert set(row) >= REQUIRED, row
        assert set(row) <= REQUIRED | OPTIONAL, row


def _record(line: str) -> dict:
    """The record on a line, which is strict JSON and fits its schema."""
    record = json.loads(line, parse_constant=pytest.fail)
    return validated(record) if str(record.get("schema")).startswith("ringpose/") else record
