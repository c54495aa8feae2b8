"""The comparison of detectors as aligned text and as plain values."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from ringpose.bench.detectors import LINE_DISTANCES_PX, DetectorLine
from ringpose.bench.summary import ABSENT
from ringpose.bench.table import aligned

SCHEMA = "bench_detectors/1"

STRIPE_COLUMNS = {
    "recall": ("recall", ".2f"),
    "fragments": ("pieces", ".1f"),
    "center_rms_px": ("center px", ".4f"),
    "end_bias_px": ("end bias px", ".3f"),
    "end_sd_px": ("end sd px", ".3f"),
    "false": ("false", ".1f"),
}
"""Heading and format of what only stripes with truth have."""


def group_table(title: str, lines: Sequence[DetectorLine]) -> str:
    """A line for each detector on a group of images, with the columns that are known."""
    stripes = any(not math.isnan(line.recall) for line in lines)
    drawn = any(line.length_recall for line in lines)
    heading = ["detector", "ms", "ratio", "segments"]
    heading += [name for name, _ in STRIPE_COLUMNS.values()] if stripes else []
    heading += [f"recall {distance_px:g} px" for distance_px in LINE_DISTANCES_PX] if drawn else []
    rows = [_cells(line, stripes, drawn) for line in lines]
    return "\n".join([title, *aligned([heading, *rows], left=1)]) + "\n"


def detectors_report(groups: Mapping[str, Sequence[DetectorLine]]) -> dict[str, Any]:
    """The same in seconds, ratios and pixels."""
    return {
        "ringpose": SCHEMA,
        "groups": [{"images": title, "detectors": [asdict(line) for line in lines]} for title, lines in groups.items()],
    }


def number(value: float, form: str) -> str:
    """A figure, or that there is none."""
    return ABSENT if math.isnan(value) else format(value, form)


def _cells(line: DetectorLine, stripes: bool, drawn: bool) -> list[str]:
    cells = [line.detector, f"{line.time_s * 1e3:.2f}", f"{line.ratio:.3f}", f"{line.segments:.0f}"]
    if stripes:
        cells += [number(getattr(line, name), form) for name, (_, form) in STRIPE_COLUMNS.items()]
    if drawn:
        recall = line.length_recall
        cells += [number(recall.get(f"{distance:g}", math.nan), ".3f") for distance in LINE_DISTANCES_PX]
    return cells
