"""Inputs of a command: files, folders, or `-` for stdin, each yielded as soon as its name or record is available."""

import gzip
import io
import os
import select
import sys
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ringpose.errors import DataError, InputOutputError, NoInputError
from ringpose.files import records
from ringpose.files.io import opened
from ringpose.types.image import name_order
from ringpose.types.options import STDIN

if TYPE_CHECKING:
    from ringpose.types.detection import Detection
    from ringpose.types.image import Shot
    from ringpose.types.rig import Rig

RECORDS_SUFFIX = ".jsonl"

COMPRESSED_SUFFIX = ".jsonl.gz"

_GZIP = b"\x1f\x8b"
"""Signature of gzip files (RFC 1952)."""

MAX_BLANK_LINES = 100_000
"""Maximum number of empty lines in a row: a small compressed file can hold any number of them."""

MAX_NAME = 1024
"""Longer names are abbreviated in messages: they are usually records that were cut off."""


class Record(NamedTuple):
    """A JSON record and its location, `file:line`."""

    location: str
    values: dict[str, Any]


Input = Path | Record

Problem = DataError | NoInputError


def inputs(arguments: Iterable[str | Path], suffixes: Iterable[str]) -> Iterator[Input | Problem]:
    """Yield the inputs in the given order; a folder yields its files with one of the suffixes, view 2 before view 10.

    A `.jsonl` or `.jsonl.gz` file yields its records if `.jsonl` is among the suffixes. `-` reads stdin line by line;
    each line is the name of a file or folder, or a JSON record. An invalid input, or a source without any, is yielded
    as its error, so that the caller's batch can report it and continue.
    """
    suffixes = tuple(suffixes)
    for argument in arguments:
        if str(argument) == STDIN:
            yield from _listed_on_stdin(suffixes)
        elif not str(argument):
            yield NoInputError('""', "is an empty name")
        else:
            yield from _opened(Path(argument), suffixes)


def shot_name(item: Input) -> str:
    """The name of the shot in an input: that of its file without suffix, or what its record states."""
    return item.stem if isinstance(item, Path) else str(item.values.get("shot", ""))


def path_of_input(item: Input) -> Path:
    """The path of an input that must be a shot or image; a record, and a file of records, is rejected."""
    if isinstance(item, Path):
        if holds_records(item):
            raise DataError(str(item), "is a file of records", "give shots or images")
        return item
    raise DataError(item.location, "is a record", "give the name of a shot or image")


def _listed_on_stdin(suffixes: tuple[str, ...]) -> Iterator[Input | Problem]:
    if sys.stdin is None:
        yield NoInputError("standard input", "is closed")
        return
    is_empty = True
    for number, line in enumerate(lines(), start=1):
        text = line.strip()
        is_empty = is_empty and not text
        if text.startswith("{"):
            yield _record(text, f"standard input:{number}")
        elif text:
            yield from _opened(Path(line.rstrip("\r\n")), suffixes)
    if is_empty:
        yield NoInputError("standard input", "is empty", "give names or records, one a line")


def _opened(path: Path, suffixes: tuple[str, ...]) -> Iterator[Input | Problem]:
    for item in _paths(path, suffixes):
        if not (isinstance(item, Path) and RECORDS_SUFFIX in suffixes and holds_records(item)):
            yield item
            continue
        is_empty = True
        try:
            for number, line in enumerate(file_lines(item), start=1):
                if line.strip():
                    is_empty = False
                    yield _record(line, f"{item}:{number}")
            if is_empty:
                yield DataError(str(item), "holds no record", "give one record a line")
        except (NoInputError, DataError) as problem:
            yield problem


def holds_records(path: Path) -> bool:
    """Whether the file's name ends with `.jsonl` or `.jsonl.gz`."""
    return path.name.lower().endswith((RECORDS_SUFFIX, COMPRESSED_SUFFIX))


def file_lines(path: Path) -> Iterator[bytes]:
    """Yield the lines of a file; a compressed file, recognised by its contents, is decompressed as it is read."""
    with opened(path) as stream:
        if not (path.name.lower().endswith(COMPRESSED_SUFFIX) or stream.peek(len(_GZIP)).startswith(_GZIP)):
            yield from limited_lines(stream, str(path))
            return
        try:
            with gzip.GzipFile(fileobj=stream) as unpacked:
                yield from limited_lines(unpacked, str(path))
        except (OSError, EOFError, zlib.error) as error:
            raise DataError(str(path), f"cannot be decompressed: {str(error).lower()}") from None


def limited_lines(stream: io.BufferedIOBase, location: str) -> Iterator[bytes]:
    """Yield the lines of a stream, of which neither the length nor the number of empty ones in a row is unlimited."""
    blank = 0
    while line := stream.readline(MAX_LINE_BYTES):
        if len(line) == MAX_LINE_BYTES:
            raise DataError(location, f"has a line of {MAX_LINE_BYTES >> 20} MiB or more", "end each record")
        blank = 0 if line.strip() else blank + 1
        if blank > MAX_BLANK_LINES:
            raise DataError(location, f"has more than {MAX_BLANK_LINES} empty lines in a row", "remove them")
        yield line


def _record(line: str | bytes, location: str) -> Record | DataError:
    try:
        return Record(location, records.parsed_record(line, location))
    except DataError as problem:
        return problem


def _paths(path: Path, suffixes: tuple[str, ...]) -> Iterator[Path | NoInputError]:
    try:
        files = [path]
        if path.is_dir():
            children = (child for child in path.iterdir() if not child.name.startswith("."))
            listed = (child for child in children if child.suffix.lower() in suffixes)
            files = sorted(listed, key=lambda child: (name_order(child.name), child.name))
        elif path.is_fifo() and not holds_records(path):  # its kind shows only in its contents, which can be read once
            yield NoInputError(str(path), "is a pipe, must be a file", "give - and the records on standard input")
            return
    except OSError as error:
        name = str(path) if len(str(path)) <= MAX_NAME else f"{str(path)[:60]}..."
        yield NoInputError(name, f"cannot be opened: {(error.strerror or str(error)).lower()}")
        return
    if not files:
        yield NoInputError(str(path), f"holds no file that ends with {', '.join(suffixes)}")
    yield from files


POLL_S = 0.2
"""Timeout of one wait for stdin. A signal that arrives just before the wait begins does not interrupt it; Python runs
the signal handler between two waits."""

MAX_LINE_BYTES = 2**25
"""About 100 times the record of a 1600 x 1200 pixel shot with all its stripes."""

_CHUNK = 1 << 16


def lines() -> Iterator[str]:
    """Yield each line of stdin as soon as it is complete, and the last one even without a line break.

    Bytes that are not UTF-8 are kept as surrogate escapes, since file names may contain them.
    """
    try:
        descriptor = sys.stdin.fileno()
    except (AttributeError, io.UnsupportedOperation):  # replaced by an object without a file descriptor
        yield from sys.stdin
        return
    rest = bytearray()
    while chunk := _chunk(descriptor):
        *whole, end = chunk.split(b"\n")
        for line in whole:
            yield (bytes(rest) + line + b"\n").decode("utf-8", "surrogateescape")
            rest.clear()
        rest += end
        if len(rest) > MAX_LINE_BYTES:
            raise DataError("standard input", f"has a line of more than {MAX_LINE_BYTES >> 20} MiB", "end each record")
    if rest:
        yield rest.decode("utf-8", "surrogateescape")


def _chunk(descriptor: int) -> bytes:
    try:
        while not select.select([descriptor], [], [], POLL_S)[0]:
            pass
        return os.read(descriptor, _CHUNK)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputOutputError("standard input", f"reading broke off: {reason}") from error


@dataclass(frozen=True, slots=True, eq=False)
class SourceReader:
    """Reads an input, and rejects one that does not match the rig; worker processes import this class."""

    rig: "Rig"
    channel: str | None = None
    """Channel of colour images that is read; None for their luminance."""

    def __call__(self, item: Input) -> "Shot | Detection":
        """The shot or detection in an input, by the contents of the file or record."""
        from ringpose.files.images.shots import read_shot, shot_of  # slow to import, as all below
        from ringpose.files.npz import Archive
        from ringpose.files.records.detections import checked_detection, detection_in, detection_of

        if isinstance(item, Record):
            return checked_detection(detection_of(item.values, item.location), self.rig, item.location)
        if item.suffix.lower() != ".npz":
            return read_shot(item, self.channel, self.rig)
        archive = Archive(item)
        if "schema" in archive:  # a shot has none
            return checked_detection(detection_in(archive), self.rig, str(item))
        return shot_of(archive, self.rig)
