"""Where detections go: records on stdout or NPZ files in a folder, and pictures in another."""

from pathlib import Path

from ringpose.detect.frames import most_lit_image
from ringpose.errors import DataError
from ringpose.files import atomic, records
from ringpose.files.detections import detection_record, write_detection
from ringpose.files.images import write_image
from ringpose.types.detection import Detection
from ringpose.types.frame import Shot


class DetectionSink:
    """Writes each detection as soon as it is there; of two shots with one name the second is refused."""

    def __init__(self, output: str, overlays: Path | None, *, rig: Path | None, full: bool, force: bool) -> None:
        self.folder = None if output == records.STDOUT else atomic.make_folder(Path(output))
        self.overlays = None if overlays is None else atomic.make_folder(overlays)
        self.rig = rig
        self.full = full
        self.force = force
        self.names: set[str] = set()

    def write(self, shot: Shot, detection: Detection, source: Path) -> None:
        """The picture first: a detection that is announced is complete."""
        self._check_name(shot.name)
        if self.overlays is not None:
            from ringpose.detect.overlay import overlay  # seldom asked for

            picture = overlay(most_lit_image(shot), detection)
            write_image(self.overlays / f"{shot.name}.png", picture, force=self.force)
        if self.folder is None:
            records.write(detection_record(detection, self.full))
        else:
            path = self.folder / f"{shot.name}.npz"
            inputs = [source] if self.rig is None else [source, self.rig]
            write_detection(path, detection, force=self.force, inputs=inputs)
            records.write_name(path)

    def _check_name(self, name: str) -> None:
        if name in self.names and not (self.folder is None and self.overlays is None):
            raise DataError(name, "an earlier shot has this name, its files would be replaced", "rename one of them")
        self.names.add(name)
