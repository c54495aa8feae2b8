"""The tables of the manual that are made from the code: flags of a line, and the keys of records.

    python tests/manual_tables.py    write them into man/

A table stands between two comment lines of the page that have its name.
"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ringpose.bench.report import Report
from ringpose.capture.device_discovery import FoundCamera, SerialPort
from ringpose.capture.self_test import DeviceCheck
from ringpose.files.cameras.ros import CameraFile, CameraInfo
from ringpose.files.records.codec import Attribute, Choice, Definition, Numbers, definition_of
from ringpose.files.rigs import RigFile
from ringpose.files.scenes.motions import MotionEntry
from ringpose.files.scenes.rings import FormEntry, RingEntry
from ringpose.files.scenes.scene import SceneFile
from ringpose.files.scenes.targets import TargetEntry
from ringpose.files.scenes.views import BoardSetEntry, ViewEntry
from ringpose.files.schemas import RECORDS
from ringpose.files.studies.specification import StudyFile
from ringpose.measure.status import RULES, FlagRule
from ringpose.types.board import Board
from ringpose.types.capture import CaptureLine
from ringpose.types.detection import BreakPoints, Detection
from ringpose.types.points import ShotPoints
from ringpose.types.pose import HARMLESS_FLAGS, PoseLine, Priors, RingMeasurement, RingPose
from ringpose.types.rig import RobotPose
from ringpose.types.scene import Approach
from ringpose.types.session import Session
from ringpose.types.study import Drawn, Factors, Limits
from ringpose.types.target import Foil, Gap, Material
from ringpose.types.track import TrackLine
from ringpose.types.truth import Truth

MAN = Path(__file__).parents[1] / "man"

USABLE = {"grasp": "grasp point", "normal": "normal", "center": "centre", "radius": "radii", "velocity": "velocity"}
"""Columns of the table of quantities that may be used with a flag."""


def flags() -> Iterator[str]:
    """What each flag means, and what to do about it."""
    yield ".Bl -tag -width assignment_ambiguous"
    for rule in RULES:
        yield f".It Cm {rule.name}"
        yield from mdoc(rule.meaning)
        yield from mdoc(rule.remedy)
        if rule.flag in HARMLESS_FLAGS:
            yield from mdoc("A line with it may have the status `ok`.")
    yield ".El"


def usable() -> Iterator[str]:
    """Which quantities may be used with each flag."""
    widths = " ".join(f'"{name}"' for name in ("assignment_ambiguous", *(f"{name:6}" for name in USABLE.values())))
    yield f".Bl -column {widths}"
    yield ".It Em flag Ta " + " Ta ".join(f"Em {name}" for name in USABLE.values())
    for rule in RULES:
        yield f".It Cm {rule.name} Ta " + " Ta ".join(_usable(rule, quantity) for quantity in USABLE)
    yield ".El"
    for rule in RULES:
        if rule.unless:
            yield ".Pp"
            yield "(*) unless " + rule.unless + "."


def _usable(rule: FlagRule, quantity: str) -> str:
    if quantity not in rule.forbids:
        return "yes"
    return "no (*)" if rule.unless else "no"


PARTS = (PoseLine, RingPose, RingMeasurement, Priors, TrackLine, Detection, BreakPoints, ShotPoints)
"""Classes whose keys have a table of their own in records(5)."""

OF_SCENE = (
    SceneFile, RingEntry, Gap, FormEntry, Material, Foil, TargetEntry, MotionEntry, ViewEntry, Approach, BoardSetEntry
)  # fmt: skip
"""Classes whose keys have a table of their own in simulate(1)."""

OF_STUDY = (StudyFile, Factors, Drawn, Limits, CaptureLine)
"""Classes whose keys have a table of their own in study(5)."""


def keys(cls: type, record: type | None = None) -> Iterator[str]:
    """The keys of a record, or of a part of one; those of a part without a table of its own stand below its key.

    `record` has the names that are keys on this page; those of all records without it.
    """
    names = KEYS if record is None else set(_names(record))
    yield from _list_of(
        cls, definition_of(cls).attributes, names, {cls, *PARTS, *OF_SCENE, *OF_STUDY, CameraInfo, Board}
    )


def _list_of(cls: type, attributes: Sequence[Attribute], names: Collection[str], listed: set[type]) -> Iterator[str]:
    """A list of keys; parts that are `listed` elsewhere are left out."""
    if not any(each.key.description for each in attributes):
        yield f".Va {' , '.join(each.name for each in attributes)} ."
        return
    yield f".Bl -tag -width {max((each.name for each in attributes), key=len)}"
    for record in RECORDS.values():
        if record.cls is cls and record.version:
            yield from (f".It Va {record.head}", f".Li {record.version}")
    for each in attributes:
        value = each.slot.value
        yield f".It Va {each.name}{_axes(value.axes) if isinstance(value, Numbers) else ''}"
        yield from mdoc(each.key.description, names)
        if isinstance(value, Choice) and not all(f"`{word}`" in each.key.description for word in value.words):
            yield f".Cm {' , '.join(map(str, value.words))} ."
        parts = [part for part in value.parts if part.cls not in listed]
        listed = listed | {part.cls for part in parts}
        if each.key.tag and value.parts == tuple(parts):
            yield from _tagged(each.key.tag, parts, names, listed)
        else:
            for part in parts:
                yield from _list_of(part.cls, part.attributes, names, listed)
    yield ".El"


def _tagged(tag: str, parts: Sequence[Definition[Any]], names: Collection[str], listed: set[type]) -> Iterator[str]:
    """What parts of several kinds have in common, and the keys of each kind by the word of its tag."""
    first = parts[0].attributes
    common = [each for each in first if all(each.name in part.names and each.name != tag for part in parts)]
    if not common:
        for part in parts:
            yield from _list_of(part.cls, part.attributes, names, listed)
        return
    yield from _list_of(parts[0].cls, common, names, listed)
    yield f"Its {tag} has further keys:"
    yield ".Bl -tag -width revolution"
    shared = [each.name for each in common]
    for part in parts:
        yield f".It Cm {part.kind(tag).words[0]}"
        yield from _list_of(
            part.cls, [each for each in part.attributes if each.name not in (tag, *shared)], names, listed
        )
    yield ".El"


def _axes(axes: Sequence[str]) -> str:
    """The shape of an array: `[point][x, y]`, or `7 x 7`."""
    names = [axis.partition("=")[0] for axis in axes]
    if names[0] in ("row", "parameter"):
        return ""
    if all(name.isdigit() for name in names):
        return f" No ({' x '.join(names)})"
    parts = [list(name) if name in ("xy", "xyz", "xyzw") else name.split("_") for name in names]
    return " No " + "".join(f"[{', '.join(part)}]" for part in parts)


def _names(cls: type) -> Iterator[str]:
    for each in definition_of(cls).attributes:
        yield each.name
        for part in each.slot.value.parts:
            yield from _names(part.cls)


KEYS = {name for record in RECORDS.values() if record.cls not in (SceneFile, StudyFile) for name in _names(record.cls)}


def mdoc(text: str, names: Collection[str] = ()) -> Iterator[str]:
    """Lines of mdoc: a sentence begins on a line of its own; what is in backticks is a flag, an option or a key."""
    for sentence in re.split(r"(?<=[.:]) (?=[A-Z])", text):
        for plain, name, after in re.findall(r"([^`]*)(?:`([^`]+)`([.,:;)]*))?", sentence):
            if plain.strip():
                yield plain.strip()
            if name:
                yield f"{_macro(name, names or KEYS)}{' ' * bool(after)}{after}"


FLAGS = {rule.name for rule in RULES}


def _macro(name: str, names: Collection[str]) -> str:
    if name.startswith("--"):
        return f".Fl Fl {name[2:]}"
    if name.startswith("ringpose "):
        return f".Nm {name}"
    return f".Va {name}" if name in names else f".Cm {name}"


TABLES: Mapping[tuple[str, str], Callable[[], Iterator[str]]] = {
    ("ringpose-records.5", "flags"): flags,
    ("ringpose-records.5", "usable"): usable,
    **{("ringpose-records.5", f"keys of {cls.__name__}"): partial(keys, cls) for cls in PARTS},
    **{
        ("ringpose-conventions.7", f"keys of {cls.__name__}"): partial(keys, cls)
        for cls in (RigFile, CameraFile, Board, Truth, RobotPose)
    },
    **{("ringpose-simulate.1", f"keys of {cls.__name__}"): partial(keys, cls, SceneFile) for cls in OF_SCENE},
    ("ringpose-bench.1", "keys of Report"): partial(keys, Report, Report),
    **{("ringpose-study.5", f"keys of {cls.__name__}"): partial(keys, cls, StudyFile) for cls in OF_STUDY},
    **{
        ("ringpose-capture.1", f"keys of {cls.__name__}"): partial(keys, cls)
        for cls in (Session, FoundCamera, SerialPort, DeviceCheck)
    },
}


def with_table(page: str, name: str, lines: Iterator[str]) -> str:
    """The text of a page with the lines of a table between its marks."""
    begin, end = (f'.\\" {word} of the table {name}, made from the code\n' for word in ("beginning", "end"))
    before, found, rest = page.partition(begin)
    _, ended, after = rest.partition(end)
    if not (found and ended):
        raise ValueError(f"no marks of the table {name}")
    return before + begin + "".join(f"{line}\n" for line in lines) + end + after


def write() -> None:
    for (page, name), lines in TABLES.items():
        file = MAN / page
        file.write_text(with_table(file.read_text(), name, lines()))


if __name__ == "__main__":
    write()
