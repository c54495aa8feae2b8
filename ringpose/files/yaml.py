"""YAML 1.2 (core schema): `1e-3` is a number, `off` and `2026-01-01` are texts; duplicate keys are rejected."""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import IO, Any

import yaml
from yaml.composer import Composer

from ringpose.errors import DataError
from ringpose.files.io import read_bytes
from ringpose.files.records import plain
from ringpose.files.schema import EXCHANGED, Fields, kind_of_data

MAX_VALUES = 1_000_000
"""Maximum number of values in one document."""

MAX_DEPTH = 100
"""Maximum number of lists and mappings inside each other; the composer is recursive."""

_TAG = "tag:yaml.org,2002:"
_RESOLVERS = [
    ("bool", r"true|True|TRUE|false|False|FALSE", "tTfF"),
    ("int", r"[-+]?[0-9]+", "-+0123456789"),
    (
        "float",
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        "-+.0123456789",
    ),
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
]


class _Loader(Composer, yaml.CSafeLoader):
    """A safe loader for the core schema of YAML 1.2.

    The parser is libyaml's, which is six times faster than PyYAML's. The composer is PyYAML's, since libyaml's
    overflows the C stack on deeply nested files.
    """

    yaml_implicit_resolvers: Any = {}  # noqa: RUF012 (PyYAML fills it per class)

    def __init__(self, text: bytes) -> None:
        yaml.CSafeLoader.__init__(self, text)
        Composer.__init__(self)
        self._values = 0
        self._values_within: dict[int, int] = {}
        self._depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """The next node. The values of an alias count as often as it occurs, which bounds nested aliases."""
        event: Any = self.peek_event()
        before = self._values
        if self._depth > MAX_DEPTH:
            finding = f"more than {MAX_DEPTH} lists and mappings inside each other"
            raise yaml.composer.ComposerError(None, None, finding, event.start_mark)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        is_alias = isinstance(event, yaml.AliasEvent)
        self._values += self._values_within.get(id(node), 0) if is_alias else 1
        if self._values > MAX_VALUES:
            finding = f"more than {MAX_VALUES} values, aliases written out"
            raise yaml.composer.ComposerError(None, None, finding, event.start_mark)
        if not is_alias:
            self._values_within[id(node)] = self._values - before
        return node


def _mapping(loader: _Loader, node: yaml.Node) -> dict[Any, Any]:
    values: dict[Any, Any] = {}
    if not isinstance(node, yaml.MappingNode):
        raise yaml.constructor.ConstructorError(None, None, f"{node.tag} must be a mapping", node.start_mark)
    for key_node, value_node in node.value:
        key = loader.construct_object(key_node, deep=True)
        if not isinstance(key, str | int | float):
            raise yaml.constructor.ConstructorError(None, None, "a key must be a text", key_node.start_mark)
        if key in values:
            raise yaml.constructor.ConstructorError(None, None, f"the key {key!r} occurs twice", key_node.start_mark)
        values[key] = loader.construct_object(value_node, deep=True)
    return values


class _Dumper(yaml.SafeDumper):
    """A dumper that quotes every text that YAML 1.1 or 1.2 would read as another type."""


def _text(dumper: _Dumper, text: str) -> yaml.ScalarNode:
    """Escape bytes that are not UTF-8, as in file names; PyYAML's own escapes of them cannot be read again."""
    return dumper.represent_str(text.encode(errors="backslashreplace").decode())


_Dumper.add_representer(str, _text)

for _name, _pattern, _first in _RESOLVERS:
    for _class in (_Loader, _Dumper):
        _class.add_implicit_resolver(_TAG + _name, re.compile(f"^(?:{_pattern})$"), list(_first))
_Loader.add_constructor(_TAG + "map", _mapping)
_Loader.add_constructor(_TAG + "opencv-matrix", _mapping)
_Loader.add_constructor(_TAG + "opencv-nd-matrix", _mapping)
_Loader.add_constructor(_TAG + "int", lambda _, node: int(node.value))


def parsed(text: bytes, file: str) -> Any:
    """The values in one YAML document; errors are reported with the line."""
    if kind := kind_of_data(text):
        raise DataError(file, f"is {kind}, must be a YAML file", EXCHANGED)
    try:
        return yaml.load(text, Loader=_Loader)  # noqa: S506 (a safe loader)
    except yaml.MarkedYAMLError as error:
        line = f":{error.problem_mark.line + 1}" if error.problem_mark else ""
        raise DataError(file + line, f"is not valid YAML: {error.problem or error.context}") from None
    except (yaml.YAMLError, UnicodeDecodeError, ValueError) as error:
        raise DataError(file, f"is not valid YAML: {str(error).splitlines()[0]}") from None


def read_yaml(path: Path, known: Iterable[str] | None = None) -> Fields:
    """The mapping at the top level of a YAML file; unknown keys are rejected if `known` is given."""
    return Fields(str(path), parsed(read_bytes(path), str(path)), known)


def write_yaml(stream: IO[bytes], values: Mapping[str, Any]) -> None:
    """Write one YAML document, with keys in the given order and lists of numbers on one line."""
    options: Any = {"sort_keys": False, "default_flow_style": None, "width": 120, "allow_unicode": True}
    yaml.dump(plain(values), stream, Dumper=_Dumper, encoding="utf-8", **options)
