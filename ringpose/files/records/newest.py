"""Output for slow readers: they get the newest line, not those that have piled up."""

import os
import select
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from stat import S_ISFIFO
from typing import Any

from ringpose.files import records

POLL_S = 0.001
"""Interval at which a pipe is checked for having been read."""


class NewestWriter:
    """Writes the newest record whenever the reader has read the previous one; records in between are skipped.

    `lines_skipped` in each record is the number of records skipped since the previous one. Standard output that is not
    a pipe takes every record. The pipe's contents are inspected with FIONREAD; where that is not available, a record is
    written as soon as the pipe has room for it.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting: Mapping[str, Any] | None = None
        self._skipped = 0
        self._ended = False
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._write, daemon=True)
        self._thread.start()

    def __enter__(self) -> "NewestWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Wait until the last line has been written, unless an error or a signal ends the block."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        if kind is not None:
            return
        self._thread.join()
        if self._failure is not None:
            raise self._failure

    def write(self, record: Mapping[str, Any]) -> None:
        """Replace the waiting record by this one; raises the error of an earlier record that could not be written."""
        with self._changed:
            if self._failure is not None:
                raise self._failure
            self._skipped += self._waiting is not None
            self._waiting = record
            self._changed.notify()

    def _write(self) -> None:
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._waiting is not None or self._ended)
                    if self._waiting is None:
                        return
                self._wait_for_reader()
                with self._changed:
                    record, skipped = self._waiting, self._skipped
                    self._waiting, self._skipped = None, 0
                records.write({**record, "lines_skipped": skipped})
        except BaseException as failure:  # raised again by the main thread
            self._failure = failure

    def _wait_for_reader(self) -> None:
        while not _is_read():
            with self._changed:
                self._changed.wait_for(lambda: False, POLL_S)


def _is_read() -> bool:
    """Whether everything that was written to a pipe has been read; true if that cannot be found out."""
    with suppress(AttributeError, ImportError, OSError, ValueError):
        import fcntl
        import termios

        descriptor, closed = sys.stdout.fileno(), select.poll()
        closed.register(descriptor, 0)
        if S_ISFIFO(os.fstat(descriptor).st_mode) and not closed.poll(0):  # else writing reports the closed pipe
            waiting = fcntl.ioctl(descriptor, termios.FIONREAD, b"\0\0\0\0")
            return int.from_bytes(waiting, sys.byteorder) == 0
    return True
