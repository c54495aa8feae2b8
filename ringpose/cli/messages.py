"""What the user reads on stderr: one line a message."""

import sys

from ringpose.errors import RingposeError


def error(problem: RingposeError) -> None:
    """`ringpose: place: finding; remedy` on stderr."""
    say(str(problem))


def say(line: str) -> None:
    """One line on stderr, with the program's name before it; lost if nobody can read it."""
    if sys.stderr is None:
        return
    try:
        sys.stderr.write(f"ringpose: {line}\n")
        sys.stderr.flush()
    except OSError:
        pass
