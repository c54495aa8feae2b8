"""The record of a shot's points: one JSON line (`ringpose-records(5)`), of which `ShotPoints` is the definition."""

from typing import Any

from ringpose.files.records.codec import RecordType
from ringpose.files.schema import POINTS
from ringpose.types.points import ShotPoints

RECORD = RecordType(
    cls=ShotPoints,
    kind=POINTS,
    version="ringpose/points/1",
    description="The stripes of one shot as points in space. Metres, seconds, pixels. Readers ignore unknown keys.",
)


def points_record(points: ShotPoints) -> dict[str, Any]:
    """The record of a shot's points."""
    return RECORD.write(points)
