"""Bytes of input files, text and pages as output, and the provenance of a result."""

import csv
import errno
import hashlib
import io
import math
import shlex
import stat
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

from ringpose.errors import DataError, InputOutputError, NoInputError
from ringpose.files import atomic, records
from ringpose.types.table import Cell, Table

MAX_BYTES = 2**31
"""Four times the size of the largest allowed shot, uncompressed."""

MIN_SECRET_BYTES = 16

_CANNOT_OPEN = {errno.ELOOP, errno.ENAMETOOLONG, errno.ENXIO, errno.ENODEV}


def read_bytes(path: Path) -> bytes:
    """The bytes of an input file; a missing or inaccessible file raises `NoInputError`."""
    with opened(path) as stream:
        return stream.read()


@contextmanager
def opened(path: Path) -> Iterator[io.BufferedReader]:
    """An input file, open to be read; a missing or inaccessible file raises `NoInputError`."""
    if "\0" in str(path):
        raise NoInputError(repr(str(path)), "is not a valid file name")
    try:
        _check_length(path)
        with path.open("rb") as stream:
            yield stream
    except (FileNotFoundError, NotADirectoryError):
        raise NoInputError(str(path), "does not exist") from None
    except IsADirectoryError:
        raise NoInputError(str(path), "is a folder, must be a file") from None
    except PermissionError:
        raise NoInputError(str(path), "cannot be opened: permission denied") from None
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        if error.errno in _CANNOT_OPEN:
            raise NoInputError(str(path), f"cannot be opened: {reason}") from None
        raise InputOutputError(str(path), f"reading broke off: {reason}") from error


def _check_length(path: Path) -> None:
    if path.is_char_device():  # /dev/zero never ends
        raise NoInputError(str(path), "is a device, must be a file")
    if path.stat().st_size > MAX_BYTES:
        raise DataError(str(path), f"has more than {MAX_BYTES >> 30} GiB", "split it")


def read_secret(path: Path) -> bytes:
    """The contents of a secret's file without white space at its ends; rejected if short or readable by others."""
    secret = read_bytes(path).strip()
    if len(secret) < MIN_SECRET_BYTES:
        finding = f"is a secret of {len(secret)} bytes, must have at least {MIN_SECRET_BYTES}"
        raise DataError(str(path), finding, "make one: head -c 32 /dev/urandom | base64 >FILE")
    if path.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise DataError(str(path), "is a secret that other users can read", f"chmod 600 {path}")
    return secret


def csv_text(table: Table) -> str:
    """A table as CSV."""
    stream = io.StringIO()
    write_csv(stream, table)
    return stream.getvalue()


def write_csv(stream: io.TextIOBase, table: Table) -> None:
    """Write a table row by row as CSV (RFC 4180), with line feeds instead of CR LF.

    Cells without a value, and numbers that are not finite, are empty; truth values are `true` and `false`.
    """
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(table.headings)
    writer.writerows(map(_csv_cell, row) for row in table.rows)


def _csv_cell(value: Cell) -> Cell:
    if isinstance(value, bool):
        return str(value).lower()
    return "" if value is None or (isinstance(value, float) and not math.isfinite(value)) else value


def write_result(target: str, text: str, *, force: bool) -> None:
    """Write a result, as JSON or CSV text, to stdout if the target is `-`, else to a file."""
    if target == records.STDOUT:
        records.write_text(text)
        return
    with atomic.replacing(Path(target), force) as stream:
        stream.write(text.encode())


def write_page(path: Path, html: str, *, force: bool = False) -> None:
    """Write one HTML page."""
    with atomic.replacing(path, force) as stream:
        stream.write(html.encode(errors="backslashreplace"))  # file names may contain bytes that are not UTF-8


@lru_cache
def software() -> str:
    """Program and version, as records have them: `ringpose 0.2.0`."""
    return f"ringpose {version()}"


@lru_cache
def version() -> str:
    """The version, by the name of the folder that installers write; importlib.metadata takes 20 ms to import."""
    for folder in sys.path:
        installed = next(Path(folder).glob("ringpose-*.dist-info"), None)
        if installed is not None:
            return installed.name.removeprefix("ringpose-").removesuffix(".dist-info")
    from importlib import metadata

    return metadata.version("ringpose")


def provenance(inputs: Iterable[Path]) -> dict[str, Any]:
    """The `provenance` entry of an output file: version, command line, time, and hashes of the inputs."""
    return {
        "version": version(),
        "command": shlex.join(["ringpose", *sys.argv[1:]]),
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "inputs": {str(path): sha256(path) for path in inputs},
    }


def sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
