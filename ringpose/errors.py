"""Everything that ringpose can complain about, each with its exit status (sysexits.h where it has one).

    RingposeError
      UsageError            2   wrong usage
      DataError            65   a file or record that was read says something impossible
      NoInputError         66   an input does not exist or cannot be opened
      DeviceError          69   a camera or laser board is absent or fails
      LaserSafetyError     70   a laser may be on that should be off
      CannotCreateError    73   an output exists already, or its folder cannot be written
      InputOutputError     74   reading or writing broke off: disk full, cable pulled
    SignalReceived      128+n   SIGHUP, SIGINT, SIGTERM, a closed pipe as an exception, so that `with` blocks run

0 is done, 1 a bug, 3 done although a shot has no pose or a threshold was missed; 141 a closed pipe.
"""

import signal


class RingposeError(Exception):
    """One line for the user: the place, what was found there, what to do about it."""

    status = 1

    def __init__(self, place: str, found: str, remedy: str = "") -> None:
        self.place = place
        self.found = found
        self.remedy = remedy
        super().__init__(place, found, remedy)

    def __str__(self) -> str:
        line = f"{self.place}: {self.found}" if self.place else self.found
        return " ".join((f"{line}; {self.remedy}" if self.remedy else line).split())


class UsageError(RingposeError):
    """The words of the command line do not fit together."""

    status = 2


class DataError(RingposeError):
    """A file or record that was read says something impossible."""

    status = 65


class NoInputError(RingposeError):
    """An input does not exist or cannot be opened."""

    status = 66


class DeviceError(RingposeError):
    """A camera or laser board is absent or fails."""

    status = 69


class LaserSafetyError(RingposeError):
    """A laser may be on that should be off."""

    status = 70


class CannotCreateError(RingposeError):
    """An output exists already, or its folder cannot be written."""

    status = 73


class InputOutputError(RingposeError):
    """Reading or writing broke off."""

    status = 74


class SignalReceived(BaseException):
    """SIGHUP, SIGINT, SIGTERM, or a closed pipe; no `except Exception` swallows it on its way out."""

    def __init__(self, number: int) -> None:
        self.status = 128 + number
        super().__init__(signal.Signals(number).name)


NO_POSE = 3
"""Exit status: done, but a shot has no pose or a threshold was missed."""

CLOSED_PIPE = 128 + signal.SIGPIPE
"""Exit status: the reader of our output has gone."""
