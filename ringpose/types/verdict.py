"""Acceptance of a result: quantities, each with the limits that it was checked against."""

import math
from dataclasses import dataclass
from enum import StrEnum


class Grade(StrEnum):
    """Grade of a result; the value is the word for the user."""

    GOOD = "good"
    IMPROVABLE = "can be improved"
    REDO = "redo"


_FROM_GOOD_TO_BAD = tuple(Grade)


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One quantity and its limits; the order of the limits determines whether a larger value is better or worse."""

    name: str
    """Name of the quantity as in files, with its unit: `rms_px`."""
    value: float
    """NaN if not known, which is graded as improvable."""
    pass_limit: float
    """Good up to this value (or from this value, if it is the larger of the two limits)."""
    fail_limit: float
    """Failed beyond this value; infinite if this quantity alone never fails a result."""
    advice: str = ""
    """Advice on how to improve the value; may be empty."""
    place: str = ""
    """What the quantity refers to, such as a laser's name; empty for the whole result."""

    @property
    def grade(self) -> Grade:
        """The grade of this quantity alone."""
        if math.isnan(self.value):
            return Grade.IMPROVABLE
        sign = 1.0 if self.fail_limit >= self.pass_limit else -1.0
        if sign * self.value <= sign * self.pass_limit:
            return Grade.GOOD
        return Grade.REDO if sign * self.value > sign * self.fail_limit else Grade.IMPROVABLE


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """All checks; the worst grade is that of the result."""

    findings: tuple[Check, ...]

    @property
    def grade(self) -> Grade:
        """The worst grade of the checks."""
        return max((finding.grade for finding in self.findings), key=_FROM_GOOD_TO_BAD.index, default=Grade.GOOD)

    @property
    def advice(self) -> tuple[str, ...]:
        """Advice of the checks that are not good, the worst first, without repetitions."""
        worst_first = sorted(self.findings, key=lambda finding: -_FROM_GOOD_TO_BAD.index(finding.grade))
        sentences = (finding.advice for finding in worst_first if finding.grade is not Grade.GOOD and finding.advice)
        return tuple(dict.fromkeys(sentences))
