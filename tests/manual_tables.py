"""The tables of the manual that are made from the code: flags of a line, and the keys of records.

    python tests/manual_tables.py    write them into man/

A table stands between two comment lines of the page that have its name.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

from ringpose.capture.device_discovery import FoundCamera, SerialPort
from ringpose.capture.self_test import DeviceCheck
from ringpose.files.cameras.ros import CameraFile, CameraInfo
from ringpose.files.records.codec import Choice, Numbers, definition_of
from ringpose.files.rigs import RigFile
from ringpose.files.schemas import RECORDS
from ringpose.measure.status import RULES, FlagRule
from ringpose.types.board import Board
from ringpose.types.detection import BreakPoints, Detection
from ringpose.types.pose import HARMLESS_FLAGS, PoseLine, Priors, RingMeasurement, RingPose
from ringpose.types.rig import RobotPose
from ringpose.types.scene import Truth
from ringpose.types.session import Session
from ringpose.types.track import TrackLine

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


PARTS = (PoseLine, RingPose, RingMeasurement, Priors, TrackLine, Detection, BreakPoints)
"""Classes whose keys have a table of their own in records(5)."""


def keys(cls: type) -> Iterator[str]:
    """The keys of a record, or of a part of one; those of a part without a table of its own stand below its key."""
    attributes = definition_of(cls).attributes
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
        yield from mdoc(each.key.description)
        if isinstance(value, Choice) and not all(f"`{word}`" in each.key.description for word in value.words):
            yield f".Cm {' , '.join(value.words)} ."
        for part in value.parts:
            if part.cls not in (*PARTS, CameraInfo):
                yield from keys(part.cls)
    yield ".El"


def _axes(axes: Sequence[str]) -> str:
    """The shape of an array: `[point][x, y]`, or `7 x 7`."""
    names = [axis.partition("=")[0] for axis in axes]
    if names[0] in ("row", "parameter"):
        return ""
    if all(name.isdigit() for name in names):
        return f" No ({' x '.join(names)})"
    return " No " + "".join(f"[{', '.join(name) if name in ('xy', 'xyz', 'xyzw') else name}]" for name in names)


def _names(cls: type) -> Iterator[str]:
    for each in definition_of(cls).attributes:
        yield each.name
        for part in each.slot.value.parts:
            yield from _names(part.cls)


KEYS = {name for record in RECORDS.values() for name in _names(record.cls)}


def mdoc(text: str) -> Iterator[str]:
    """Lines of mdoc: a sentence begins on a line of its own; what is in backticks is a flag, an option or a key."""
    for sentence in re.split(r"(?<=[.:]) (?=[A-Z])", text):
        for plain, name, after in re.findall(r"([^`]*)(?:`([^`]+)`([.,:;)]*))?", sentence):
            if plain.strip():
                yield plain.strip()
            if name:
                yield f"{_macro(name)}{' ' * bool(after)}{after}"


FLAGS = {rule.name for rule in RULES}


def _macro(name: str) -> str:
    if name.startswith("--"):
        return f".Fl Fl {name[2:]}"
    if name.startswith("ringpose "):
        return f".Nm {name}"
    return f".Va {name}" if name in KEYS else f".Cm {name}"


TABLES: Mapping[tuple[str, str], Callable[[], Iterator[str]]] = {
    ("ringpose-records.5", "flags"): flags,
    ("ringpose-records.5", "usable"): usable,
    **{("ringpose-records.5", f"keys of {cls.__name__}"): partial(keys, cls) for cls in PARTS},
    **{
        ("ringpose-conventions.7", f"keys of {cls.__name__}"): partial(keys, cls)
        for cls in (RigFile, CameraFile, Board, Truth, RobotPose)
    },
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
