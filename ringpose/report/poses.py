"""The page that `ringpose pose --report` writes: time series with standard deviations, and the worst shots."""

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from ringpose.estimate.covariance import standard_deviation
from ringpose.report.figures import canvas, png_of
from ringpose.report.page import Picture, Section, page
from ringpose.report.pose_table import NUMBERS, limits_of, numbers_of
from ringpose.types.arrays import Array, Float64
from ringpose.types.pose import PoseLine, RingPose, Status
from ringpose.types.table import Table

STATUS_COLORS: dict[Status, str] = {"ok": "#2a7d3b", "degraded": "#c77f00", "none": "#c0392b"}

NUMBER = "number of the shot"

Values = Callable[[RingPose], tuple[Float64[Array, "part"], Float64[Array, "part"]]]
"""Values and standard deviations of one quantity, NaN where not determined."""


def pose_report(lines: Sequence[PoseLine], worst: Sequence[Picture], title: str, about: Sequence[str]) -> str:
    """A self-contained HTML page of all pose lines, in order; `worst` are pictures of the worst shots.

    `about` states what they were measured with.
    """
    sections = [Section(title="Measurement", text=about), _status_section(lines), _shots_section(lines)]
    sections += [
        Section(title=name, pictures=[_series_picture(lines, parts, unit, values, caption)])
        for name, parts, unit, values, caption in QUANTITIES
    ]
    if any(line.budget for line in lines):
        sections.append(_budget_section(lines))
    if worst:
        text = "Without a pose first, then degraded ones, each by the standard deviation of the grasp point."
        sections.insert(3, Section(title="Worst shots", text=[text], pictures=worst))
    return page(title, sections)


def _budget_section(lines: Sequence[PoseLine]) -> Section:
    """The median share of each source in the variance of each quantity, and the standard deviation of all."""
    budgets = [line.budget for line in lines if line.budget]
    names = list(dict.fromkeys(name for budget in budgets for name in budget))
    sources = list(dict.fromkeys(source for budget in budgets for of in budget.values() for source in of))
    rows = []
    for name in names:
        known = [budget[name] for budget in budgets if name in budget]
        total = np.array([sum(of.values()) for of in known])
        shares = [np.median(np.array([of.get(source, 0.0) for of in known]) / total) for source in sources]
        unit, factor = ("deg", np.degrees(1.0)) if name.endswith("rad2") else ("mm", 1e3)
        sd = f"{factor * float(np.median(np.sqrt(total))):.3g} {unit}"
        rows.append([name.rsplit("_", 1)[0].replace("_", " "), sd, *(f"{100 * share:.1f}" for share in shares)])
    headings = ("quantity", "standard deviation", *(f"{source.replace('_', ' ')} %" for source in sources))
    text = [f"Medians of {len(budgets)} shots: the share of each source in the variance."]
    return Section(title="Error budget", text=text, table=Table(headings=headings, rows=rows))


MAX_ROWS = 1000
"""Rows of the table of shots; a page with more is slow to scroll."""


def _shots_section(lines: Sequence[PoseLine]) -> Section:
    """Each shot by name, in millimetres and degrees; of very many, those that are not `ok`."""
    shown = lines if len(lines) <= MAX_ROWS else [line for line in lines if line.status != "ok"][:MAX_ROWS]
    numbers = {line.shot: [] if line.pose is None else numbers_of(line.pose) for line in shown}
    blank = [""] * len(NUMBERS)
    rows = [[line.shot, line.status, *(numbers[line.shot] or blank), limits_of(line)] for line in shown]
    text = (
        [f"Grasp point in mm and normal in degrees, {lines[0].frame} frame, with standard deviations."] if lines else []
    )
    if len(shown) < len(lines):
        text.append(f"{len(shown)} of {len(lines)} shots: those that are degraded or have no pose.")
    headings = ("shot", "status", *NUMBERS, "flags and reason")
    return Section(title="Shots", text=text, table=Table(headings=headings, rows=rows))


def badness(line: PoseLine) -> tuple[int, float]:
    """Sort key, the worst shot last: without a pose, degraded, then by the standard deviation of the grasp point."""
    if line.pose is None:
        return 2, np.inf
    covariance = line.pose.covariance_grasp_m2
    return int(line.status == "degraded"), np.inf if covariance is None else standard_deviation(covariance)


def _status_section(lines: Sequence[PoseLine]) -> Section:
    counts = Counter(line.status for line in lines)
    flags = Counter(name for line in lines for name in line.flag_names)
    reasons = Counter(line.reason for line in lines if line.pose is None and line.reason)
    rows = [[f"status {status}", str(counts[status])] for status in STATUS_COLORS]
    rows += [[f"flag {name}", str(count)] for name, count in flags.most_common()]
    rows += [[f"no pose: {reason}", str(count)] for reason, count in reasons.most_common()]
    dropped = sum(line.shots_dropped for line in lines)
    rows += [["shots dropped", str(dropped)]] if dropped else []
    return Section(
        title=f"Status of {len(lines)} shots",
        table=Table(headings=("", "shots"), rows=rows),
        pictures=[_status_picture(lines)] if lines else [],
    )


def _status_picture(lines: Sequence[PoseLine]) -> Picture:
    """A bar along time with the colour of each shot's status."""
    figure = canvas(10, 1.3)
    axes = figure.subplots()
    place, label = _abscissa(lines)
    for status, color in STATUS_COLORS.items():
        here = [x for x, line in zip(place, lines, strict=True) if line.status == status]
        axes.vlines(here, 0, 1, color=color, linewidth=max(1.0, min(6.0, 600 / max(len(lines), 1))), label=status)
    axes.set_yticks([])
    axes.set_xlabel(label)
    axes.xaxis.set_major_locator(MaxNLocator(integer=label == NUMBER))
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False)
    return Picture(png=png_of(figure), caption="Status of each shot.")


def _series_picture(
    lines: Sequence[PoseLine], parts: Sequence[str], unit: str, values: Values, caption: str
) -> Picture:
    """The parts of one quantity over time with error bars, enlarged so that they show; below, the deviations alone."""
    place, label = _abscissa(lines)
    nothing = np.full(len(parts), np.nan)
    values_and_sigmas = [(nothing, nothing) if line.pose is None else values(line.pose) for line in lines]
    value = np.array([each for each, _ in values_and_sigmas]).reshape(-1, len(parts))
    sigma = np.array([each for _, each in values_and_sigmas]).reshape(-1, len(parts))
    figure = canvas(10, 1.9 * len(parts) + 1.6)
    rows: list[Axes] = figure.subplots(len(parts) + 1, 1, sharex=True).tolist()
    for part, name in enumerate(parts):
        sigmas = _sigmas_to_show(value[:, part], sigma[:, part])
        for status, color in STATUS_COLORS.items():
            here = np.array([line.status == status for line in lines], dtype=bool) & np.isfinite(value[:, part])
            bars = {"yerr": np.nan_to_num(sigmas * sigma[here, part]), "elinewidth": 1.5, "capsize": 3}
            rows[part].errorbar(place[here], value[here, part], fmt=".", color=color, markersize=5, **bars)
        rows[part].set_ylabel(f"{name} ({unit})")
        rows[part].set_title(f"bars: {sigmas} sigma{'s' if sigmas > 1 else ''}", loc="right", fontsize="small")
        rows[-1].plot(place, sigma[:, part], ".", markersize=4, label=name)
    rows[-1].set_yscale("log")
    rows[-1].set_ylabel(f"sigma ({unit})")
    rows[-1].set_xlabel(label)
    rows[-1].xaxis.set_major_locator(MaxNLocator(integer=label == NUMBER))
    rows[-1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    return Picture(png=png_of(figure), caption=caption)


BAR_SHARE = 0.02
"""Least half length of the median error bar, as a share of the range of the values: a few pixels."""


def _sigmas_to_show(values: Float64[Array, "shot"], sigma: Float64[Array, "shot"]) -> int:
    """Length of the error bars in standard deviations: the smallest power of ten that shows."""
    known = np.isfinite(values) & np.isfinite(sigma) & (sigma > 0)
    if not known.any():
        return 1
    ratio = BAR_SHARE * float(np.ptp(values[known])) / float(np.median(sigma[known]))
    return int(10 ** np.ceil(np.log10(ratio))) if ratio > 1 else 1


def _abscissa(lines: Sequence[PoseLine]) -> tuple[Float64[Array, "shot"], str]:
    """Time since the first shot, or the shot's number where the stamps do not increase."""
    stamp_s = np.array([line.stamp_s for line in lines], dtype=np.float64)
    if len(lines) > 1 and np.isfinite(stamp_s).all() and (np.diff(stamp_s) > 0).all():
        return stamp_s - stamp_s[0], "time since the first shot (s)"
    return np.arange(1, len(lines) + 1, dtype=np.float64), NUMBER


def _sigmas(covariance: Float64[Array, "n n"] | None, chosen: slice) -> Float64[Array, "part"]:
    size = chosen.stop - chosen.start
    if covariance is None:
        return np.full(size, np.nan)
    variance = np.diagonal(covariance)[chosen]
    return np.sqrt(np.where(variance >= 0, variance, np.nan))


def _point(name: str, pose: RingPose) -> tuple[Float64[Array, "part"], Float64[Array, "part"]]:
    covariance_m2 = getattr(pose, f"covariance_{name}_m2")
    return 1e3 * getattr(pose, f"{name}_m"), 1e3 * _sigmas(covariance_m2, slice(0, 3))


def _radii(pose: RingPose) -> tuple[Float64[Array, "part"], Float64[Array, "part"]]:
    return 1e3 * np.array([pose.radius_inner_m, pose.radius_outer_m]), 1e3 * _sigmas(pose.covariance, slice(5, 7))


def _angles(pose: RingPose) -> tuple[Float64[Array, "part"], Float64[Array, "part"]]:
    """Pitch and yaw; both with the larger standard deviation of the normal in any direction."""
    tilts = np.full((2, 2), np.nan) if pose.covariance is None else pose.covariance[:2, :2]
    sigma_rad = standard_deviation(tilts) if np.isfinite(tilts).all() else np.nan
    return np.degrees([pose.pitch_rad, pose.yaw_rad]), np.full(2, np.degrees(sigma_rad))


QUANTITIES: tuple[tuple[str, tuple[str, ...], str, Values, str], ...] = (
    (
        "Grasp point",
        ("x", "y", "z"),
        "mm",
        partial(_point, "grasp"),
        "Grasp point, with error bars; colours as above.",
    ),
    ("Centre", ("x", "y", "z"), "mm", partial(_point, "center"), "Centre of the ring, with error bars."),
    (
        "Normal",
        ("pitch", "yaw"),
        "deg",
        _angles,
        "Pitch and yaw of the normal; the standard deviation is that of the normal in its least certain direction.",
    ),
    ("Radii", ("inner", "outer"), "mm", _radii, "Radii of the ring's edges, with error bars."),
)
"""Title, parts, unit, values and caption of each figure."""
