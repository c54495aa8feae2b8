"""Figures that are compared with their targets one by one: `make bench-targets`."""

import argparse
from collections.abc import Iterable, Iterator

import numpy as np
from benchmarks.limits import Figure, figure_line
from scipy.stats import chi2

WRONG_SIGMAS = 5.0
"""Mahalanobis distance from which a quantity is wrong."""


def target(name: str, measured: float, most: float, least: float = -np.inf) -> Figure:
    """A figure and its limits."""
    return Figure(name=name, measured=float(measured), max_value=float(most), min_value=float(least))


def band(runs: int, dof: int, probability: float = 0.99) -> tuple[float, float]:
    """Two-sided band of the mean NEES over independent runs."""
    least, most = chi2.ppf([(1 - probability) / 2, (1 + probability) / 2], runs * dof) / (runs * dof)
    return float(least), float(most)


def printed(figures: Iterable[Figure]) -> Iterator[Figure]:
    """The figures as they come, each printed in one line."""
    for figure in figures:
        print(figure_line(figure), flush=True)
        yield figure


def status(figures: Iterable[Figure]) -> int:
    """Print the figures; 3 if one misses its target."""
    return 3 if [figure for figure in printed(figures) if not figure.is_kept] else 0


def options(document: str | None, **defaults: int) -> argparse.ArgumentParser:
    """The options of a script with numbers of runs."""
    parser = argparse.ArgumentParser(description=(document or "").splitlines()[0])
    for name, default in defaults.items():
        parser.add_argument(f"--{name}", type=int, default=default)
    return parser
