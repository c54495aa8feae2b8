"""Messages to the user on stderr, one line each."""

import sys

from ringpose.errors import RingposeError


def error(problem: RingposeError) -> None:
    """Print `ringpose: location: finding; remedy` on stderr."""
    echo(str(problem))


def echo(line: str) -> None:
    """Print one line on stderr, prefixed with the program's name; ignored if stderr is closed."""
    if sys.stderr is None:
        return
    try:
        sys.stderr.write(f"ringpose: {line}\n")
        sys.stderr.flush()
    except OSError:
        pass
