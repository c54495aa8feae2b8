"""Lines of stdin as they come."""

import io
import os
import select
import sys
from collections.abc import Iterator

from ringpose.errors import DataError, InputOutputError

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
