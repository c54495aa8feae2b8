"""Work for the executors of studies, in a module that worker processes can import."""

import os
import signal
from functools import partial
from pathlib import Path

from ringpose.errors import DataError

FATAL = 5


def square(index):
    return [{"shot": index, "square": index * index}]


def square_or_die(index):
    """Shot `FATAL` kills its process, every time."""
    if index == FATAL:
        os.kill(os.getpid(), signal.SIGKILL)
    return square(index)


def _die_once(folder, index):
    mark = Path(folder) / str(index)
    if index % 4 == 1 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return square(index)


def dying_once(folder):
    """Every fourth shot kills its process the first time that it is computed, as a kill from outside."""
    return partial(_die_once, str(folder))


def reversed_name(path):
    """The name of an input backwards; `bad` is an error, and `fatal` kills the process."""
    if path.name == "bad":
        raise DataError(path.name, "is bad")
    if path.name == "fatal":
        os.kill(os.getpid(), signal.SIGKILL)
    return path.name[::-1]
