"""A measured figure with its limits, one line of a report; figures that are measured one by one and the exit status."""

import argparse
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from calibrated import chi_squared

from ringpose.bench.summary import ABSENT

WRONG_SIGMAS = 5.0
"""Mahalanobis distance from which a quantity is wrong."""

NAME_WIDTH = 72


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """One measured figure; without limits it is printed for comparison."""

    name: str
    measured: float
    """NaN, which misses every limit, if the measurement failed."""
    unit: str = ""
    max_value: float = math.inf
    min_value: float = -math.inf
    is_judged: bool = True
    """False for times by the clock on a busy machine, which are printed only."""

    @property
    def is_kept(self) -> bool:
        """Whether the figure has no limit, is not judged, or is within its limits."""
        return not self._limit or not self.is_judged or self.min_value <= self.measured <= self.max_value

    def under(self, title: str) -> "Figure":
        """The figure with a title before its name."""
        return replace(self, name=f"{title}: {self.name}")

    @property
    def _limit(self) -> str:
        low, high = (f"{value:.3g}" * math.isfinite(value) for value in (self.min_value, self.max_value))
        return f"{low} .. {high}" if low and high else f"<= {high}" if high else f">= {low}" if low else ""

    def __str__(self) -> str:
        verdict = "MISSED" if not self.is_kept else "ok" if self._limit and self.is_judged else ABSENT
        line = f"{verdict:6s} {self.name:{NAME_WIDTH}s} {number(self.measured, '.4g'):>9s} {self.unit} {self._limit}"
        return line if self.is_judged else f"{line} (not judged: the machine is busy)"


def target(name: str, measured: float, most: float, least: float = -math.inf) -> Figure:
    """A figure without a unit, and its limits."""
    return Figure(name=name, measured=float(measured), max_value=float(most), min_value=float(least))


def band(runs: int, dof: int, probability: float = 0.99) -> tuple[float, float]:
    """Two-sided band of the mean NEES over independent runs."""
    least, most = chi_squared([(1 - probability) / 2, (1 + probability) / 2], runs * dof) / (runs * dof)
    return float(least), float(most)


def number(value: float, form: str) -> str:
    """A formatted figure, or `-` for NaN."""
    return ABSENT if math.isnan(value) else format(value, form)


def printed(figures: Iterable[Figure]) -> list[Figure]:
    """The figures, each printed as soon as it is measured."""
    found = []
    for figure in figures:
        print(figure, flush=True)
        found.append(figure)
    return found


def status(figures: Iterable[Figure]) -> int:
    """Print the figures; 3 if one misses its limit."""
    return 0 if all(figure.is_kept for figure in printed(figures)) else 3


def options(document: str | None, **defaults: int) -> argparse.ArgumentParser:
    """The options of a script: numbers of runs, images or repetitions."""
    parser = argparse.ArgumentParser(description=(document or "").splitlines()[0])
    for name, default in defaults.items():
        parser.add_argument(f"--{name}", type=int, default=default, help=f"default {default}")
    return parser
