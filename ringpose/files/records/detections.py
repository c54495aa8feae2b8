"""Detections as JSON records or NPZ files, with the same keys in both, and their output by `ringpose detect`."""

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ringpose.errors import DataError
from ringpose.files import atomic, records
from ringpose.files.inputs import Input, Problem
from ringpose.files.io import provenance
from ringpose.files.npz import Archive, write_archive
from ringpose.files.records.codec import RecordType
from ringpose.files.schema import DETECTION, FREE_PREFIX, Fields
from ringpose.types.detection import MAX_OFFSET, BreakPoints, Detection, NoBreakPoints, outside_image
from ringpose.types.rig import Camera, Rig, reject_other_rig

RECORD = RecordType(
    cls=Detection,
    kind=DETECTION,
    version="ringpose/detection/2",
    earlier=("ringpose/detection/1",),
    description="What was detected in one shot. Pixels and seconds; lasers in the order of the rig, edges in the order "
    "inner, outer. Readers ignore unknown keys.",
    rules={
        "oneOf": [
            {"properties": {"break_points": {"type": "null"}, "reason": {"type": "string"}}},
            {"properties": {"break_points": {"type": "object"}, "reason": {"type": "null"}}},
        ]
    },
)
"""Version 1 lacks the features' stamps, `lasers_on` and `rejected`."""

PROVENANCE = "provenance"
"""Key of the provenance in an NPZ file, a JSON text."""

REJECTED = "rejected"
"""Key of the rejections: a list of mappings, in an NPZ file as a JSON text."""

OTHER_RIG = "give the rig with which they were detected"
"""Remedy for a detection that does not match the rig."""


def detection_record(detection: Detection, full: bool = True) -> dict[str, Any]:
    """The record of one shot; stripes and segments, which are long, are included only if `full` is set."""
    return RECORD.write(detection, brief=not full)


def detection_of(record: Mapping[str, Any], location: str) -> Detection:
    """The detection in a record of version 1 or 2; null numbers become NaN, and unknown keys are ignored."""
    fields = Fields(location, record)
    fields.schema((RECORD.version, *RECORD.earlier), DETECTION)
    if not fields.has("break_points"):
        _check_reason(fields)
    return RECORD.read(record, location)


def _check_reason(fields: Fields) -> None:
    if not fields.has("reason"):
        finding = "is a detection with neither break_points nor a reason"
        raise fields.problem("", finding, RECORD.context.unchanged)
    reason = fields.text("reason")
    if reason not in [each.value for each in NoBreakPoints]:
        raise fields.problem("reason", f"unknown reason {reason[:60]!r}")


def write_detection(path: Path, detection: Detection, *, force: bool = False, inputs: Iterable[Path] = ()) -> None:
    """Write a detection as NPZ with the record's keys (nested ones as `break_points.position_px`) and provenance."""
    arrays: dict[str, Any] = {PROVENANCE: np.array(records.line_of(provenance(inputs)).strip())}
    values = RECORD.values(detection)
    if values.pop(REJECTED):
        arrays[REJECTED] = np.array(json.dumps(records.plain(RECORD.write(detection)[REJECTED])))
    for name, value in values.items():
        if isinstance(value, Mapping):
            arrays |= {f"{name}.{key}": part for key, part in value.items() if part is not None}
        elif value is not None and not (isinstance(value, float) and math.isnan(value)):
            arrays[name] = value
    write_archive(path, arrays, force=force)


def detection_in(archive: Archive) -> Detection:
    """The detection in an open archive."""
    record: dict[str, Any] = {}
    for key in archive.keys:
        if key == PROVENANCE or key.startswith(FREE_PREFIX):
            continue
        value = archive.value(key).tolist()
        if key == REJECTED:
            value = _parsed_rejections(archive, value)
        part, _, name = key.partition(".")
        values = record.setdefault(part, {}) if name else record
        if not isinstance(values, dict) or (not name and key in record):
            raise archive.problem(key, "is given beside its parts", "give the output of ringpose detect")
        values[name or key] = value
    return detection_of(record, str(archive.path))


def _parsed_rejections(archive: Archive, text: object) -> Any:
    try:
        return json.loads(str(text))
    except (ValueError, RecursionError):
        raise archive.problem(REJECTED, "is not valid JSON", "give the output of ringpose detect") from None


def checked_detection(detection: Detection, rig: Rig, location: str) -> Detection:
    """The detection; rejected if it does not match the rig. `location` is used in messages."""
    reject_other_rig(detection.rig, rig.sha256, location, OTHER_RIG)
    points = detection.break_points.position_px if isinstance(detection.break_points, BreakPoints) else None
    for key, of_lasers in (("break_points", points), ("lasers_on", detection.lasers_on)):
        if of_lasers is not None and len(of_lasers) != len(rig.lasers.names):
            finding = f"has {len(of_lasers)} lasers, the rig has {len(rig.lasers.names)}"
            raise DataError(f"{location}: {key}", finding, OTHER_RIG)
    _check_positions(detection, rig.camera, location)
    return detection


def _check_positions(detection: Detection, camera: Camera, location: str) -> None:
    """Reject points farther outside the image than lens distortion can explain (`MAX_OFFSET`)."""
    width, height = camera.image_width, camera.image_height
    for part, points, names in (
        ("break_points", detection.measured, tuple(MAX_OFFSET)),
        ("repeated", detection.repeated, tuple(MAX_OFFSET)),
        ("opposite", detection.opposite, tuple(MAX_OFFSET)),
        ("ring_edges", detection.ring_edges, ("position_px",)),
    ):
        for name in () if points is None else names:
            if outside_image(getattr(points, name), MAX_OFFSET[name], width, height).any():
                where = f"lies beyond the image of {width} x {height} pixels that the rig's camera has"
                key = name.replace("_undistorted", "")  # as in records
                raise DataError(f"{location}: {part}.{key}", where, OTHER_RIG)


class DetectionSink:
    """Writes detections: records to stdout, or NPZ files to a folder.

    The second of two shots with the same name is rejected if it would replace the file of the first. `rig_sha256` is
    that of the file `rig`, empty without one.
    """

    def __init__(self, output: str, *, rig: Path | None, rig_sha256: str, full: bool, force: bool) -> None:
        self.folder = None if output == records.STDOUT else atomic.make_folder(Path(output))
        self.rig = rig
        self.rig_sha256 = rig_sha256
        self.full = full
        self.force = force
        self.names: set[str] = set()

    def has(self, item: Input | Problem) -> bool:
        """Whether the detection of an input is in the folder already; its name is printed then.

        One of another rig, or of a search without a rig, is a `DataError`: the folder would mix both.
        """
        if self.folder is None or not isinstance(item, Path) or item.stem in self.names:
            return False
        path = self.folder / f"{item.stem}.npz"
        if path.exists():
            of_file = detection_in(Archive(path)).rig
            if of_file != self.rig_sha256:
                found, given = (f"{sha256:.12}" or "none" for sha256 in (of_file, self.rig_sha256))
                remedy = "resume with the rig of the interrupted run, or use another --output"
                raise DataError(str(path), f"was detected with another rig file ({found}, not {given})", remedy)
            self.names.add(item.stem)
            records.write_name(path)
        return item.stem in self.names

    def write(self, detection: Detection, source: Path) -> None:
        """Write one detection; the name of its file is printed when the file is complete."""
        self._check_name(detection.shot)
        if self.folder is None:
            records.write(detection_record(detection, self.full))
        else:
            path = self.folder / f"{detection.shot}.npz"
            inputs = [source] if self.rig is None else [source, self.rig]
            write_detection(path, detection, force=self.force, inputs=inputs)
            records.write_name(path)

    def _check_name(self, name: str) -> None:
        if name in self.names and self.folder is not None:
            raise DataError(name, "an earlier shot has this name; its file would be replaced", "rename one of them")
        self.names.add(name)
