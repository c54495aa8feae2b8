"""captures.jsonl: runs in which a gripper was guided to the ring, one record each, defined by `CaptureLine`."""

from collections.abc import Iterator
from math import isfinite
from pathlib import Path

from ringpose.errors import DataError
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
    """Yield the runs in a file in order; `DataError` for one that contradicts itself."""
    for location, record in records.read(file_lines(path), str(path)):
        line = RECORD.read(record, location)
        stated = isfinite(line.closed_s), line.gripper is not None, line.ring is not None
        if any(stated) and not all(stated):
            raise DataError(
                location,
                "states only a part of closed_s, gripper and ring",
                "give all three of a gripper that closed, null for all three otherwise",
            )
        if line.ring is not None and not line.ring.radius_inner_m < line.ring.radius_outer_m:
            raise DataError(location, "has a ring whose inner radius is not below the outer one", "exchange them")
        yield line
