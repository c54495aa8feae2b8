"""`ringpose schema`."""

import json

import pytest
from schemas import SCHEMAS

from ringpose.cli.main import main
from ringpose.files.cpp_header import cpp_header


def test_without_a_name_the_names_are_listed(capsys):
    assert main(["schema"]) == 0

    assert capsys.readouterr().out.splitlines() == list(SCHEMAS)


@pytest.mark.parametrize("name", SCHEMAS)
def test_a_schema_is_printed(capsys, name):
    assert main(["schema", name]) == 0

    assert json.loads(capsys.readouterr().out) == SCHEMAS[name]


def test_an_unknown_name_is_wrong_usage(capsys):
    assert main(["schema", "detections"]) == 2

    streams = capsys.readouterr()
    assert (streams.out, streams.err.count("\n")) == ("", 1)
    assert "did you mean 'detection'?" in streams.err


def test_the_cpp_header_is_that_of_the_schemas(capsys):
    assert main(["schema", "--cpp"]) == 0

    assert capsys.readouterr().out == cpp_header(SCHEMAS)


def test_the_cpp_header_has_no_name(capsys):
    assert main(["schema", "--cpp", "pose"]) == 2

    assert "--cpp: is one header for pose and track; leave out NAME" in capsys.readouterr().err
