"""Summaries as plain aligned text, in millimetres and degrees."""

import math
from collections.abc import Callable, Mapping, Sequence

from ringpose.bench.assumptions import StatedAssumptions, assumption_lines
from ringpose.bench.score import JUDGED, Judgement, Matching, Outcome, Value
from ringpose.bench.summary import ABSENT, Summary
from ringpose.types.table import Table

OUTCOMES = {outcome: outcome.value for outcome in Outcome}
OUTCOMES |= {Outcome.PARTIAL_NONE: "part.none", Outcome.NO_TARGET: "no target"}

_MM = 1e3
_DEG = 180 / math.pi

COLUMNS = {
    "center_x_m": ("x mm", _MM),
    "center_y_m": ("y mm", _MM),
    "center_z_m": ("z mm", _MM),
    "center_m": ("center mm", _MM),
    "normal_rad": ("normal deg", _DEG),
    "radius_inner_m": ("r_in mm", _MM),
    "radius_outer_m": ("r_out mm", _MM),
    "grasp_m": ("grasp mm", _MM),
    "velocity_m_s": ("v mm/s", _MM),
    "rate_rad_s": ("rate deg/s", _DEG),
}
"""Heading and factor of each quantity."""

WRONG_HEADINGS = dict(zip(JUDGED, ("center", "normal", "grasp", "r_in", "r_out", "velocity"), strict=True))

NEES = {"center_nees": "center NEES", "normal_nees": "normal NEES", "velocity_nees": "v NEES"}

OPTIONAL = ("v mm/s", "rate deg/s", "v NEES", "velocity")
"""Headings of columns that are left out if no line has a value, as for still targets."""


def table(
    summaries: Sequence[Summary],
    by: Sequence[str],
    matched: Matching | None = None,
    assumptions: Sequence[StatedAssumptions | None] = (),
) -> str:
    """Tables of outcomes, RMSE and NEES, median and maximum errors, and wrong quantities.

    They are followed by the verdict of each method, by the assumptions of the poses, and by the number of pose records
    and truths that match.
    """
    blocks = [
        _block("shots", summaries, by, _outcomes),
        _block("errors, root mean square", summaries, by, _rmse),
        _block("errors, median and maximum", summaries, by, _median_and_max),
        _block("wrong quantities of those judged", summaries, by, _wrong),
        "\n".join(_verdict(line) for line in summaries if not line.group),
        *(["\n".join(lines)] if (lines := assumption_lines(assumptions)) else []),
    ]
    if matched is not None:
        blocks.append(_matched(matched))
    return "\n\n".join(blocks) + "\n"


def _block(
    title: str, summaries: Sequence[Summary], by: Sequence[str], cells: Callable[[Summary], Mapping[str, str]]
) -> str:
    of_lines = [cells(line) for line in summaries]
    shown = [
        heading
        for heading in (of_lines[0] if of_lines else ())
        if heading not in OPTIONAL or any(of_line[heading] not in (ABSENT, "0/0") for of_line in of_lines)
    ]
    rows = [
        [*group_cells(line.method, line.group, by), *(of_line[heading] for heading in shown)]
        for line, of_line in zip(summaries, of_lines, strict=True)
    ]
    table = Table(headings=["method", *by, *shown], rows=rows)
    return "\n".join([title, *table.lines(left=1 + len(by))])


def group_cells(method: str, group: Mapping[str, Value], by: Sequence[str]) -> list[str]:
    """The cells of a method and of the values of a group; `all` for the empty one."""
    return [method or ABSENT, *(str(group.get(name, ABSENT)) if group else "all" for name in by)]


def _outcomes(line: Summary) -> Mapping[str, str]:
    return {"shots": str(line.shots)} | {name: str(line.outcomes[outcome]) for outcome, name in OUTCOMES.items()}


def _wrong(line: Summary) -> Mapping[str, str]:
    """Wrong/judged for each quantity and in total, the number allowed by chance, and those not judged."""
    cells = {
        WRONG_HEADINGS[name]: f"{counts[Judgement.WRONG]}/{counts[Judgement.WRONG] + counts[Judgement.CORRECT]}"
        for name, counts in line.wrong.counts.items()
    }
    return {
        "available": f"{line.available}/{line.targets}",
        **cells,
        "wrong": f"{line.wrong.count(Judgement.WRONG)}/{line.wrong.judged}",
        "allowed": str(line.wrong.allowed),
        "gross": str(line.wrong.gross),
        "flagged": str(line.wrong.count(Judgement.FLAGGED)),
        "no cov.": str(line.wrong.count(Judgement.NO_COVARIANCE)),
        "verdict": line.wrong.verdict,
    }


def _verdict(line: Summary) -> str:
    wrong = line.wrong
    return (
        f"{line.method or ABSENT}: {wrong.verdict}: {wrong.count(Judgement.WRONG)} of {wrong.judged} quantities are "
        f"wrong, {wrong.allowed} allowed by chance (99 %), {wrong.gross} of them gross; "
        f"{line.available} of {line.targets} shots are available (ok)"
    )


def _matched(matched: Matching) -> str:
    parts = [f"{matched.matched} of {matched.truths} shots of the truth matched"]
    parts += [f"{len(matched.without_truth)} without truth"] if matched.without_truth else []
    parts += [f"{len(matched.repeated)} repeated"] if matched.repeated else []
    parts += ["in another order"] if matched.unsorted else []
    return ", ".join(parts)


def _rmse(line: Summary) -> Mapping[str, str]:
    errors = {
        heading: number(factor * line.errors[name].rmse) if name in line.errors else ABSENT
        for name, (heading, factor) in COLUMNS.items()
    }
    nees = {heading: f"{line.nees[name]:.3g}" if name in line.nees else ABSENT for name, heading in NEES.items()}
    return {**errors, **nees}


def _median_and_max(line: Summary) -> Mapping[str, str]:
    cells = {}
    for name in ("center_m", "normal_rad", "radius_inner_m", "radius_outer_m", "grasp_m"):
        heading, factor = COLUMNS[name]
        errors = line.errors.get(name)
        cells[heading] = ABSENT if errors is None else number(factor * errors.median)
        cells[f"{heading.split()[0]} max"] = ABSENT if errors is None else number(factor * errors.max)
    return cells


def number(value: float) -> str:
    """Three significant digits without an exponent, at most six decimals; `-` for NaN."""
    if not math.isfinite(value):
        return ABSENT
    digits = 2 - math.floor(math.log10(abs(value))) if value else 0
    return f"{value:.{min(max(digits, 0), 6)}f}"
