"""Work for the executors of studies, in a module that worker processes can import."""

import os
import signal

from ringpose.errors import DataError

FATAL = 5


def square(index):
    return [{"shot": index, "square": index * index}]


def square_or_die(index):
    """Shot `FATAL` kills its process, every time."""
    if index == FATAL:
        os.kill(os.getpid(), signal.SIGKILL)
    return square(index)


def reversed_name(path):
    """The name of an input backwards; `bad` is an error, and `fatal` kills the process."""
    if path.name == "bad":
        raise DataError(path.name, "is bad")
    if path.name == "fatal":
        os.kill(os.getpid(), signal.SIGKILL)
    return path.name[::-1]
