"""The tables of the manual that are made from the code: the flags of a line (`ringpose.measure.status`).

    python tests/manual_tables.py    write them into man/

A table stands between two comment lines of the page that have its name.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from ringpose.measure.status import RULES, FlagRule
from ringpose.types.pose import HARMLESS_FLAGS

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


def mdoc(text: str) -> Iterator[str]:
    """Lines of mdoc: a sentence begins on a line of its own; what is in backticks is a flag, an option or a key."""
    for sentence in re.split(r"(?<=[.:]) (?=[A-Z])", text):
        for plain, name, after in re.findall(r"([^`]*)(?:`([^`]+)`([.,;)]*))?", sentence):
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
    return f".Cm {name}" if name in FLAGS or name == "ok" else f".Va {name}"


TABLES: Mapping[tuple[str, str], Callable[[], Iterator[str]]] = {
    ("ringpose-records.5", "flags"): flags,
    ("ringpose-records.5", "usable"): usable,
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
