"""Whether a result is good: numbers beside the limits that they were judged by."""

import math
from dataclasses import dataclass
from enum import StrEnum


class Grade(StrEnum):
    """How good; the value is what the user reads."""

    GOOD = "good"
    IMPROVABLE = "can be improved"
    REDO = "redo"


_FROM_GOOD_TO_BAD = tuple(Grade)


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One number and its limits; whether more is better or worse, the order of the limits says."""

    name: str
    """The quantity as it is spelt in files, with its unit: `rms_px`."""
    value: float
    """NaN if it is not known: that can be improved."""
    pass_limit: float
    """Good up to here (or from here on, if it is the larger of the two limits)."""
    fail_limit: float
    """To be done anew beyond here; infinite if this number alone never asks for that."""
    advice: str = ""
    """What would make the number better, in words; empty if there is nothing to say."""
    place: str = ""
    """What the number belongs to, as a laser's name; empty if to the whole."""

    @property
    def grade(self) -> Grade:
        """What this number alone says."""
        if math.isnan(self.value):
            return Grade.IMPROVABLE
        sign = 1.0 if self.fail_limit >= self.pass_limit else -1.0
        if sign * self.value <= sign * self.pass_limit:
            return Grade.GOOD
        return Grade.REDO if sign * self.value > sign * self.fail_limit else Grade.IMPROVABLE


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """All findings; the worst one is the grade of the whole."""

    findings: tuple[Check, ...]

    @property
    def grade(self) -> Grade:
        """The worst of the findings'."""
        return max((finding.grade for finding in self.findings), key=_FROM_GOOD_TO_BAD.index, default=Grade.GOOD)

    @property
    def advice(self) -> tuple[str, ...]:
        """What would help, of the findings that are not good, the worst first, each sentence once."""
        worst_first = sorted(self.findings, key=lambda finding: -_FROM_GOOD_TO_BAD.index(finding.grade))
        said = (finding.advice for finding in worst_first if finding.grade is not Grade.GOOD and finding.advice)
        return tuple(dict.fromkeys(said))
