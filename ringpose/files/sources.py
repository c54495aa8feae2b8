"""What a pose can be computed from: detections, shots, images, told apart by what they say."""

from pathlib import Path

from ringpose.errors import DataError
from ringpose.files.detections import detection_in, detection_of, is_detection
from ringpose.files.inputs import RECORDS_SUFFIX, Input, Record
from ringpose.files.npz import Archive
from ringpose.files.shots import SHOT_SUFFIXES, read_shot, shot_of
from ringpose.types.camera import Camera
from ringpose.types.detection import MAX_OFFSET, BreakPoints, Detection, outside_image
from ringpose.types.image import Shot
from ringpose.types.rig import Rig

SUFFIXES = (RECORDS_SUFFIX, *SHOT_SUFFIXES)


def read_source(item: Input, rig: Rig, channel: str | None) -> Shot | Detection:
    """The detection or the shot that an input is, if it fits the rig."""
    if isinstance(item, Record):
        return _fitting(detection_of(item.values, item.place), rig, item.place)
    if item.suffix.lower() != ".npz":
        return read_shot(item, channel, rig)
    archive = Archive(item)
    if is_detection(archive):
        return _fitting(detection_in(archive), rig, str(item))
    return shot_of(archive, rig)


def file_named(item: Input) -> Path:
    """The file that an input is; a record is none."""
    if isinstance(item, Path):
        return item
    raise DataError(item.place, "is a record", "the name of a shot or image is wanted")


def _fitting(detection: Detection, rig: Rig, place: str) -> Detection:
    lasers = len(rig.lasers.names)
    if isinstance(detection.break_points, BreakPoints) and len(detection.break_points.position_px) != lasers:
        found = f"has {len(detection.break_points.position_px)} lasers, the rig has {lasers}"
        raise DataError(f"{place}: break_points", found, "give the rig with which they were detected")
    _check_places(detection, rig.camera, place)
    return detection


def _check_places(detection: Detection, camera: Camera, place: str) -> None:
    """Refuse what lies farther beside the image than a lens bends."""
    width, height = camera.image_width, camera.image_height
    for part, found in (("break_points", detection.break_points), ("ring_edges", detection.ring_edges)):
        for key, max_offset in MAX_OFFSET.items():
            position_px = getattr(found, key, None)
            if position_px is not None and outside_image(position_px, max_offset, width, height).any():
                where = f"lies beyond the image of {width} x {height} pixels that the rig's camera has"
                raise DataError(f"{place}: {part}.{key}", where, "give the rig with which they were detected")
