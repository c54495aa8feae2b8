"""What a file or a record is, recognised by its contents: for messages about one that is given in place of another."""

import json
import re
from collections.abc import Collection, Mapping
from contextlib import suppress
from typing import Any, NamedTuple


class Kind(NamedTuple):
    """A kind of file or record that ringpose reads or writes."""

    name: str
    schema: str
    """Beginning of its key `ringpose` (in YAML) or `schema` (in a record)."""
    keys: frozenset[str]
    """Keys that only this kind has all at its top level."""
    remedy: str
    """What to give where one is needed."""

    def instead_of(self, other: "Kind") -> tuple[str, str]:
        """Finding and remedy if another kind is given."""
        return f"is {other.name}, not {self.name}", self.remedy


CAMERA = Kind(
    "a camera", "camera/", frozenset({"camera_matrix"}), "give a camera.yaml, which ringpose calibrate-camera writes"
)
RIG = Kind("a rig", "rig/", frozenset({"camera", "lasers"}), "give a rig.yaml, which ringpose calibrate-planes writes")
SCENE = Kind("a scene", "scene/", frozenset({"rig", "trajectory"}), "give a scene.yaml (ringpose-simulate(1))")
STUDY = Kind("a study", "study/", frozenset({"vary"}), "give a study.yaml (ringpose-study(5))")
BOARD = Kind("a board", "board/", frozenset({"kind"}), "give a board file (ringpose-conventions(7))")
RINGS = Kind("a catalogue of rings", "rings/", frozenset({"rings"}), "give a catalogue (ringpose-pose(1))")
SESSION = Kind("a session", "session/", frozenset({"captures"}), "give the folder that ringpose capture wrote")
TRUTH = Kind("a truth", "ringpose/truth/", frozenset({"expect"}), "give truth.jsonl (ringpose-conventions(7))")
ROBOT_POSE = Kind(
    "a robot pose", "ringpose/robot", frozenset({"base_from_tool"}), "give the robot's poses (ringpose-conventions(7))"
)
DETECTION = Kind(
    "a detection", "ringpose/detection/", frozenset({"break_points"}), "give the output of ringpose detect"
)
TRACK_LINE = Kind("a track line", "ringpose/track/", frozenset({"validity"}), "give the output of ringpose track")
POSE_LINE = Kind("a pose line", "ringpose/pose/", frozenset({"pose", "flags"}), "give the output of ringpose pose")

_FILES = (CAMERA, RIG, SCENE, STUDY, BOARD, RINGS, SESSION)
_RECORDS = (TRUTH, ROBOT_POSE, DETECTION, TRACK_LINE, POSE_LINE)
_KINDS = (*_FILES, *_RECORDS)

EXCHANGED = "see whether two files of the command are exchanged"
"""Remedy for a file of another kind."""

_SIGNATURES = {
    b"PK\x03": "an NPZ archive, as shots and detections are",
    b"\x89PNG": "an image",
    b"\xff\xd8\xff": "an image",
    b"II*\0": "an image",
    b"MM\0*": "an image",
    b"P5\n": "an image",
    b"%PDF": "a PDF file",
    b"\x1f\x8b": "a compressed file",
}
"""Kinds of binary files by their first bytes."""

_HEAD_BYTES = 1 << 16
"""Bytes of a text in which its keys are looked for."""


def kind_of(values: Mapping[Any, Any]) -> Kind | None:
    """The kind of a mapping, by its schema, else by its keys."""
    schema = str(values.get("ringpose") or values.get("schema") or "")
    by_schema = (kind for kind in _KINDS if schema.startswith(kind.schema))
    return next(by_schema, next((kind for kind in _KINDS if kind.keys <= values.keys()), None))


def in_place_of_another(values: Mapping[Any, Any], known: Collection[str]) -> tuple[str, str] | None:
    """Finding and remedy for a mapping of another kind than the one that has the `known` keys; None if it is not."""
    by_keys = (kind for kind in _KINDS if kind.keys <= values.keys())
    given = (kind for kind in (kind_of(values), *by_keys) if kind is not None)
    other = next((kind for kind in given if not kind.keys <= set(known)), None)
    if other is None:
        return None
    wanted = next((kind for kind in _KINDS if kind.keys <= set(known)), None)
    return (f"is {other.name}", "give another file") if wanted is None else wanted.instead_of(other)


def kind_of_data(content: bytes) -> str:
    """What a file is that is not YAML: an archive, an image, records; empty if it is none of these."""
    for signature, name in _SIGNATURES.items():
        if content.startswith(signature):
            return name
    with suppress(ValueError, RecursionError):
        record = json.loads(content.lstrip()[:_HEAD_BYTES].partition(b"\n")[0])
        kind = kind_of(record) if isinstance(record, dict) else None
        return f"a file of records ({kind.name} each)" if kind in _RECORDS and kind is not None else ""
    return ""


def kind_of_text(content: bytes) -> str:
    """What a YAML file is, by its keys; empty if it is of no kind that ringpose reads."""
    keys = re.findall(rb"^([A-Za-z_]\w*):[ \t]*(\S*)", content[:_HEAD_BYTES], re.MULTILINE)
    kind = kind_of({key.decode(): value.decode(errors="replace") for key, value in keys})
    return "" if kind is None else kind.name
