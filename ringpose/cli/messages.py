"""Messages to the user on stderr, one line each."""

import sys
from dataclasses import dataclass
from datetime import UTC, datetime

from ringpose.errors import RingposeError


@dataclass(slots=True)
class Heading:
    """What each message begins with."""

    program: str = "ringpose"
    """The program, and its command as far as it is known."""
    has_time: bool = False

    def text(self) -> str:
        """`ringpose pose`, after the time in UTC if it has one."""
        time = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        return f"{time} {self.program}" if self.has_time else self.program


HEADING = Heading()
"""That of this process, which runs one command."""


def error(problem: RingposeError) -> None:
    """Print `ringpose pose: location: finding; remedy` on stderr."""
    echo(str(problem))


def echo(line: str) -> None:
    """Print one line on stderr, after the heading; ignored if stderr is closed."""
    if sys.stderr is None:
        return
    try:
        sys.stderr.write(f"{HEADING.text()}: {line}\n")
        sys.stderr.flush()
    except OSError:
        pass
