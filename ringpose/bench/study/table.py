"""Statistics of a study's rows, and its tables: first in the form of the paper's, then with bounds and baselines."""

from array import array
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import degrees, inf, nan, sqrt
from typing import Literal, cast

import numpy as np

from ringpose.bench.integrity import Integrity, integrity_table, levels_in, occurring_lines
from ringpose.bench.score import QUANTITIES, Judgement, Outcome, Score
from ringpose.bench.summary import ABSENT
from ringpose.bench.table import number
from ringpose.types.assumptions import RISK
from ringpose.types.study import BOUNDS, CASE, ERRORS, LIMITS, SIGMAS, TIMES, Factor, Row, Study, Value
from ringpose.types.table import Table

Key = tuple[Value, ...]


@dataclass(slots=True, kw_only=True, eq=False)
class Statistics:
    """Counts and values of the rows of one method in one cell of the grid."""

    shots: int = 0
    targets: int = 0
    """Shots in which a ring is visible."""
    answers: int = 0
    """Shots in which a ring is visible and that have a pose."""
    available: int = 0
    """Shots in which a ring is visible and whose status is `ok`."""
    false_poses: int = 0
    """Poses where no ring is visible."""
    failed: int = 0
    """Shots that could not be computed."""
    wrong: int = 0
    ok_wrong: int = 0
    """Shots with the status `ok` and a wrong quantity."""
    judged: int = 0
    gross: int = 0
    determined: Counter[str] = field(default_factory=Counter)
    """Number of shots that determine each of centre and grasp point within the limits of its flags ..."""
    reported: Counter[str] = field(default_factory=Counter)
    """... and of those among them that report it without such a flag."""
    stripes: Counter[int] = field(default_factory=Counter)
    """Number of shots by the number of stripes that they show on the ring's face."""
    reasons: Counter[str] = field(default_factory=Counter)
    """Number of shots by the reason why they have no pose."""
    values: dict[str, "array[float]"] = field(default_factory=lambda: defaultdict(lambda: array("d")))
    """Errors, reported standard deviations, bounds and times of the shots that have them, by the names of the columns;
    as `ratio_center_m` and so on the errors divided by their bounds."""

    def add(self, row: Row) -> None:
        """Include a row."""
        self.shots += 1
        self.failed += row["outcome"] == "error"
        has_target, has_pose = row["expect"] in ("pose", "partial"), row["status"] in ("ok", "degraded")
        self.targets += has_target
        self.answers += has_target and has_pose
        self.available += has_target and row["status"] == "ok"
        self.false_poses += has_pose and row["expect"] == "no_target"
        wrong = len(names_in(row["wrong"]))
        self.wrong += wrong
        self.ok_wrong += wrong > 0 and row["status"] == "ok"
        self.judged += wrong + len(names_in(row["correct"]))
        self.gross += len(names_in(row["gross"]))
        determined = set(names_in(row.get("determined")))
        self.determined.update(determined)
        self.reported.update(determined.intersection(names_in(row.get("reported"))))
        self.stripes[int(row.get("stripes") or 0)] += 1
        if not has_pose and (has_target or row["outcome"] == "error"):
            self.reasons[str(row["reason"] or "no pose").split(":")[0]] += 1
        for name in (*ERRORS, *SIGMAS, *BOUNDS, *TIMES):
            if (value := row.get(name)) is not None:
                self.values[name].append(float(value))
        for name in BOUNDS:
            error, bound = row.get(name.removeprefix("bound_")), row.get(name)
            if error is not None and bound is not None and float(bound) > 0:
                self.values[name.replace("bound", "ratio")].append(float(error) / float(bound))

    def count(self, name: str) -> int:
        """Number of values."""
        return len(self.values.get(name, ()))

    def rms(self, name: str) -> float:
        """Root mean square; NaN without any value."""
        return sqrt(float(np.mean(np.square(self.values[name])))) if self.count(name) else nan

    def median(self, name: str) -> float:
        """Median of the absolute values; NaN without any."""
        return float(np.median(np.abs(self.values[name]))) if self.count(name) else nan

    def mean(self, name: str) -> float:
        """Mean; NaN without any value."""
        return float(np.mean(self.values[name])) if self.count(name) else nan


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StudySummary:
    """The statistics of a study's cells."""

    methods: tuple[str, ...]
    by: tuple[str, ...]
    """The factors that distinguish the cells."""
    table: str
    cells: Mapping[tuple[str, Key], Statistics]
    """Statistics by method and values of the factors."""
    columns: Mapping[tuple[str, Key], Statistics]
    """Statistics by method and value of the factor `table` alone."""
    integrity: Mapping[tuple[str, str], Integrity]
    """Counts of levels by method and value of that factor."""

    def all(self, method: str) -> Statistics:
        """The statistics of all shots of a method."""
        return self.columns[method, ()]


def summarized(study: Study, rows: Iterable[Row]) -> StudySummary:
    """The statistics of all rows, which are read one by one: only numbers are kept, a few hundred bytes a row."""
    by = tuple(factor.name for factor in study.grid if len(factor.values) > 1)
    cells: dict[tuple[str, Key], Statistics] = {}
    wide: dict[tuple[str, Key], Statistics] = {(method.value, ()): Statistics() for method in study.methods}
    integrity: dict[tuple[str, str], Integrity] = {}
    for row in rows:
        method = str(row["method"])
        if row["outcome"] != "error":
            own = row[study.table] if study.table else None
            kind = "all" if own is None else value_text(study.table, own)
            integrity.setdefault((method, kind), Integrity()).add(levels_in(row))
        key = tuple(value for name in by if (value := row[name]) is not None)
        cells.setdefault((method, key), Statistics()).add(row)
        wide[method, ()].add(row)
        if study.table and (value := row[study.table]) is not None:
            wide.setdefault((method, (value,)), Statistics()).add(row)
    methods = tuple(method.value for method in study.methods)
    return StudySummary(methods=methods, by=by, table=study.table, cells=cells, columns=wide, integrity=integrity)


def names_in(cell: object) -> list[str]:
    """The names in a cell of a row, which are separated by blanks."""
    return str(cell or "").split()


def scores_of(rows: Iterable[Row], factors: Sequence[str]) -> list[Score]:
    """The rows as scores, to compare two results of one study."""
    return [
        Score(
            shot=str(row["shot"]),
            method=str(row["method"]),
            outcome=Outcome(str(row["outcome"])) if row["outcome"] != "error" else Outcome.LOST,
            status=cast(Literal["ok", "degraded", "none"], row["status"]),
            has_target=row["expect"] != "no_target",
            groups={name: value for name in factors if (value := row[name]) is not None},
            errors={name: float(value) for name in QUANTITIES if isinstance(value := row.get(name), float)},
            judgements={
                **dict.fromkeys(names_in(row["correct"]), Judgement.CORRECT),
                **dict.fromkeys(names_in(row["wrong"]), Judgement.WRONG),
            },
            gross=tuple(names_in(row["gross"])),
        )
        for row in rows
    ]


PAPER_ROWS = (
    ("position error x (mm)", "center_x_m", 1e3),
    ("position error y (mm)", "center_y_m", 1e3),
    ("position error z (mm)", "center_z_m", 1e3),
    ("angle error pitch (deg)", "pitch_rad", degrees(1)),
    ("angle error yaw (deg)", "yaw_rad", degrees(1)),
)
"""The rows of the paper's tables of results; here root mean square."""

PAPER_TIMES = (("detection (ms)", "detect_s"), ("pose (ms)", "pose_s"))


def study_text(study: Study, summary: StudySummary) -> str:
    """All tables of a study."""
    stripes = summary.all(summary.methods[0]).stripes
    shown = ", ".join(f"{stripes[number]} with {number}" for number in sorted(stripes))
    heading = [f"{study.title}: {study.shots} shots ({study.level}), seed {study.seed}", *violation_lines(study)]
    heading.append(f"shots by the number of stripes with an end on the face in view: {shown}")
    blocks = ["\n".join(heading)]
    for method in summary.methods:
        blocks.append("\n".join(paper_table(study, summary, method).lines()))
    if study.cases:
        blocks.append("\n".join(status_table(study, summary).lines(left=2)))
    cells = cell_table(summary, HEADINGS).lines(left=len(summary.by) + 1)
    blocks.append("\n".join(["errors beside their bounds, root mean square", *cells]))
    if any(max(each.leveled.values()) for each in summary.integrity.values()):
        title = f"integrity at a risk of {RISK if study.assumed is None else study.assumed.risk:g}"
        lines = integrity_table(summary.integrity, study.table).lines(left=2)
        blocks.append("\n".join([title, *lines, *occurring_text(study, summary)]))
    if failures := failure_rows(summary):
        blocks.append("\n".join(["shots with a visible ring but without a pose", *map("  ".join, failures)]))
    return "\n\n".join(blocks) + "\n"


def occurring_text(study: Study, summary: StudySummary) -> list[str]:
    """The share of misleading lines of each method, in a study that states how often faults occur."""
    return occurring_lines(summary.integrity, study.occurrence) if study.occurrence else []


def violation_lines(study: Study) -> list[str]:
    """What each case changes, and what the estimator assumes if that is not what was drawn."""
    lines = [f"case {name}: {', '.join(map(factor_text, own)) or 'no change'}" for name, own in study.cases.items()]
    if study.assumed is None:
        return lines
    assumed = study.assumed.about_shot(study.scene.rig.stability, still=False)
    motion = "still target"
    if assumed.motion is not None:
        speed_mm_s, rate_deg_s = 1e3 * assumed.motion.speed_sd_m_s, degrees(assumed.motion.rate_sd_rad_s)
        motion = f"motion by {speed_mm_s:g} mm/s and {rate_deg_s:g} deg/s (sd) of targets that are not still"
    ring = f"ring tolerance {1e3 * assumed.ring_tolerance_m:g} mm"
    return [*lines, f"assumed: {motion}, {ring}, rig stability times {study.assumed.rig_stability:g}"]


def factor_text(factor: Factor) -> str:
    """Name and values of a factor."""
    if factor.uniform is not None:
        return f"{factor.name} from {factor.uniform[0]:g} to {factor.uniform[1]:g}"
    return f"{factor.name} {'drawn from ' if factor.drawn else ''}" + ", ".join(map(str, factor.values))


def paper_table(study: Study, summary: StudySummary, method: str) -> Table:
    """The table in the paper's form: a column for each distance or light, a row for each component of the error."""
    keys, wide = wide_columns(summary, method)
    rows = [[label, *(number(column.rms(name) * factor) for column in wide)] for label, name, factor in PAPER_ROWS]
    if study.level == "images":
        rows += [[label, *(number(column.median(name) * 1e3) for column in wide)] for label, name in PAPER_TIMES]
    rows.append(["shots with a pose", *(f"{column.answers}/{column.targets}" for column in wide)])
    for name, quantity in (("center", "centre"), ("grasp", "grasp point")):
        counts = [f"{column.reported[name]}/{column.determined[name]}" for column in wide]
        rows.append([f"{quantity} where determined", *counts])
    if any(column.targets < column.shots for column in wide):
        rows.append(
            ["poses without a ring", *(f"{column.false_poses}/{column.shots - column.targets}" for column in wide)]
        )
    columns = [value_text(study.table, key[0]) if key else "all" for key in keys]
    return Table(headings=[f"{method}, root mean square", *columns], rows=rows)


def status_table(study: Study, summary: StudySummary) -> Table:
    """How many shots with a ring of each case have which status, and how many quantities are wrong."""
    place, total = summary.by.index(CASE) if CASE in summary.by else None, Counter[tuple[str, str, str]]()
    for (method, key), each in summary.cells.items():
        case = next(iter(study.cases)) if place is None else str(key[place])
        total[case, method, "ok"] += each.available
        total[case, method, "degraded"] += each.answers - each.available
        total[case, method, "none"] += each.targets - each.answers
        total[case, method, "wrong"] += each.wrong
        total[case, method, "ok and wrong"] += each.ok_wrong
    headings = ("ok", "degraded", "none", "wrong", "ok and wrong")
    rows = [
        [case, method, *(str(total[case, method, heading]) for heading in headings)]
        for case in study.cases
        for method in summary.methods
    ]
    return Table(headings=[CASE, "method", *headings], rows=rows)


def wide_columns(summary: StudySummary, method: str) -> tuple[list[Key], list[Statistics]]:
    """The values of the factor in the columns of the first table, and the statistics of a method for each of them.

    Without such a factor the only key is `()`, which stands for all shots.
    """
    keys = sorted_keys(key for name, key in summary.columns if name == method and key) or [()]
    return keys, [summary.columns[method, key] for key in keys]


HEADINGS = (
    "shots", "pose %", "center %", "grasp %", "ok %", "wrong", "center mm", "median", "bound", "ratio",
    "normal deg", "normal bound", "normal ratio", "r_out mm", "grasp mm", "center NEES", "normal NEES", "pose ms",
)  # fmt: skip


def cell_table(summary: StudySummary, shown: Sequence[str]) -> Table:
    """A table of all cells and methods as text, with the columns `shown` (of `HEADINGS`)."""
    rows = []
    for key in sorted_keys(key for _, key in summary.cells):
        for method in summary.methods:
            if (method, key) in summary.cells:
                cells = dict(zip(HEADINGS, _statistics_cells(summary.cells[method, key]), strict=True))
                values = [value_text(name, value) for name, value in zip(summary.by, key, strict=True)]
                rows.append([*values, method, *(cells[heading] for heading in shown)])
    return Table(headings=[*summary.by, "method", *shown], rows=rows)


def _statistics_cells(statistics: Statistics) -> list[str]:
    """The cells under `HEADINGS`."""
    return [
        str(statistics.shots),
        _percent(statistics.answers, statistics.targets),
        _percent(statistics.reported["center"], statistics.determined["center"]),
        _percent(statistics.reported["grasp"], statistics.determined["grasp"]),
        _percent(statistics.available, statistics.targets),
        f"{statistics.wrong}/{statistics.judged}" if statistics.judged else ABSENT,
        number(statistics.rms("center_m") * 1e3),
        number(statistics.median("center_m") * 1e3),
        number(statistics.rms("bound_center_m") * 1e3),
        number(statistics.rms("ratio_center_m")),
        number(degrees(statistics.rms("normal_rad"))),
        number(degrees(statistics.rms("bound_normal_rad"))),
        number(statistics.rms("ratio_normal_rad")),
        number(statistics.rms("radius_outer_m") * 1e3),
        number(statistics.rms("grasp_m") * 1e3),
        number(statistics.mean("center_nees")),
        number(statistics.mean("normal_nees")),
        number(statistics.median("pose_s") * 1e3),
    ]


def failure_rows(summary: StudySummary) -> list[list[str]]:
    """For each method, the reasons why shots have no pose, with the number of shots, the most frequent first."""
    return [
        [method, str(count), reason]
        for method in summary.methods
        for reason, count in summary.all(method).reasons.most_common()
    ]


def exceeded_limits(study: Study, summary: StudySummary) -> list[str]:
    """A message for each limit that the first method misses in a cell, or that applies to nothing."""
    method, exceeded = summary.methods[0], []
    for name, stated in study.limits.items():
        what, applies = LIMITS[name], False
        for (of_method, key), each in summary.cells.items():
            limit = _limit_in(stated, summary, key)
            if of_method != method or limit is None:
                continue
            value = _limited(each, what)
            applies = applies or value == value
            place = ", ".join(f"{by} {value_text(by, v)}" for by, v in zip(summary.by, key, strict=True)) or "all shots"
            if value < limit if name.startswith("min_") else value > limit:
                relation = "is below" if name.startswith("min_") else "exceeds"
                exceeded.append(f"{name}: {what} {value:.4g} of {place} ({method}) {relation} {limit:.4g}")
        if not applies:
            exceeded.append(f"{name}: no shot of {method} has {what}, limit {stated}")
    failed = summary.all(method).failed
    return [*exceeded, *([f"{failed} shots could not be computed"] if failed else [])]


def _limit_in(stated: float | Mapping[str, float], summary: StudySummary, key: Key) -> float | None:
    """The limit in a cell; None if it is stated for other cases only."""
    if not isinstance(stated, Mapping):
        return stated
    case = str(key[summary.by.index(CASE)]) if CASE in summary.by else next(iter(stated), "")
    return stated.get(case)


def _limited(statistics: Statistics, what: str) -> float:
    if what == "available":
        return statistics.available / statistics.targets if statistics.targets else nan
    if what == "no_pose":
        return 1.0 - statistics.answers / statistics.targets if statistics.targets else nan
    if what == "ok_wrong":
        return statistics.ok_wrong / statistics.shots if statistics.shots else nan
    return float(statistics.wrong) if what == "wrong" else statistics.rms(what)


def sorted_keys(keys: Iterable[Key]) -> list[Key]:
    """The keys sorted: numbers by value, texts in the order of their first occurrence."""
    every = list(dict.fromkeys(keys))
    texts = list(dict.fromkeys(part for key in every for part in key if isinstance(part, str)))
    return sorted(every, key=lambda key: [texts.index(part) if isinstance(part, str) else part for part in key])


def value_text(name: str, value: Value) -> str:
    """A factor's value for a heading: distances in millimetres, angles and rates in degrees."""
    if isinstance(value, str | bool):
        return str(value).lower() if isinstance(value, bool) else value
    if name.endswith("_m"):
        return f"{1e3 * value:g} mm"
    if name.endswith("_rad_s"):
        return f"{degrees(value):.4g} deg/s"
    return f"{degrees(value):.4g} deg" if name.endswith("_rad") else f"{value:g}"


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.4g}" if whole else ABSENT


def worst_shots(rows: Iterable[Row], method: str, count: int) -> list[int]:
    """Indices of the shots with the largest errors of a method; those without a pose come first.

    The error is that of the centre, or of the grasp point where a pose has no centre that could be compared.
    """
    ranked: list[tuple[float, int]] = []
    for row in rows:
        if row["method"] == method and row["expect"] in ("pose", "partial"):
            _, error = _compared(row)
            ranked.append((error, int(row["shot"] or 0)))
            if len(ranked) > 2 * count + 1000:
                ranked = sorted(ranked, reverse=True)[:count]
    return [index for _, index in sorted(ranked, reverse=True)[:count]]


def finding(row: Row) -> str:
    """What a method found in a shot, in words: the error by which it is ranked among the worst, or why it has none."""
    if row["status"] == "none":
        return f"no pose: {row['reason']}"
    quantity, error = _compared(row)
    return f"{quantity} error {1e3 * error:.3g} mm" if quantity else "a pose without centre and grasp point"


def _compared(row: Row) -> tuple[str, float]:
    """The point that is compared, and its error in metres; infinite without a pose, 0 for one without these points."""
    if row["status"] == "none":
        return "", inf
    for quantity, name in (("centre", "center_m"), ("grasp point", "grasp_m")):
        if (error := row[name]) is not None:
            return quantity, float(error)
    return "", 0.0
