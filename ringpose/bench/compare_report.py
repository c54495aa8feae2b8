"""A comparison of two results, as text and as plain values for JSON."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from ringpose.bench.assumptions import CountedAssumptions, assumption_lines, counted
from ringpose.bench.compare import COMPARED, Pair, Row, RowVerdict, testable_shots
from ringpose.bench.score import Judgement
from ringpose.bench.summary import ABSENT, WrongQuantities, wrong_quantities
from ringpose.bench.table import COLUMNS, NEES, group_cells
from ringpose.files.records.codec import definition_of
from ringpose.types.table import Table

SCHEMA = "bench_compare/1"

UNITS: Mapping[str, tuple[str, float]] = {
    **{name: column for name, column in COLUMNS.items() if name not in ("center_x_m", "center_y_m", "center_z_m")},
    "center_typical_m": ("typical center mm", 1e3),
    "normal_typical_rad": ("typical normal deg", COLUMNS["normal_rad"][1]),
    "grasp_typical_m": ("typical grasp mm", 1e3),
    **{name: (heading, 1.0) for name, heading in NEES.items()},
    "available": ("available %", 100.0),
    "no_pose": ("no pose %", 100.0),
    "wrong": ("wrong / shot", 1.0),
    "latency_s": ("time ms", 1e3),
}
"""Heading and factor of each compared quantity."""

MAX_NAMED = 10
"""Maximum number of newly wrong quantities, and of shots newly without a pose, that the text names."""


def nothing_changed(rows: Sequence[Row]) -> bool:
    """Whether no judged score of any shot changed."""
    return all(row.verdict is RowVerdict.SAME for row in rows if COMPARED[row.quantity].judged)


def newly_wrong(paired: Sequence[tuple[str, Sequence[Pair]]]) -> list[tuple[str, str, str]]:
    """Method, shot and name of each quantity that is wrong in B and not in A."""
    return [
        (method, a.shot, name)
        for method, members in paired
        for a, b in members
        for name in b.wrong
        if name not in a.wrong
    ]


def newly_without_pose(paired: Sequence[tuple[str, Sequence[Pair]]]) -> list[tuple[str, str]]:
    """Method and name of each shot of a ring for which A has a pose and B has none."""
    without = ("none", "lost")
    return [
        (method, a.shot)
        for method, members in paired
        for a, b in members
        if a.has_target and a.status not in without and b.status in without
    ]


def no_longer_correct(paired: Sequence[tuple[str, Sequence[Pair]]]) -> list[tuple[str, WrongQuantities]]:
    """Methods whose verdict is `none wrong` in A and `WRONG` in B, with the judgements of B.

    This verdict does not compare means, so that one wrong quantity can change it; if all covariances are correct, it
    changes in less than 1 % of comparisons.
    """
    return [
        (method, wrong)
        for method, members in paired
        if not (wrong := wrong_quantities([b for _, b in members])).none_wrong
        and wrong_quantities([a for a, _ in members]).none_wrong
    ]


def comparison_text(
    rows: Sequence[Row], paired: Sequence[tuple[str, Sequence[Pair]]], by: Sequence[str], tolerance: float, matched: str
) -> str:
    """One line if nothing changed; else a table of the changed rows, the newly wrong quantities, and the verdicts."""
    judged = [row for row in rows if COMPARED[row.quantity].judged]
    if nothing_changed(rows):
        shots = len({a.shot for _, members in paired for a, _ in members})
        return f"nothing changed: {shots} shots, {len({row.quantity for row in judged})} quantities ({matched})\n"
    of_row = ("quantity", "shots", "A", "B", "difference", "95 % interval", "p", "verdict", "needs shots")
    changed = [row for row in rows if row.verdict is not RowVerdict.SAME]
    shown = [row for row in changed if testable_shots(row.changed)]
    table = Table(headings=["method", *by, *of_row], rows=[_cells(row, by) for row in shown])
    lines = ["B beside A; a positive difference is worse"]
    lines += [*table.lines(left=2 + len(by)), ""] if shown else []
    if len(shown) < len(changed):
        lines.append(f"{len(changed) - len(shown)} more rows cannot tell, with fewer than 6 shots that changed")
    lines += _named("newly wrong", [f"{shot} {name} ({method})" for method, shot, name in newly_wrong(paired)])
    lines += _named("newly without a pose", [f"{shot} ({method})" for method, shot in newly_without_pose(paired)])
    counts = Counter(row.verdict for row in judged)
    beyond = sum(row.beyond_tolerance for row in judged)
    lines.append(
        f"{counts[RowVerdict.WORSE]} rows worse ({beyond} beyond the tolerance of {tolerance:g}), "
        f"{counts[RowVerdict.BETTER]} better, {counts[RowVerdict.CANNOT_TELL]} cannot tell, "
        f"{counts[RowVerdict.SAME]} the same; {matched}"
    )
    lines += assumption_lines([b.assumptions or a.assumptions for _, members in paired for a, b in members])
    return "\n".join(lines) + "\n"


def _named(title: str, findings: Sequence[str]) -> list[str]:
    """A line with the number of findings and the first of them; none if there are none."""
    named = "; ".join([*findings[:MAX_NAMED], *(["..."] if len(findings) > MAX_NAMED else [])])
    return [f"{title}: {len(findings)}: {named}"] if findings else []


def _cells(row: Row, by: Sequence[str]) -> list[str]:
    heading, factor = UNITS[row.quantity]
    low_high = ABSENT if row.interval is None else " .. ".join(f"{end * factor:+.3g}" for end in row.interval)
    verdict = str(row.verdict)
    if row.verdict is RowVerdict.WORSE and not row.beyond_tolerance:
        verdict = "worse (tolerated)" if COMPARED[row.quantity].judged else "worse (not judged)"
    return [
        *group_cells(row.method, row.group, by),
        heading,
        str(row.shots),
        f"{row.a * factor:.3g}",
        f"{row.b * factor:.3g}",
        f"{row.difference * factor:+.3g}",
        low_high,
        f"{row.p_adjusted:.2g}",
        verdict,
        ABSENT if row.shots_needed is None else str(row.shots_needed),
    ]


def worse_sentences(rows: Sequence[Row], paired: Sequence[tuple[str, Sequence[Pair]]]) -> Iterator[str]:
    """A message for each row that is worse by more than the tolerance, and each method that is no longer correct."""
    for row in rows:
        if row.beyond_tolerance:
            group = ", ".join(f"{name} {value}" for name, value in row.group.items()) or "all shots"
            method = f" ({row.method})" if row.method else ""
            change = "" if row.change is None or not COMPARED[row.quantity].relative else f", {row.change:+.1%}"
            yield f"worse: {row.quantity} of {group}{method}: {row.a:.4g} -> {row.b:.4g}{change}"
    for name, wrong in no_longer_correct(paired):
        count = f"{wrong.count(Judgement.WRONG)} of {wrong.judged} quantities wrong"
        method = f" ({name})" if name else ""
        yield f"worse: none wrong -> {count}{method}: {wrong.allowed} allowed by chance, {wrong.gross} gross"


def comparison_record(
    rows: Sequence[Row],
    paired: Sequence[tuple[str, Sequence[Pair]]],
    tolerance: float,
    matched: Mapping[str, Any],
) -> dict[str, Any]:
    """The comparison as plain values in metres, radians, seconds and shares."""
    return {
        "ringpose": SCHEMA,
        "tolerance": tolerance,
        "assumptions": [
            definition_of(CountedAssumptions).write(assumptions)
            for assumptions in counted(b.assumptions or a.assumptions for _, members in paired for a, b in members)
        ],
        "matched": dict(matched),
        "changed": not nothing_changed(rows),
        "worse": sum(row.beyond_tolerance for row in rows),
        "rows": [{**asdict(row), "verdict": str(row.verdict)} for row in rows],
        "newly_wrong": [
            {"method": method, "shot": shot, "quantity": name} for method, shot, name in newly_wrong(paired)
        ],
        "newly_without_pose": [{"method": method, "shot": shot} for method, shot in newly_without_pose(paired)],
        "no_longer_correct": [method for method, _ in no_longer_correct(paired)],
    }
