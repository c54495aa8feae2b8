"""Results as JSON or CSV text, into a file or onto stdout."""

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

from ringpose.files import records
from ringpose.files.atomic import replacing


def csv_text(rows: Iterable[Sequence[str | float | int | bool]]) -> str:
    """Rows as RFC 4180 has them, but for bare line feeds."""
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(rows)
    return stream.getvalue()


def write_result(target: str, text: str, *, force: bool) -> None:
    """The text on stdout for `-`, or as a file."""
    if target == records.STDOUT:
        records.write_text(text)
        return
    with replacing(Path(target), force) as stream:
        stream.write(text.encode())
