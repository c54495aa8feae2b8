"""Records: one JSON object a line. Only this module writes to standard output."""

import json
import math
import signal
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ringpose.errors import DataError, InputOutputError, SignalReceived

if TYPE_CHECKING:
    import msgspec

STDOUT = "-"
"""Argument that stands for standard output instead of a file."""

_LOCATION = "standard output"


def line_of(record: Mapping[str, Any]) -> str:
    """The record as strict JSON on one line, in ASCII; numbers that are not finite become null.

    There is a space behind the commas and colons of the record's own keys, for those who search lines for `"key": `.
    """
    return f"{{{', '.join([f'{_encoded(str(key))}: {_encoded(value)}' for key, value in record.items()])}}}\n"


def _encoded(value: Any) -> str:
    with suppress(ValueError, OverflowError):  # a name of a file that is not UTF-8, or a number of more than 64 bits
        text = _encoder().encode(value).decode()
        if text.isascii():
            return text
    return json.dumps(plain(value), allow_nan=False, separators=(",", ":"))


@lru_cache
def _encoder() -> "msgspec.json.Encoder":
    import msgspec  # as slow to import as JSON lines are to be written by a short command

    return msgspec.json.Encoder(enc_hook=plain)


def write(record: Mapping[str, Any]) -> None:
    """Write one record to stdout and flush it."""
    write_text(line_of(record))


def write_name(path: Path) -> None:
    """Write a file's name to stdout; a name that begins with `{` gets the prefix `./`, so as not to look like JSON."""
    name = str(path)
    if "\n" in name or "\r" in name:
        raise DataError(repr(name), "cannot be written on one line: the name has a line break", "rename it")
    write_text(f"./{name}\n" if name.lstrip().startswith("{") else f"{name}\n")


def write_text(line: str) -> None:
    """Write text to stdout and flush it; a closed pipe raises `SignalReceived`, as SIGPIPE would end the process."""
    if sys.stdout is None:
        raise InputOutputError(_LOCATION, "is closed")
    try:
        sys.stdout.write(line)
        sys.stdout.flush()
    except BrokenPipeError:
        raise SignalReceived(signal.SIGPIPE) from None
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputOutputError(_LOCATION, f"writing broke off: {reason}") from error


def read(stream: Iterable[str | bytes], location: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the location and the record of each line that is not blank, as soon as the line has been read."""
    for number, line in enumerate(stream, start=1):
        if line.strip():
            where = f"{location}:{number}"
            yield where, parsed_record(line, where)


def parsed_record(line: str | bytes, location: str) -> dict[str, Any]:
    """The record on one line; NaN and Infinity are rejected, since they are not JSON."""
    from ringpose.files.schema import NOT_KNOWN

    def reject_constant(word: str) -> None:
        if word == "NaN":
            raise DataError(location, *NOT_KNOWN)
        raise ValueError(f"{word} is not a number; leave out what is not known")

    try:
        record = json.loads(line, parse_constant=reject_constant, object_pairs_hook=_mapping)
    except (ValueError, RecursionError) as error:
        reason = str(error).splitlines()[0]
        raise DataError(location, f"is not valid JSON: {reason}") from None
    if not isinstance(record, dict):
        raise DataError(location, "is not a record", "write one JSON object a line")
    return record


def _mapping(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    record = dict(pairs)
    if len(record) != len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"the key {next(n for n in names if names.count(n) > 1)!r} occurs twice")
    return record


def plain(value: Any) -> Any:
    """The value in types of JSON and YAML; non-finite numbers become None, data classes mappings of their fields."""
    if isinstance(value, np.ndarray | np.generic):
        finite = np.isfinite(value) if value.dtype.kind == "f" else np.True_
        if finite.all():
            return value.tolist()
        with_none = np.asarray(value, dtype=object)
        with_none[~finite] = None
        return with_none.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, Enum):
        return plain(value.value)
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    return str(value) if isinstance(value, Path) else value
