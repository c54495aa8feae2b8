"""What a command is given to read: files, folders, or `-`, each yielded as soon as it is named.

Lines of stdin as they come.
"""

import gzip
import io
import os
import select
import sys
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from ringpose.errors import DataError, InputOutputError, NoInputError
from ringpose.files import records
from ringpose.files.io import read_bytes

STDIN = "-"

RECORDS_SUFFIX = ".jsonl"

COMPRESSED_SUFFIX = ".jsonl.gz"

_GZIP = b"\x1f\x8b"
"""Signature (RFC 1952)."""

MAX_NAME = 1024
"""Half a record is longer."""


class Record(NamedTuple):
    """A JSON record that came on stdin, and the place it came from."""

    place: str
    values: dict[str, Any]


Input = Path | Record

Problem = DataError | NoInputError


def inputs(arguments: Iterable[str | Path], suffixes: Iterable[str]) -> Iterator[Input | Problem]:
    """The inputs in the order in which they are named; of a folder its files with these suffixes, by name.

    A `.jsonl` or `.jsonl.gz` file, where that is a wanted suffix, stands for its records. `-` stands for what stdin
    names, one a line, read as it comes: a name (file or folder), or a JSON record. What cannot be an input is yielded
    as the error that says so, for the caller's batch to report and go on.
    """
    wanted = tuple(suffixes)
    for argument in arguments:
        if str(argument) == STDIN:
            yield from _named_on_stdin(wanted)
        elif not str(argument):
            yield NoInputError('""', "an empty name is no input")
        else:
            yield from _opened(Path(argument), wanted)


def _named_on_stdin(suffixes: tuple[str, ...]) -> Iterator[Input | Problem]:
    if sys.stdin is None:
        yield NoInputError("standard input", "is closed")
        return
    for number, line in enumerate(lines(), start=1):
        text = line.strip()
        if text.startswith("{"):
            yield _record(text, f"standard input:{number}")
        elif text:
            yield from _opened(Path(line.rstrip("\r\n")), suffixes)


def _opened(path: Path, suffixes: tuple[str, ...]) -> Iterator[Input | Problem]:
    for item in _paths(path, suffixes):
        if isinstance(item, Path) and RECORDS_SUFFIX in suffixes and holds_records(item):
            yield from _records_in(item)
        else:
            yield item


def holds_records(path: Path) -> bool:
    """Whether the name is that of a file of records, `.jsonl` or `.jsonl.gz`."""
    return path.name.lower().endswith((RECORDS_SUFFIX, COMPRESSED_SUFFIX))


def _records_in(path: Path) -> Iterator[Record | Problem]:
    try:
        for number, line in enumerate(_lines(path), start=1):
            if line.strip():
                yield _record(line, f"{path}:{number}")
    except (NoInputError, DataError) as problem:
        yield problem


def _lines(path: Path) -> Iterator[bytes]:
    """The lines of a file; those of a compressed one, whatever its name, are decompressed as they are read."""
    data = read_bytes(path)
    if not path.name.lower().endswith(COMPRESSED_SUFFIX) and not data.startswith(_GZIP):
        yield from data.splitlines()
        return
    try:
        with gzip.open(io.BytesIO(data)) as stream:
            while line := stream.readline(MAX_LINE_BYTES):
                if len(line) == MAX_LINE_BYTES:
                    found = f"has a line of {MAX_LINE_BYTES >> 20} MiB or more"
                    raise DataError(str(path), found, "end each record")
                yield line
    except (OSError, EOFError, zlib.error) as error:
        raise DataError(str(path), f"cannot be decompressed: {str(error).lower()}") from None


def _record(line: str | bytes, place: str) -> Record | DataError:
    try:
        return Record(place, records.record_of(line, place))
    except DataError as problem:
        return problem


def _paths(path: Path, suffixes: tuple[str, ...]) -> Iterator[Path | NoInputError]:
    try:
        files = sorted(child for child in path.iterdir() if _wanted(child, suffixes)) if path.is_dir() else [path]
    except OSError as error:
        yield NoInputError(_shown(path), f"cannot be opened: {(error.strerror or str(error)).lower()}")
        return
    if not files:
        yield NoInputError(str(path), f"holds no file that ends with {', '.join(suffixes)}")
    yield from files


def _shown(path: Path) -> str:
    """The name, of a line that is none only how it begins."""
    name = str(path)
    return name if len(name) <= MAX_NAME else f"{name[:60]}..."


def _wanted(path: Path, suffixes: tuple[str, ...]) -> bool:
    return path.suffix.lower() in suffixes and not path.name.startswith(".")


PATIENCE_S = 0.2
"""A signal that arrives just before a read begins does not wake it: Python notices it only between two waits."""

MAX_LINE_BYTES = 2**25
"""A record with all stripes of 1600 x 1200 pixels has 1 % of it."""

_CHUNK = 1 << 16


def lines() -> Iterator[str]:
    """Each line as soon as it is whole, and the last one even if it is not; bytes that are no UTF-8 are kept."""
    try:
        descriptor = sys.stdin.fileno()
    except (AttributeError, io.UnsupportedOperation):  # a stand-in without a file behind it
        yield from sys.stdin
        return
    rest = bytearray()
    while chunk := _chunk(descriptor):
        *whole, end = chunk.split(b"\n")
        for line in whole:
            yield _text(bytes(rest) + line + b"\n")
            rest.clear()
        rest += end
        if len(rest) > MAX_LINE_BYTES:
            raise DataError("standard input", f"has a line of more than {MAX_LINE_BYTES >> 20} MiB", "end each record")
    if rest:
        yield _text(bytes(rest))


def _chunk(descriptor: int) -> bytes:
    try:
        while not select.select([descriptor], [], [], PATIENCE_S)[0]:
            pass
        return os.read(descriptor, _CHUNK)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputOutputError("standard input", f"reading broke off: {reason}") from error


def _text(line: bytes) -> str:
    return line.decode("utf-8", "surrogateescape")
