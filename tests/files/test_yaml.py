from pathlib import Path
from tempfile import TemporaryFile

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from ringpose.errors import DataError, NoInputError
from ringpose.files.yaml import parsed, read_yaml, write_yaml


@pytest.mark.parametrize(
    ("text", "value"),
    [("1e-3", 0.001), ("-.5E+2", -50.0), ("1.", 1.0), ("012", 12), ("+7", 7), ("true", True), ("~", None)],
)
def test_numbers_follow_yaml_1_2(text, value):
    assert parsed(f"a: {text}".encode(), "x.yaml") == {"a": value}


@pytest.mark.parametrize("text", ["off", "no", "yes", "2026-01-31", "1:30", "0x10", "1_000"])
def test_words_with_another_type_in_yaml_1_1_are_texts(text):
    assert parsed(f"a: {text}".encode(), "x.yaml") == {"a": text}


@pytest.mark.parametrize(
    ("text", "finding"),
    [
        ("a: 1\nb: 2\na: 3", "x.yaml:3: is not valid YAML: the key 'a' occurs twice"),
        ("a: [1,\nb: 2\nc: 3", "x.yaml:3: is not valid YAML"),
        ("a: !!python/object/apply:os.getcwd []", "x.yaml:1: is not valid YAML: could not determine a constructor"),
        ("? [a]\n: 1", "x.yaml:1: is not valid YAML: a key must be a text"),
        ("a: " + "[" * 200, "x.yaml:1: is not valid YAML: more than 100 lists and mappings inside each other"),
        ("a: " + "[" * 100_000, "x.yaml:1: is not valid YAML"),
        ("a: \x01", "x.yaml: is not valid YAML"),
        ("a: 1\n---\nb: 2", "x.yaml:2: is not valid YAML"),
        ("a: &a [1, *a]", "x.yaml:1: is not valid YAML: found unconstructable recursive"),
        (bytes(range(128, 256)), "x.yaml: is not valid YAML"),
    ],
)
def test_invalid_yaml_gives_one_line_with_its_location(text, finding):
    with pytest.raises(DataError) as caught:
        parsed(text if isinstance(text, bytes) else text.encode(), "x.yaml")

    assert str(caught.value).startswith(finding)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "- 1", "just words"])
def test_a_file_must_contain_a_mapping(tmp_path: Path, text):
    (tmp_path / "x.yaml").write_text(text)

    with pytest.raises(DataError, match="must be a mapping"):
        read_yaml(tmp_path / "x.yaml")


def test_a_missing_file_is_a_missing_input(tmp_path: Path):
    with pytest.raises(NoInputError, match="does not exist"):
        read_yaml(tmp_path / "x.yaml")


_SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**12), 10**12),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(st.characters(codec="utf-8", exclude_categories=("C",)), max_size=12),
    st.sampled_from(["off", "1e-3", "1:30", "2026-01-31", "010", "~", "", "true", "0x1F", "1_000", ".5"]),
)


@given(st.dictionaries(st.text("abc_", min_size=1), st.one_of(_SCALARS, st.lists(_SCALARS))))
def test_written_values_are_read_back_by_this_parser_and_another(values):
    with TemporaryFile() as stream:
        write_yaml(stream, values)
        stream.seek(0)
        written = stream.read()

    assert parsed(written, "x.yaml") == values
    assert yaml.safe_load(written) == values


def test_file_names_with_invalid_utf_8_are_read_back(tmp_path):
    with (tmp_path / "x.yaml").open("wb") as stream:
        write_yaml(stream, {"caf\udce9": "caf\udce9.png"})

    assert read_yaml(tmp_path / "x.yaml").text(r"caf\udce9") == r"caf\udce9.png"


def aliases(levels: int) -> str:
    """A list of ten, a list of ten of these, and so on."""
    lists = [f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 10)}]\n" for level in range(1, levels)]
    return "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(lists)


def test_aliases_are_resolved():
    assert parsed(aliases(2).encode(), "x.yaml")["a1"] == [[1] * 10] * 10


@pytest.mark.parametrize("levels", [6, 30])
def test_aliases_that_expand_to_more_than_a_million_values_are_rejected(levels):
    with pytest.raises(DataError, match=r"x\.yaml:\d+: .*aliases"):
        parsed(aliases(levels).encode(), "x.yaml")
