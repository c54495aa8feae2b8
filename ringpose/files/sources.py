"""Inputs of pose estimation: detections, shots or images, distinguished by their contents."""

from ringpose.errors import DataError
from ringpose.files.images.shots import SHOT_SUFFIXES, read_shot, shot_of
from ringpose.files.inputs import RECORDS_SUFFIX, Input, Record
from ringpose.files.npz import Archive
from ringpose.files.records.detections import detection_in, detection_of, is_detection
from ringpose.files.rigs import reject_other_rig
from ringpose.types.detection import MAX_OFFSET, BreakPoints, Detection, outside_image
from ringpose.types.image import Shot
from ringpose.types.rig import Camera, Rig

SUFFIXES = (RECORDS_SUFFIX, *SHOT_SUFFIXES)

_OTHER_RIG = "give the rig with which they were detected"


def read_source(item: Input, rig: Rig, channel: str | None) -> Shot | Detection:
    """The detection or shot in an input; rejected if it does not fit the rig."""
    if isinstance(item, Record):
        return _checked_detection(detection_of(item.values, item.location), rig, item.location)
    if item.suffix.lower() != ".npz":
        return read_shot(item, channel, rig)
    archive = Archive(item)
    if is_detection(archive):
        return _checked_detection(detection_in(archive), rig, str(item))
    return shot_of(archive, rig)


def _checked_detection(detection: Detection, rig: Rig, location: str) -> Detection:
    reject_other_rig(detection.rig, rig.sha256, location, _OTHER_RIG)
    points = detection.break_points.position_px if isinstance(detection.break_points, BreakPoints) else None
    for key, of_lasers in (("break_points", points), ("lasers_on", detection.lasers_on)):
        if of_lasers is not None and len(of_lasers) != len(rig.lasers.names):
            found = f"has {len(of_lasers)} lasers, the rig has {len(rig.lasers.names)}"
            raise DataError(f"{location}: {key}", found, _OTHER_RIG)
    _check_positions(detection, rig.camera, location)
    return detection


def _check_positions(detection: Detection, camera: Camera, location: str) -> None:
    """Reject points farther outside the image than lens distortion can explain (`MAX_OFFSET`)."""
    width, height = camera.image_width, camera.image_height
    for part, found in (("break_points", detection.break_points), ("ring_edges", detection.ring_edges)):
        for key, max_offset in MAX_OFFSET.items():
            position_px = getattr(found, key, None)
            if position_px is not None and outside_image(position_px, max_offset, width, height).any():
                where = f"lies beyond the image of {width} x {height} pixels that the rig's camera has"
                raise DataError(f"{location}: {part}.{key}", where, _OTHER_RIG)
