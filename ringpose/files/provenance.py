"""Where a file came from: version, command line, time, hashes of the inputs."""

import hashlib
import shlex
import sys
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any


def provenance(inputs: Iterable[Path]) -> dict[str, Any]:
    """The `provenance` entry of a file that is about to be written."""
    from importlib.metadata import version  # slow to import, and most commands write no such file

    return {
        "version": version("ringpose"),
        "command": shlex.join(["ringpose", *sys.argv[1:]]),
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "inputs": {str(path): sha256(path) for path in inputs},
    }


def sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
