"""The shot or detection in an input of a stream, by the contents of the file or record."""

from dataclasses import dataclass

from ringpose.files.images.shots import read_shot, shot_of
from ringpose.files.inputs import Input, Record
from ringpose.files.npz import Archive
from ringpose.files.records.detections import checked_detection, detection_in, detection_of
from ringpose.types.detection import Detection
from ringpose.types.image import Shot
from ringpose.types.rig import Rig


@dataclass(frozen=True, slots=True, eq=False)
class SourceReader:
    """Reads an input, and rejects one that does not match the rig; worker processes import this class."""

    rig: Rig
    channel: str | None = None
    """Channel of colour images that is read; None for their luminance."""

    def __call__(self, item: Input) -> Shot | Detection:
        """The shot or detection in an input."""
        if isinstance(item, Record):
            return checked_detection(detection_of(item.values, item.location), self.rig, item.location)
        if item.suffix.lower() != ".npz":
            return read_shot(item, self.channel, self.rig)
        archive = Archive(item)
        if "schema" in archive:  # a shot has none
            return checked_detection(detection_in(archive), self.rig, str(item))
        return shot_of(archive, self.rig)
