"""A serial port, opened exclusively; all its errors are raised as `DeviceError`."""

import errno
import os
import select
import termios
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import serial

from ringpose.errors import DeviceError

WRITE_LIMIT_S = 0.25

REMEDIES = {
    errno.ENOENT: "see ls /dev/serial/by-id for what is plugged in",
    errno.EACCES: "you may need to be in the group dialout: sudo usermod -aG dialout $USER, then log in again",
    errno.EAGAIN: "another program uses it; end that first",
    errno.EBUSY: "another program uses it; end that first",
    errno.ENOTTY: "it is not a serial port",
}


class SerialPort:
    """An exclusive serial port whose wait for an answer can be interrupted."""

    def __init__(self, name: str, baud: int) -> None:
        self.name = name
        self.interrupting: Sequence[int] = ()
        """File descriptors; when one becomes readable, waiting for an answer ends."""
        self._baud = baud
        self._serial: serial.Serial | None = None

    def open(self) -> None:
        """Open the port."""
        with self._mapped():
            self._serial = serial.Serial(self.name, self._baud, timeout=0, write_timeout=WRITE_LIMIT_S, exclusive=True)

    def close(self) -> None:
        """Close the port; closing it twice does nothing."""
        port, self._serial = self._serial, None
        if port is not None:
            with self._mapped():
                port.close()

    @property
    def fileno(self) -> int:
        """The file descriptor, to poll for a hang-up."""
        return int(self._opened.fileno())

    def exchange(
        self, request: bytes, is_complete: Callable[[bytes], bool], limit_s: float, quiet_s: float = 0.0
    ) -> bytes:
        """Write, then read until the answer is complete or the time limit is reached; returns what was received.

        The port must have been quiet for `quiet_s` before the request, and is read until it is quiet again.
        """
        self._read_until_quiet(quiet_s)
        with self._mapped():
            self._opened.reset_input_buffer()
            self._opened.write(request)
        received, ends_s = b"", time.monotonic() + limit_s
        while not is_complete(received) and self._readable(ends_s - time.monotonic()):
            received += self._read()
        return received + self._read_until_quiet(quiet_s) if received else b""

    def _read_until_quiet(self, quiet_s: float) -> bytes:
        """What arrives until nothing has come for a while; a port that never rests is read ten times as long."""
        received, ends_s = b"", time.monotonic() + 10 * quiet_s
        while quiet_s and time.monotonic() < ends_s and self._readable(quiet_s):
            received += self._read()
        return received

    def _read(self) -> bytes:
        with self._mapped():
            return bytes(self._opened.read(4096))

    def is_contact_closed(self, name: str) -> bool:
        """Whether the input `cts` or `dsr` is asserted."""
        with self._mapped():
            return bool(getattr(self._opened, name))

    def _readable(self, within_s: float) -> bool:
        poll = select.poll()
        poll.register(self._opened.fileno(), select.POLLIN)
        for number in self.interrupting:
            poll.register(number, select.POLLIN)
        ready = dict(poll.poll(max(0.0, within_s) * 1000))
        if any(number in ready for number in self.interrupting):
            return False
        return self._opened.fileno() in ready

    @property
    def _opened(self) -> serial.Serial:
        if self._serial is None:
            raise DeviceError(self.name, "is not open")
        return self._serial

    @contextmanager
    def _mapped(self) -> Iterator[None]:
        """Convert errors: termios.error is no OSError, and pyserial's errors have no errno if a cable was pulled."""
        try:
            yield
        except (OSError, termios.error, ValueError) as error:
            number = _number(error)
            remedy = REMEDIES.get(number or 0, "check cable and power")
            finding = f"failed: {error}" if number is None else f"cannot be used: {os.strerror(number).lower()}"
            raise DeviceError(self.name, finding, remedy) from error


def _number(error: BaseException | None) -> int | None:
    """The errno of an error, or of its cause: some errors of pyserial have none of their own."""
    if error is None:
        return None
    number = next((part for part in error.args if isinstance(part, int)), None)
    return _number(error.__context__) if number is None else number
