"""captures.jsonl: runs in which a gripper was guided to the ring, one record each, defined by `CaptureLine`."""

from collections.abc import Iterator
from pathlib import Path

from ringpose.files import records
from ringpose.files.inputs import file_lines
from ringpose.files.records.codec import RecordType
from ringpose.files.schema import CAPTURE_LINE
from ringpose.types.capture import CaptureLine

RECORD = RecordType(
    cls=CaptureLine,
    kind=CAPTURE_LINE,
    version="ringpose/capture/1",
    description="One run in which a gripper was guided to the ring, one line of captures.jsonl. Gripper and true ring "
    "are in one frame, which may be any. Metres, radians, seconds. Readers ignore unknown keys.",
)


def read_captures(path: Path) -> Iterator[CaptureLine]:
    """Yield the runs in a file in order."""
    for location, record in records.read(file_lines(path), str(path)):
        yield RECORD.read(record, location)
