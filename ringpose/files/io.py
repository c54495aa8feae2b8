"""A whole file's bytes.

Results as JSON or CSV text, into a file or onto stdout.

HTML pages.
"""

import csv
import errno
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

from ringpose.errors import DataError, InputOutputError, NoInputError
from ringpose.files import atomic, records
from ringpose.files.atomic import replacing

MAX_BYTES = 2**31
"""Four times what the largest shot has, uncompressed."""

_NOT_OPENED = {errno.ELOOP, errno.ENAMETOOLONG, errno.ENXIO, errno.ENODEV}


def read_bytes(path: Path) -> bytes:
    """The bytes of an input file; one that is missing or shut off is no input."""
    try:
        _check_length(path)
        return path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise NoInputError(str(path), "does not exist") from None
    except IsADirectoryError:
        raise NoInputError(str(path), "is a folder, must be a file") from None
    except PermissionError:
        raise NoInputError(str(path), "cannot be opened: permission denied") from None
    except ValueError:
        raise NoInputError(repr(str(path)), "is no name that a file can have") from None
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        if error.errno in _NOT_OPENED:
            raise NoInputError(str(path), f"cannot be opened: {reason}") from None
        raise InputOutputError(str(path), f"reading broke off: {reason}") from error


def _check_length(path: Path) -> None:
    if path.is_char_device():  # /dev/zero never ends
        raise NoInputError(str(path), "is a device, must be a file")
    if path.stat().st_size > MAX_BYTES:
        raise DataError(str(path), f"has more than {MAX_BYTES >> 30} GiB", "split it")


def csv_text(rows: Iterable[Sequence[str | float | int | bool]]) -> str:
    """Rows as RFC 4180 has them, but for bare line feeds."""
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(rows)
    return stream.getvalue()


def write_result(target: str, text: str, *, force: bool) -> None:
    """The text on stdout for `-`, or as a file."""
    if target == records.STDOUT:
        records.write_text(text)
        return
    with replacing(Path(target), force) as stream:
        stream.write(text.encode())


def write_page(path: Path, html: str, *, force: bool = False) -> None:
    """Write one page."""
    with atomic.replacing(path, force) as stream:
        stream.write(html.encode(errors="backslashreplace"))  # names of files may have bytes that are no UTF-8
