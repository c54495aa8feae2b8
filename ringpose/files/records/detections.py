"""Detections as JSON records or NPZ files, with the same keys in both, and their output by `ringpose detect`."""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ringpose.errors import DataError
from ringpose.files import atomic, records
from ringpose.files.io import provenance
from ringpose.files.kinds import DETECTION
from ringpose.files.npz import Archive, write_archive
from ringpose.files.records.rejections import rejections_in
from ringpose.files.schema import FREE_PREFIX, ROUNDED, Fields
from ringpose.types.arrays import EDGES, Array, Bool, Float64, Int64
from ringpose.types.detection import (
    MAX_OFFSET,
    MAX_SIGMA_PX,
    BreakPoints,
    Detection,
    JudgedRing,
    NoBreakPoints,
    RingEdgePoints,
    Segments,
    Stripes,
    outside_image,
)
from ringpose.types.rig import Camera, Rig, reject_other_rig

SCHEMA = "ringpose/detection/2"

SCHEMA_1 = "ringpose/detection/1"
"""The previous version, which is read but not written; it lacks the features' stamps, `lasers_on` and `rejected`."""

PROVENANCE = "provenance"
"""Key of the provenance in an NPZ file, a JSON text."""

REJECTED = "rejected"
"""Key of the rejections: a list of mappings, in an NPZ file as a JSON text."""

_BREAK_POINTS = tuple(name for name in BreakPoints.__slots__ if name != "repeated")

_PARTS = {
    "break_points": _BREAK_POINTS,
    "repeated": _BREAK_POINTS,
    "ring_edges": RingEdgePoints.__slots__,
    "ring": JudgedRing.__slots__,
    "stripes": Stripes.__slots__,
    "segments": Segments.__slots__,
}
"""Keys of each part, which are the attributes of its type."""

MAX_INTEGER = 2**31

OTHER_RIG = "give the rig with which they were detected"
"""Remedy for a detection that does not match the rig."""


def detection_record(detection: Detection, full: bool = True) -> dict[str, Any]:
    """The record of one shot; stripes and segments, which are long, are included only if `full` is set."""
    found = detection.break_points if isinstance(detection.break_points, BreakPoints) else None
    record: dict[str, Any] = {
        "schema": SCHEMA,
        "shot": detection.shot,
        "stamp_s": detection.stamp_s,
        "reason": detection.break_points.value if isinstance(detection.break_points, NoBreakPoints) else None,
        "lasers_on": detection.lasers_on,
        "still": detection.still,
        "ambient_changed": detection.ambient_changed,
        "advice": detection.advice,
        "break_points": _part("break_points", found),
        "repeated": _part("repeated", None if found is None else found.repeated),
        "ring_edges": _part("ring_edges", detection.ring_edges),
        "ring": _part("ring", detection.ring),
        REJECTED: detection.rejected,
        "rig": detection.rig or None,
    }
    if full:
        record |= {"stripes": _part("stripes", detection.stripes), "segments": _part("segments", detection.segments)}
    return record


def _part(name: str, part: object) -> dict[str, Any] | None:
    return None if part is None else {key: getattr(part, key) for key in _PARTS[name]}


def detection_of(record: Mapping[str, Any], location: str) -> Detection:
    """The detection in a record of version 1 or 2; null numbers become NaN, and unknown keys are ignored."""
    fields = Fields(location, record)
    fields.schema((SCHEMA, SCHEMA_1), DETECTION)
    parts = {key: fields.fields(key) for key in _PARTS if fields.has(key)}
    points = _break_points(parts["break_points"]) if "break_points" in parts else _reason(fields)
    if isinstance(points, BreakPoints) and "repeated" in parts:
        points = replace(points, repeated=_break_points(parts["repeated"], len(points.position_px)))
    return Detection(
        shot=fields.text("shot"),
        stamp_s=fields.number("stamp_s", missing=math.nan),
        break_points=points,
        stripes=_stripes(parts["stripes"]) if "stripes" in parts else None,
        segments=_segments(parts["segments"]) if "segments" in parts else None,
        ring_edges=_ring_edges(parts["ring_edges"]) if "ring_edges" in parts else None,
        ring=_judged_ring(parts["ring"]) if "ring" in parts else None,
        lasers_on=_lasers_on(fields, points) if fields.has("lasers_on") else None,
        still=fields.boolean("still") if fields.has("still") else False,
        ambient_changed=fields.boolean("ambient_changed") if fields.has("ambient_changed") else False,
        advice=str(fields.raw("advice")) if fields.has("advice") else "",
        rejected=rejections_in(fields),
        rig=fields.optional("rig", fields.text) or "",
    )


def _lasers_on(fields: Fields, points: BreakPoints | NoBreakPoints) -> Bool[Array, "laser"]:
    lasers = fields.raw("lasers_on")
    if not isinstance(lasers, list) or not all(isinstance(each, bool) for each in lasers):
        raise fields.problem("lasers_on", "must be a list of true or false")
    if isinstance(points, BreakPoints) and len(lasers) != len(points.position_px):
        raise fields.problem("lasers_on", f"has {len(lasers)} lasers, break_points has {len(points.position_px)}")
    return np.array(lasers, dtype=bool)


def write_detection(path: Path, detection: Detection, *, force: bool = False, inputs: Iterable[Path] = ()) -> None:
    """Write a detection as NPZ with the record's keys (nested ones as `break_points.position_px`) and provenance."""
    record = detection_record(detection)
    arrays: dict[str, Any] = {PROVENANCE: np.array(records.line_of(provenance(inputs)).strip())}
    if rejected := record.pop(REJECTED):
        arrays[REJECTED] = np.array(json.dumps(records.plain(rejected)))
    for key, value in record.items():
        if isinstance(value, Mapping):
            arrays |= {f"{key}.{name}": part for name, part in value.items() if part is not None}
        elif value is not None and not (key == "stamp_s" and math.isnan(value)):
            arrays[key] = value
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
        if name and part in _PARTS:
            record.setdefault(part, {})[name] = value
        else:
            record[key] = value
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
            found = f"has {len(of_lasers)} lasers, the rig has {len(rig.lasers.names)}"
            raise DataError(f"{location}: {key}", found, OTHER_RIG)
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
                raise DataError(f"{location}: {part}.{key}", where, OTHER_RIG)


def _reason(fields: Fields) -> NoBreakPoints:
    if not fields.has("reason"):
        raise fields.problem(
            "", "is a detection with neither break_points nor a reason", f"{DETECTION.remedy} unchanged"
        )
    reason = fields.text("reason")
    try:
        return NoBreakPoints(reason)
    except ValueError:
        raise fields.problem("reason", f"unknown reason {reason[:60]!r}") from None


def _break_points(fields: Fields, count: int | None = None) -> BreakPoints:
    position = _points(fields, "position_px", (count, 2, 2))
    lasers = len(position)
    return BreakPoints(
        position_px=position,
        covariance_px2=_covariances(fields, "covariance_px2", (lasers, 2, 2, 2)),
        flags=_integers(fields, "flags", (lasers, 2), least=0),
        face_start_px=_points(fields, "face_start_px", (lasers, 2)),
        face_end_px=_points(fields, "face_end_px", (lasers, 2)),
        face_sigma_px=_sigmas(fields, "face_sigma_px", (lasers, 2), allow_nan=True),
        labelled=fields.boolean("labelled"),
        stamp_s=_stamps(fields, lasers, allow_nan=True),
    )


def _ring_edges(fields: Fields) -> RingEdgePoints:
    position = fields.array("position_px", (None, 2))
    edge = _integers(fields, "edge", (len(position),))
    if len(edge) and not 0 <= edge.min() <= edge.max() < len(EDGES):
        raise fields.problem("edge", "has a value other than 0 (inner) and 1 (outer)")
    normal = fields.array("normal", (len(position), 2))
    if not normal.any(axis=1).all():
        raise fields.problem("normal", "has a vector of length 0, must be 1")
    return RingEdgePoints(
        position_px=position,
        normal=normal,
        sigma_px=_sigmas(fields, "sigma_px", (len(position),)),
        edge=edge,
        stamp_s=_stamps(fields, len(position)),
    )


def _judged_ring(fields: Fields) -> JudgedRing:
    axes = fields.array("axes", (3, 3))
    if np.abs(axes @ axes.T - np.eye(3)).max() > ROUNDED:
        raise fields.problem("axes", "must be three perpendicular unit vectors")
    return JudgedRing(
        origin_m=fields.vector("origin_m", 3),
        axes=axes,
        curvature_per_m=fields.number("curvature_per_m"),
        half_band_m=fields.number("half_band_m"),
        velocity_m_s=fields.vector("velocity_m_s", 3),
        rate_rad_s=fields.vector("rate_rad_s", 3),
        stamp_s=fields.number("stamp_s") if fields.has("stamp_s") else None,
    )


def _stripes(fields: Fields) -> Stripes:
    position = fields.array("position_px", (None, 2))
    laser = _integers(fields, "laser", (None,))
    piece = _integers(fields, "piece", (len(position),))
    if len(piece) and not 0 <= piece.min() <= piece.max() < len(laser):
        raise fields.problem("piece", f"has an index out of range: there are {len(laser)} pieces")
    return Stripes(
        position_px=position,
        sigma_px=fields.array("sigma_px", (len(position),), allow_nan=True),
        peak_dn=fields.array("peak_dn", (len(position),), allow_nan=True),
        piece=piece,
        laser=laser,
        stamp_s=_stamps(fields, len(laser)),
    )


def _segments(fields: Fields) -> Segments:
    start = fields.array("start_px", (None, 2))
    return Segments(
        start_px=start,
        end_px=fields.array("end_px", (len(start), 2)),
        support=_integers(fields, "support", (len(start),), least=0),
        stamp_s=_stamps(fields, len(start)),
    )


def _stamps(fields: Fields, count: int, allow_nan: bool = False) -> Float64[Array, "feature"] | None:
    """Time stamps of the features of one part; None if they are unknown, as in version 1."""
    return fields.array("stamp_s", (count,), allow_nan=allow_nan) if fields.has("stamp_s") else None


def _points(fields: Fields, key: str, shape: tuple[int | None, ...]) -> Float64[Array, "... xy=2"]:
    """Points in pixels; a missing point must be null in both coordinates."""
    points = fields.array(key, shape, allow_nan=True)
    missing = np.isnan(points)
    if np.any(missing.any(axis=-1) != missing.all(axis=-1)):
        raise fields.problem(key, "has a point of which one coordinate is null")
    return points


def _integers(
    fields: Fields, key: str, shape: tuple[int | None, ...], least: int = -MAX_INTEGER
) -> Int64[Array, "..."]:
    numbers = fields.array(key, shape)
    if np.any(numbers != np.round(numbers)) or np.abs(numbers).max(initial=0.0) > MAX_INTEGER:
        raise fields.problem(key, "has a number that is not whole")
    if numbers.min(initial=least) < least:
        raise fields.problem(key, f"has a number below {least}")
    return numbers.astype(np.int64)


def _sigmas(fields: Fields, key: str, shape: tuple[int | None, ...], allow_nan: bool = False) -> Float64[Array, "..."]:
    sigmas = fields.array(key, shape, allow_nan=allow_nan)
    _check_sigmas(fields, key, sigmas)
    return sigmas


def _covariances(fields: Fields, key: str, shape: tuple[int | None, ...]) -> Float64[Array, "... 2 2"]:
    """Symmetric, positive semidefinite 2 x 2 matrices, up to rounding."""
    matrices = fields.array(key, shape, allow_nan=True)
    (first, mixed), (other, second) = np.moveaxis(matrices, (-2, -1), (0, 1))
    size = np.abs(first) + np.abs(second)
    uneven = np.abs(mixed - other) > ROUNDED * size
    if np.any(uneven | (np.minimum(first, second) < 0) | (mixed**2 > first * second + (ROUNDED * size) ** 2)):
        raise fields.problem(key, "has a matrix that is not a covariance")
    _check_sigmas(fields, key, np.sqrt(np.maximum(np.stack([first, second]), 0.0)))
    return matrices


def _check_sigmas(fields: Fields, key: str, sigmas: Float64[Array, "..."]) -> None:
    if np.any(sigmas < 0):
        raise fields.problem(key, "has a standard deviation below 0")
    if np.any(sigmas > MAX_SIGMA_PX):
        raise fields.problem(key, f"has a standard deviation over {MAX_SIGMA_PX:g} px", "write null if it is unknown")


class DetectionSink:
    """Writes detections: records to stdout, or NPZ files to a folder.

    The second of two shots with the same name is rejected if it would replace the file of the first.
    """

    def __init__(self, output: str, *, rig: Path | None, full: bool, force: bool) -> None:
        self.folder = None if output == records.STDOUT else atomic.make_folder(Path(output))
        self.rig = rig
        self.full = full
        self.force = force
        self.names: set[str] = set()

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
