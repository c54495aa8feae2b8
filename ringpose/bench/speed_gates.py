"""A figure and the limit it is to keep."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from ringpose.bench.detectors_report import number
from ringpose.bench.summary import ABSENT
from ringpose.bench.table import aligned


class Verdict(StrEnum):
    """What becomes of a gate."""

    OK = "ok"
    MISSED = "MISSED"
    NOT_YET = "not yet"
    """There is nothing to measure."""
    FREE = ABSENT
    """Measured for comparison, without a limit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gate:
    """One figure."""

    what: str
    measured: float | None
    """None where there is nothing to measure yet; NaN, which keeps no limit, where nothing came of it."""
    unit: str = ""
    most: float = math.inf
    least: float = -math.inf

    @property
    def verdict(self) -> Verdict:
        """Whether the figure keeps its limits."""
        if self.measured is None:
            return Verdict.NOT_YET
        if math.isinf(self.most) and math.isinf(self.least):
            return Verdict.FREE
        return Verdict.OK if self.least <= self.measured <= self.most else Verdict.MISSED


@dataclass(frozen=True, slots=True, kw_only=True)
class GateSection:
    """Gates of one subject."""

    title: str
    gates: Sequence[Gate]


def section_text(section: GateSection) -> str:
    """The gates of a section as aligned text."""
    heading = ["", "measured", "limit", "verdict", "unit"]
    rows = [[gate.what, _measured(gate), _limit(gate), gate.verdict.value, gate.unit] for gate in section.gates]
    return "\n".join([section.title, *aligned([heading, *rows], left=1)]) + "\n"


def section_record(section: GateSection) -> dict[str, Any]:
    """The same as plain values; what is no limit is null."""
    return {
        "section": section.title,
        "gates": [
            {
                "what": gate.what,
                "measured": gate.measured,
                "least": gate.least,
                "most": gate.most,
                "unit": gate.unit,
                "verdict": "none" if gate.verdict is Verdict.FREE else gate.verdict.value,
            }
            for gate in section.gates
        ],
    }


def _measured(gate: Gate) -> str:
    return ABSENT if gate.measured is None else number(gate.measured, ".3g")


def _limit(gate: Gate) -> str:
    if math.isinf(gate.most):
        return ABSENT
    return f"<= {gate.most:.3g}" if math.isinf(gate.least) else f"{gate.least:.3g} .. {gate.most:.3g}"
