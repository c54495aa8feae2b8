"""The page that `ringpose bench study --report` writes."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import degrees, sqrt
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullFormatter

from ringpose.bench.design.report import draw_side_view
from ringpose.bench.integrity import ALERT_LIMIT_M, ALERT_LIMIT_RAD, integrity_table, levels_in
from ringpose.bench.score import Level
from ringpose.bench.study.table import (
    Key,
    StudySummary,
    cell_table,
    factor_text,
    failure_rows,
    occurring_text,
    paper_table,
    value_text,
    violation_lines,
    wide_columns,
)
from ringpose.bench.table import number
from ringpose.report.figures import canvas, drawn, png_of
from ringpose.report.page import Picture, Section, page
from ringpose.types.study import Row, Study
from ringpose.types.table import Table

MAX_POINTS = 4000
"""Maximum number of shots of each method in a scatter plot; of more, every n-th is drawn."""

BINS = 8
"""Bins of the reported standard deviation, with equally many shots."""

ERROR_PLOTS = (
    ("center_m", "centre error (mm)", 1e3),
    ("normal_rad", "normal error (deg)", degrees(1)),
    ("grasp_m", "grasp point error (mm)", 1e3),
)

NEES_DOF = {"center_nees": 3, "normal_nees": 2}

Rows = Callable[[], Iterable[Row]]


def study_report(
    study: Study, summary: StudySummary, rows: Rows, overlays: Sequence[Picture], provenance: Mapping[str, Any]
) -> str:
    """HTML page: charts of errors and consistency, set-up, failures with the worst shots, tables, times, provenance."""
    columns = _columns(study, rows())
    sections = [
        Section(title="Errors beside their Cramér-Rao bounds", pictures=[_errors(summary), _scatter(study, columns)]),
        Section(title="Consistency of the reported covariances", pictures=[_nees(summary), *_reliability(columns)]),
        *_integrity(study, summary, rows),
        Section(
            title="Set-up",
            text=[_set_up_text(study), "Methods: " + ", ".join(summary.methods) + "."],
            pictures=[_sketch(study, columns)],
        ),
        Section(title="Failures", table=_failures(summary), pictures=overlays),
        Section(title="Errors in the form of the paper's tables", table=_paper_table(study, summary)),
        Section(title="Errors and bounds in each cell", table=_cells_table(summary, ERRORS_SHOWN)),
        Section(title="Availability and consistency in each cell", table=_cells_table(summary, CONSISTENCY_SHOWN)),
        Section(title="Time by stage", table=_times(study, summary)),
        Section(title="Provenance", text=[f"{key}: {_plain(value)}" for key, value in provenance.items()]),
    ]
    return page(study.title, sections)


def _plain(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {each}" for key, each in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def _set_up_text(study: Study) -> str:
    ring, level = study.scene.ring, "rendered images" if study.level == "images" else "features drawn from the model"
    shots = f"{study.shots} shots ({level}), {study.count} in each cell, seed {study.seed}"
    radii = f"ring with radii {1e3 * ring.radius_inner_m:g} and {1e3 * ring.radius_outer_m:g} mm"
    return "; ".join([shots, radii, *map(factor_text, study.factors), *violation_lines(study)]) + "."


# Integrity

STANFORD = (
    ("grasp_normal_m", "grasp point along the normal (mm)", 1e3, ALERT_LIMIT_M),
    ("grasp_radial_m", "grasp point across the face (mm)", 1e3, ALERT_LIMIT_M),
    ("normal_rad", "normal (deg)", degrees(1), ALERT_LIMIT_RAD),
)
"""The quantities with an alert limit, with label, factor and limit."""


def _integrity(study: Study, summary: StudySummary, rows: Rows) -> list[Section]:
    """The table of integrity and the Stanford diagrams of the first method; nothing in a study without levels."""
    if not any(max(each.leveled.values()) for each in summary.integrity.values()):
        return []
    stride, method = max(1, study.shots // MAX_POINTS), summary.methods[0]
    levels = [levels_in(row) for row in rows() if row["method"] == method and int(row["shot"] or 0) % stride == 0]
    table, pictures = integrity_table(summary.integrity, study.table), [stanford_diagram(levels)]
    return [Section(title="Integrity", text=occurring_text(study, summary), table=table, pictures=pictures)]


def stanford_diagram(levels: Sequence[Mapping[str, Level]]) -> Picture:
    """Protection levels against errors: below the diagonal an error is misleading, above the limit unavailable.

    Named after the university that introduced it for satellite navigation.
    """
    figure = canvas(11, 4)
    for axis, (name, label, factor, limit) in zip(figure.subplots(1, len(STANFORD)), STANFORD, strict=True):
        points = np.array([[each[name].error, each[name].level] for each in levels if name in each]).reshape(-1, 2)
        shown = factor * points[np.isfinite(points).all(axis=1)]
        is_misleading = shown[:, 0] > shown[:, 1]
        largest = max([4.0 * factor * limit, *shown.ravel().tolist()])
        for which, color in ((~is_misleading, "C0"), (is_misleading, "C3")):
            axis.plot(*np.maximum(shown[which], 1e-4 * largest).T, ".", color=color, markersize=3)
        axis.plot([1e-4 * largest, largest], [1e-4 * largest, largest], "k-", linewidth=1)
        axis.axhline(factor * limit, color="0.4", linestyle="--", linewidth=1)
        axis.set(xscale="log", yscale="log", xlabel=f"error: {label}", xlim=(1e-4 * largest, largest))
        axis.set_ylim(1e-4 * largest, largest)
        axis.set_title(f"{int(is_misleading.sum())} of {len(shown)} misleading", fontsize=9)
    figure.axes[0].set_ylabel("protection level")
    caption = "Stanford diagram: below the diagonal an error is misleading, above the dashed alert limit unavailable."
    return Picture(png=png_of(figure), caption=caption)


# Data of the plots


def _columns(study: Study, rows: Iterable[Row]) -> dict[str, dict[str, np.ndarray]]:
    """For each method: distance, error, bound, and reported standard deviation of the centre; NaN for missing ones."""
    stride = max(1, study.shots // MAX_POINTS)
    names = ("distance_m", "center_m", "bound_center_m", "sigma_center_m")
    values_of: dict[str, list[list[float]]] = {method.value: [] for method in study.methods}
    for row in rows:
        if int(row["shot"] or 0) % stride == 0:
            values = [np.nan if (value := row.get(name)) is None else float(value) for name in names]
            values_of[str(row["method"])].append(values)
    columns = {method: np.array(values).reshape(-1, len(names)).T for method, values in values_of.items()}
    return {method: dict(zip(names, values, strict=True)) for method, values in columns.items()}


def _color(summary_methods: Sequence[str], method: str) -> str:
    return f"C{list(summary_methods).index(method) % 10}"


# Set-up


def _sketch(study: Study, columns: Mapping[str, Mapping[str, np.ndarray]]) -> Picture:
    """Side view of the rig, and how far the rings are."""
    distances = next(iter(columns.values()))["distance_m"]
    figure = canvas(10, 3.6)
    axis = figure.subplots()
    draw_side_view(axis, study.scene.rig, float(np.nanmax(distances)))
    for distance_m in np.unique(distances)[:: max(1, len(np.unique(distances)) // 12)]:
        axis.axvline(1e3 * float(distance_m), color="0.5", linestyle=":", linewidth=0.9)
    axis.plot([], [], color="0.5", linestyle=":", label="ring's face")
    axis.plot([0], [0], "k>", markersize=9, label="camera")
    axis.set_xlabel("distance z (mm)")
    axis.set_ylabel("y (mm), down")
    axis.legend(fontsize=8, ncols=3, loc="lower left")
    return Picture(png=png_of(figure), caption="Side view: field of view, light planes, and distances of the ring.")


# Tables


ERRORS_SHOWN = (
    "center mm", "median", "bound", "ratio", "normal deg", "normal bound", "normal ratio", "r_out mm", "grasp mm",
)  # fmt: skip
"""Columns of the first table by cells: root mean square errors, the median of the centre's, bounds and their ratios."""

CONSISTENCY_SHOWN = ("shots", "pose %", "center %", "grasp %", "ok %", "wrong", "center NEES", "normal NEES", "pose ms")


def _paper_table(study: Study, summary: StudySummary) -> Table:
    """Root mean square errors by components, a column for each value of the study's main factor."""
    tables = {method: paper_table(study, summary, method) for method in summary.methods}
    rows = [
        [method if number == 0 else "", *row]
        for method, table in tables.items()
        for number, row in enumerate(table.rows)
    ]
    values = list(tables.values())[-1].headings[1:]
    return Table(headings=("method", "root mean square", *values), rows=rows)


def _cells_table(summary: StudySummary, shown: Sequence[str]) -> Table:
    """A row for each cell and method; only the first row of a cell shows the values of its factors."""
    table, factors = cell_table(summary, shown), len(summary.by)
    rows = [list(row) for row in table.rows]
    repeated = [number > 0 and row[:factors] == rows[number - 1][:factors] for number, row in enumerate(rows)]
    rows = [[*([""] * factors), *row[factors:]] if again else row for row, again in zip(rows, repeated, strict=True)]
    return Table(headings=(*map(factor_name, summary.by), *table.headings[factors:]), rows=rows)


def factor_name(name: str) -> str:
    """The name of a factor without its unit, as a heading of values that state their unit."""
    return name.removesuffix("_m").removesuffix("_rad").replace("_", " ")


def _failures(summary: StudySummary) -> Table:
    rows = [
        [method, reason, count, f"{100 * int(count) / summary.all(method).shots:.3g} %"]
        for method, count, reason in failure_rows(summary)
    ] or [["-", "no shot without a pose", "0", ""]]
    return Table(headings=("method", "reason", "shots", "share"), rows=rows)


def _times(study: Study, summary: StudySummary) -> Table:
    rows = []
    for method in summary.methods:
        each = summary.all(method)
        stages = ["simulate_s", "detect_s", "pose_s"] if study.level == "images" else ["simulate_s", "pose_s"]
        for name in stages if method == summary.methods[0] else ["pose_s"]:
            values = np.array(each.values[name] if each.count(name) else [np.nan])
            middle, high = (number(1e3 * float(value)) for value in np.quantile(values, [0.5, 0.99]))
            stage = {"simulate_s": "simulation", "detect_s": "detection", "pose_s": f"pose, {method}"}[name]
            rows.append([stage, middle, high])
    return Table(headings=("stage", "median ms", "99 % ms"), rows=rows)


# Errors


def _errors(summary: StudySummary) -> Picture:
    """Root mean square errors of each method by the factor of the first table, with the bound."""
    figure = canvas(11, 4)
    for axis, (name, label, factor) in zip(figure.subplots(1, len(ERROR_PLOTS)), ERROR_PLOTS, strict=True):
        for place, method in enumerate(summary.methods):
            keys, wide = wide_columns(summary, method)
            values = np.array([factor * each.rms(name) for each in wide])
            x = _positions(keys, place, len(summary.methods))
            axis.plot(x, values, "o-" if _numeric(keys) else "o", color=_color(summary.methods, method), markersize=4)
        bounds = [summary.methods[0], *(method for method in summary.methods if method == "ml-known")]
        bounds = [method for method in bounds if summary.all(method).count("bound_center_m")]
        for method, style in zip(bounds, ("k--", "k:"), strict=False):
            keys, wide = wide_columns(summary, method)
            values = np.array([factor * each.rms(f"bound_{name}") for each in wide])
            if _numeric(keys):
                axis.plot(_positions(keys, 0, 1), values, style, linewidth=1.2)
            else:
                at = np.arange(len(keys))
                axis.hlines(values, at - 0.35, at + 0.35, colors="black", linestyles=style[1:], linewidth=1.2)
        axis.set_title(label, fontsize=10)
        axis.grid(alpha=0.3)
        _by_main_factor(axis, summary, _positions(keys, 0, 1) if _numeric(keys) else np.arange(len(keys)))
    bound_lines = [Line2D([], [], color="black", dashes=dashes) for dashes in ((4, 2), (1, 1))]
    named = dict(zip(("bound, radii unknown", "bound, radii known")[: len(bounds)], bound_lines, strict=False))
    _legend(figure, summary.methods, summary.methods, named)
    caption = (
        "Root mean square errors of the shots in which a method gives a pose, which differ between methods"
        f"{'; black: Cramér-Rao bound of centre and normal' if bounds else ''}."
    )
    return Picture(png=png_of(figure), caption=caption)


def _by_main_factor(axis: Axes, summary: StudySummary, at: np.ndarray) -> None:
    """A logarithmic axis of values beside the factor of the first table, whose values are at these places."""
    keys, _ = wide_columns(summary, summary.methods[0])
    axis.set_yscale("log")
    _plain_ticks(axis)
    axis.set_xlabel(drawn(factor_name(summary.table)))
    axis.set_xticks(at, [value_text(summary.table, key[0]) if key else "all" for key in keys])


def _legend(figure: Figure, methods: Sequence[str], shown: Sequence[str], others: Mapping[str, Line2D]) -> None:
    handles = {
        drawn(method): Line2D([], [], marker="o", linestyle="", color=_color(methods, method)) for method in shown
    }
    handles |= others
    figure.legend(list(handles.values()), list(handles), loc="outside upper center", ncols=6, fontsize=8)


def _numeric(keys: Sequence[Key]) -> bool:
    return all(key and isinstance(key[0], int | float) and not isinstance(key[0], bool) for key in keys)


def _positions(keys: Sequence[Key], place: int, count: int) -> np.ndarray:
    """Places of a factor's values on the axis; if the values are texts, the methods are placed side by side."""
    if _numeric(keys):
        return np.array([float(key[0]) for key in keys])
    return np.arange(len(keys)) + 0.5 * ((place + 0.5) / count - 0.5)


def _scatter(study: Study, columns: Mapping[str, Mapping[str, np.ndarray]]) -> Picture:
    """Centre errors of single shots against distance; at equal distances the methods are drawn side by side."""
    methods = list(columns)
    distance_m = columns[methods[0]]["distance_m"]
    steps = np.diff(np.unique(distance_m))
    width_m = 0.8 * float(steps.min()) if 0 < len(steps) < 20 else 0.0
    width_m = width_m or 0.1 * (1.0 if len(steps) == 0 else float(np.ptp(distance_m)) / 20)
    figure = canvas(11, 4.5)
    axis = figure.subplots()
    rng = np.random.default_rng(0)
    for place, method in enumerate(methods):
        share = (place + 0.5 + rng.uniform(-0.35, 0.35, len(columns[method]["distance_m"]))) / len(methods) - 0.5
        x, y = columns[method]["distance_m"] + width_m * share, columns[method]["center_m"]
        color, size = _color(methods, method), 7.0 if study.shots < 300 else 3.0
        axis.plot(1e3 * x, 1e3 * y, ".", markersize=size, color=color, alpha=0.6, label=drawn(method))
    bound_m = columns[methods[0]]["bound_center_m"]
    for each_m in np.unique(distance_m[np.isfinite(bound_m)]) if 0 < len(steps) < 20 else ():
        bound_mm = 1e3 * np.nanmedian(bound_m[distance_m == each_m])
        ends_mm = 1e3 * (each_m - width_m / 2), 1e3 * (each_m + width_m / 2)
        axis.hlines(bound_mm, *ends_mm, color="black", label="" if axis.collections else "bound, radii unknown")
    axis.set_yscale("log")
    axis.set_xlabel("distance (mm), methods side by side" if 0 < len(steps) < 20 else "distance (mm)")
    axis.set_ylabel("centre error (mm)")
    axis.grid(alpha=0.3, which="both")
    figure.legend(loc="outside upper center", ncols=5, fontsize=8, markerscale=2)
    return Picture(png=png_of(figure), caption="Each shot; black: median of the bounds for its places and lights.")


# Consistency


def _plain_ticks(axis: Axes) -> None:
    """Ticks such as 0.5 and 2 on a logarithmic axis of small range, instead of powers of ten."""
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    low, high = axis.get_ylim()
    digits = "23456789" if high < 4 * low else "25"
    minor = FuncFormatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in digits else "")
    axis.yaxis.set_minor_formatter(minor if high < 100 * low else NullFormatter())


def _nees(summary: StudySummary) -> Picture:
    """Mean NEES of each cell with the 99 % band of a correct covariance."""
    from scipy.stats import chi2

    figure = canvas(11, 3.8)
    for axis, (name, dof) in zip(figure.subplots(1, 2), NEES_DOF.items(), strict=True):
        shown = [method for method in summary.methods if summary.all(method).count(name)]
        for place, method in enumerate(shown):
            for at, cell in enumerate(wide_columns(summary, method)[1]):
                count = cell.count(name)
                if not count:
                    continue
                x = at + 0.6 * ((place + 0.5) / len(shown) - 0.5)
                low, high = (float(chi2.ppf(p, count * dof)) / (count * dof) for p in (0.005, 0.995))
                axis.plot([x, x], [low, high], color="0.75", linewidth=6, solid_capstyle="butt")
                axis.plot(x, cell.mean(name), "o", color=_color(summary.methods, method), markersize=5)
        axis.axhline(1.0, color="black", linewidth=0.7)
        axis.set_title(
            f"NEES of the {name.removesuffix('_nees').replace('center', 'centre')}, by degree of freedom", fontsize=10
        )
        axis.grid(alpha=0.3, axis="y", which="both")
        _by_main_factor(axis, summary, np.arange(len(wide_columns(summary, summary.methods[0])[0])))
    _legend(
        figure, summary.methods, [method for method in summary.methods if summary.all(method).count("center_nees")], {}
    )
    caption = (
        "Mean NEES of all poses, also flagged ones; grey: 99 % band of a correct covariance. Above: too small a "
        "covariance; below: too large."
    )
    return Picture(png=png_of(figure), caption=caption)


def _reliability(columns: Mapping[str, Mapping[str, np.ndarray]]) -> list[Picture]:
    """Actual against reported standard deviation of the centre, in bins of the reported one.

    Nothing is drawn for too few shots.
    """
    figure = canvas(6.5, 5)
    axis = figure.subplots()
    limits: list[float] = []
    for method, values in columns.items():
        x, y = _binned(values["sigma_center_m"], values["center_m"])
        if len(x):
            axis.plot(1e3 * x, 1e3 * y, "o-", color=_color(list(columns), method), markersize=4, label=drawn(method))
            limits += [float(1e3 * x.min()), float(1e3 * x.max())]
    if not limits:
        return []
    axis.plot([min(limits), max(limits)], [min(limits), max(limits)], color="black", linewidth=0.8)
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.legend(fontsize=8)
    axis.set_xlabel("reported standard deviation of the centre (mm)")
    axis.set_ylabel("root mean square centre error (mm)")
    axis.grid(alpha=0.3, which="both")
    return [Picture(png=png_of(figure), caption="Reliability: on the line, errors are as large as reported.")]


def _binned(sigma: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Root mean square reported and actual errors in bins of the reported one."""
    both = np.isfinite(sigma) & np.isfinite(error)
    order = np.argsort(sigma[both])
    if len(order) < 2 * BINS:
        return np.empty(0), np.empty(0)
    parts = np.array_split(order, BINS)
    x, y = (np.array([sqrt(float(np.mean(values[both][part] ** 2))) for part in parts]) for values in (sigma, error))
    return x, y
