"""Records: one JSON object a line. The one place that writes to stdout.

What YAML and JSON can say: numbers, texts, lists, mappings; null where a number is not finite.
"""

import json
import math
import signal
import sys
from collections.abc import Iterable, Iterator, Mapping
from enum import Enum
from pathlib import Path
from typing import IO, Any

import numpy as np

from ringpose.errors import DataError, InputOutputError, SignalReceived

STDOUT = "-"
"""How standard output is named where a file could be."""

_PLACE = "standard output"


def line_of(record: Mapping[str, Any]) -> str:
    """The record as strict JSON on one line; what is not finite becomes null."""
    return json.dumps(plain(record), allow_nan=False, separators=(", ", ": ")) + "\n"


def write(record: Mapping[str, Any]) -> None:
    """One record on stdout, at once."""
    write_text(line_of(record))


def write_name(path: Path) -> None:
    """The name of a file on stdout, such that who reads lines takes it for that name, and not for a record."""
    name = str(path)
    if "\n" in name or "\r" in name:
        raise DataError(repr(name), "is no name for a line: it has a line break", "rename it")
    write_text(f"./{name}\n" if name.lstrip().startswith("{") else f"{name}\n")


def write_text(line: str) -> None:
    """One line on stdout, at once; a closed pipe ends the command as the signal would."""
    if sys.stdout is None:
        raise InputOutputError(_PLACE, "is closed")
    try:
        sys.stdout.write(line)
        sys.stdout.flush()
    except BrokenPipeError:
        raise SignalReceived(signal.SIGPIPE) from None
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputOutputError(_PLACE, f"writing broke off: {reason}") from error


def read(stream: Iterable[str] | IO[str], place: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """The place and the record of each line that is not blank, as soon as the line is there."""
    for number, line in enumerate(stream, start=1):
        if line.strip():
            where = f"{place}:{number}"
            yield where, record_of(line, where)


def record_of(line: str | bytes, place: str) -> dict[str, Any]:
    """The record on one line; NaN and Infinity are no JSON."""
    try:
        record = json.loads(line, parse_constant=_refuse, object_pairs_hook=_mapping)
    except (ValueError, RecursionError) as error:
        reason = str(error).splitlines()[0]
        raise DataError(place, f"is no JSON: {reason}") from None
    if not isinstance(record, dict):
        raise DataError(place, "is no record", "write one JSON object a line")
    return record


def _refuse(word: str) -> None:
    raise ValueError(f"{word} is not allowed, write null")


def _mapping(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    record = dict(pairs)
    if len(record) != len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"the key {next(n for n in names if names.count(n) > 1)!r} stands twice")
    return record


def plain(value: Any) -> Any:
    """The value without arrays, NumPy scalars, tuples, paths; NaN and infinity become None."""
    if isinstance(value, np.ndarray | np.generic):
        return _finite(value.tolist()) if np.issubdtype(value.dtype, np.floating) else value.tolist()
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, Enum):
        return plain(value.value)
    return _finite(value) if isinstance(value, float) else str(value) if isinstance(value, Path) else value


def _finite(value: Any) -> Any:
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return value if math.isfinite(value) else None
