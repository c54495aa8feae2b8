"""Error classes of ringpose, each with its exit status (from sysexits.h where it defines one).

    RingposeError
      UsageError            2   wrong usage
      DataError            65   the contents of a file or record are invalid
      NoInputError         66   an input does not exist or cannot be opened, or standard input is empty
      DeviceError          69   a camera or laser board is absent or fails
      LaserSafetyError     70   a laser that should be off may be on
      CannotCreateError    73   an output exists already, or its folder cannot be written
      InputOutputError     74   reading or writing failed: disk full, cable unplugged
    SignalReceived      128+n   SIGHUP, SIGINT, SIGTERM or a closed pipe, as an exception, so that `with` blocks run

Other exit statuses: 0 success, 1 a bug, 3 success but a shot has no pose or a threshold was missed, 141 a closed pipe.
"""

import signal
from typing import TypeVar

Problem = TypeVar("Problem", bound="RingposeError")


class RingposeError(Exception):
    """An error that is reported to the user as one line: location, finding, remedy."""

    status = 1

    def __init__(self, location: str, finding: str, remedy: str = "") -> None:
        self.location = location
        self.finding = finding
        self.remedy = remedy
        self.later: tuple[str, ...] = ()
        """What was found in later attempts at the same, which does not replace the first finding."""
        super().__init__(location, finding, remedy)

    @property
    def message(self) -> str:
        """The line without its location."""
        line = f"{self.finding}; {self.remedy}" if self.remedy else self.finding
        return " ".join(" ".join([line, *(f"(then: {each})" for each in self.later)]).split())

    def __str__(self) -> str:
        return " ".join(f"{self.location}: {self.message}".split()) if self.location else self.message

    def followed_by(self: Problem, *later: "RingposeError") -> Problem:
        """Attach the findings of later attempts, each different one once; returns this error."""
        for each in later:
            is_same = (each.location, each.finding) == (self.location, self.finding)
            if not is_same and str(each) not in self.later:
                self.later = (*self.later, str(each))
        return self


class UsageError(RingposeError):
    """The command-line arguments are invalid or contradict each other."""

    status = 2


class DataError(RingposeError):
    """The contents of a file or record are invalid."""

    status = 65


class NoInputError(RingposeError):
    """An input does not exist or cannot be opened, or standard input is empty."""

    status = 66


class DeviceError(RingposeError):
    """A camera or laser board is absent or fails."""

    status = 69


class LaserSafetyError(RingposeError):
    """A laser that should be off may be on."""

    status = 70


class CannotCreateError(RingposeError):
    """An output exists already, or its folder cannot be written."""

    status = 73


class InputOutputError(RingposeError):
    """Reading or writing failed halfway."""

    status = 74


class ImplausibleValueWarning(UserWarning):
    """A value that is possible, but probably wrong; the commands print it as a line on stderr."""


class SignalReceived(BaseException):
    """SIGHUP, SIGINT, SIGTERM or a closed pipe; not an `Exception`, so that `except Exception` does not catch it."""

    def __init__(self, number: int) -> None:
        self.status = 128 + number
        super().__init__(signal.Signals(number).name)


NO_POSE = 3
"""Exit status: success, but a shot has no pose or a threshold was missed."""

CLOSED_PIPE = 128 + signal.SIGPIPE
"""Exit status: the reader of standard output has closed the pipe."""
