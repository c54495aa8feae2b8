"""A measured figure, the limit that it must keep, and both as a line of a table."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from ringpose.bench.summary import ABSENT
from ringpose.bench.table import aligned


class Verdict(StrEnum):
    """The result of comparing a figure with its limit."""

    OK = "ok"
    MISSED = "MISSED"
    NONE = "none"
    """The figure is measured for comparison and has no limit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """One measured figure."""

    name: str
    measured: float
    """NaN, which misses every limit, if the measurement failed."""
    unit: str = ""
    max_value: float = math.inf
    min_value: float = -math.inf

    @property
    def verdict(self) -> Verdict:
        """Whether the figure is within its limits."""
        if math.isinf(self.max_value) and math.isinf(self.min_value):
            return Verdict.NONE
        return Verdict.OK if self.min_value <= self.measured <= self.max_value else Verdict.MISSED

    @property
    def is_kept(self) -> bool:
        """Whether the figure has no limit, or is within it."""
        return self.verdict is not Verdict.MISSED


def figure_line(figure: Figure) -> str:
    """A figure, its limit and whether it is kept, in one line."""
    verdict = "ok    " if figure.is_kept else "MISSED"
    return f"{verdict} {figure.name:72s} {figure.measured:9.4g}   {_limit(figure)}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """Figures of one subject."""

    title: str
    figures: Sequence[Figure]

    @property
    def missed(self) -> int:
        """Number of figures that miss their limit."""
        return sum(not figure.is_kept for figure in self.figures)


def section_text(section: Section) -> str:
    """The figures of a section as aligned text."""
    rows = [["", "measured", "limit", "verdict", "unit"]]
    for figure in section.figures:
        verdict = ABSENT if figure.verdict is Verdict.NONE else figure.verdict.value
        rows.append([figure.name, number(figure.measured, ".3g"), _limit(figure), verdict, figure.unit])
    return "\n".join([section.title, *aligned(rows, left=1)]) + "\n"


def number(value: float, form: str) -> str:
    """A formatted figure, or `-` for NaN."""
    return ABSENT if math.isnan(value) else format(value, form)


def _limit(figure: Figure) -> str:
    if math.isinf(figure.max_value):
        return ABSENT
    if math.isinf(figure.min_value):
        return f"<= {figure.max_value:.3g}"
    return f"{figure.min_value:.3g} .. {figure.max_value:.3g}"
