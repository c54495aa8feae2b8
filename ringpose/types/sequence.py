"""What is lit, frame by frame: `off,1,2,3,off`."""

import re
from collections.abc import Iterable
from dataclasses import dataclass

from ringpose.errors import UsageError

MOST_LASERS = 8
"""A mask is one byte."""

_STEP = re.compile(r"[1-9][0-9]*(\+[1-9][0-9]*)*")


@dataclass(frozen=True, slots=True)
class Step:
    """One frame of a shot: which lasers are on."""

    text: str
    """`off`, `all`, or 1-based laser numbers joined by `+`, as the user wrote it."""

    def mask(self, count: int) -> int:
        """Bit i for laser i of a rig with `count` lasers; a number beyond them is refused."""
        if self.text == "off":
            return 0
        if self.text == "all":
            return (1 << count) - 1
        numbers = [int(number) for number in self.text.split("+")]
        if max(numbers) > count:
            lasers = "1 laser" if count == 1 else f"{count} lasers"
            raise UsageError("--sequence", f'step "{self.text}" names laser {max(numbers)} of a rig with {lasers}')
        return sum(1 << (number - 1) for number in numbers)


def parsed_sequence(text: str) -> tuple[Step, ...]:
    """The steps of a sequence, strictly: separated by commas, each `off`, `all` or numbers joined by `+`."""
    return tuple(_parsed_step(word.strip(), place) for place, word in enumerate(text.split(","), start=1))


def steps_of(masks: Iterable[int], count: int) -> tuple[Step, ...]:
    """The steps that light these masks on a rig with `count` lasers."""
    return tuple(_step_of(mask, count) for mask in masks)


def _step_of(mask: int, count: int) -> Step:
    if mask == (1 << count) - 1:
        return Step("all")
    numbers = [str(bit + 1) for bit in range(MOST_LASERS) if mask >> bit & 1]
    return Step("+".join(numbers) or "off")


def _parsed_step(word: str, place: int) -> Step:
    if word in ("off", "all"):
        return Step(word)
    if not _STEP.fullmatch(word):
        raise UsageError(
            "--sequence", f'step {place} is "{word}"', "a step is off, all, or laser numbers from 1 joined by +"
        )
    numbers = word.split("+")
    if len(set(numbers)) < len(numbers):
        raise UsageError("--sequence", f'step {place}, "{word}", names a laser twice')
    if max(map(int, numbers)) > MOST_LASERS:
        raise UsageError("--sequence", f'step {place}, "{word}", names a laser beyond the {MOST_LASERS} of a mask')
    return Step(word)
