"""The page that `ringpose bench design --report` writes: maps of the bounds, curves, and a sketch of each rig."""

from collections.abc import Mapping, Sequence
from math import degrees
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter

from ringpose.bench.design.maps import MEDIANS_NOTE, Design, median_table, summary_lines
from ringpose.report.figures import canvas, drawn, png_of
from ringpose.report.page import Picture, Section, page
from ringpose.types.arrays import Array, Float64
from ringpose.types.rig import Rig

MAX_MAPS = 12
"""Maximum number of rigs of which maps are drawn: the best ones and the references."""

UNITS = {
    "center_m": ("centre, radius unknown", 1e3, "mm"),
    "center_known_m": ("centre, radius known", 1e3, "mm"),
    "normal_rad": ("normal", degrees(1), "deg"),
    "grasp_m": ("grasp point", 1e3, "mm"),
    "radius_outer_m": ("outer radius", 1e3, "mm"),
}


def design_report(
    mapped: Sequence[Design], chosen: Design | None, quantity: str, min_coverage: float, provenance: Mapping[str, Any]
) -> str:
    """HTML page: what was chosen, tables, maps, curves and sketches.

    `min_coverage`: share of the places with all stripes in view, below which a rig was not chosen.
    """
    shown = _shown(mapped, chosen, quantity)
    label = UNITS[quantity][0]
    sections = [
        Section(
            title="Result",
            text=[
                f"Best by the median standard deviation of the {label} over all places, of the rigs with all stripes "
                f"in view at {100 * min_coverage:g} % of them: {chosen.name}."
                if chosen is not None
                else f"No rig has all stripes in view at {100 * min_coverage:g} % of the places.",
                "All values are Cramér-Rao bounds: the smallest standard deviations of an unbiased estimator, with the "
                "noise of the simulated sensor, the covariance of the calibration and the rig's stability.",
            ],
            pictures=[_curves(shown), _sketches(shown)],
        ),
        Section(
            title="Maps", pictures=[_maps(shown, name) for name in dict.fromkeys((quantity, "normal_rad", "grasp_m"))]
        ),
        Section(title="Fields of view and stripes", points=summary_lines(mapped)),
        Section(title="Medians by distance", text=[MEDIANS_NOTE], table=median_table(mapped)),
        Section(title="Provenance", text=[f"{key}: {value}" for key, value in provenance.items()]),
    ]
    return page("Rig design", sections)


def _shown(mapped: Sequence[Design], chosen: Design | None, quantity: str) -> list[Design]:
    """The given rig, the best ones, and the references."""
    references = [design for design in mapped if design.reference]
    others = sorted(
        (design for design in mapped[1:] if not design.reference),
        key=lambda design: (design is not chosen, design.median(quantity)),
    )
    return [mapped[0], *others[: MAX_MAPS - 1 - len(references)], *references]


def _curves(shown: Sequence[Design]) -> Picture:
    """Median standard deviations against distance, a line for each rig."""
    figure = canvas(11, 8)
    names = ("center_m", "center_known_m", "normal_rad", "grasp_m")
    for axis, name in zip(figure.subplots(2, 2).ravel(), names, strict=True):
        label, factor, unit = UNITS[name]
        for number, design in enumerate(shown):
            distances_m = sorted({result.place.distance_m for result in design.results})
            median = np.array([factor * design.median(name, distance_m) for distance_m in distances_m])
            median[~np.isfinite(median)] = np.nan
            style = "--" if design.reference else "-"
            axis.plot(1e3 * np.array(distances_m), median, f"{style}o", color=f"C{number % 10}", markersize=3)
        axis.set_yscale("log")
        for ticks in (axis.yaxis.set_major_formatter, axis.yaxis.set_minor_formatter):
            ticks(FuncFormatter(_tick))
        axis.set_title(label, fontsize=10)
        axis.set_ylabel(f"standard deviation ({unit})")
        axis.set_xlabel("distance (mm)")
        axis.grid(alpha=0.3, which="both")
    labels = [_name(design) for design in shown]
    figure.legend(list(figure.axes[0].get_lines()), labels, loc="outside upper center", ncols=3, fontsize=8)
    caption = (
        "Median over the places of a distance; dashed: the angles of the paper's rigs. A line ends where the quantity "
        "is not determined at most places."
    )
    return Picture(png=png_of(figure), caption=caption)


def _name(design: Design) -> str:
    return drawn(design.name.replace("+-", "±"))


def _tick(value: float, _: object) -> str:
    """Labels at 1, 2 and 5 times powers of ten."""
    digit = value / 10.0 ** np.floor(np.log10(value))
    return f"{value:g}" if min(abs(digit - each) for each in (1, 2, 5)) < 1e-6 else ""


def _subplots(shown: Sequence[Design], height_in: float, margin_in: float) -> tuple[Figure, list[Axes]]:
    """A figure with axes for each rig, three in a row, which share their scales."""
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    figure = canvas(11, margin_in + height_in * rows)
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel().tolist()
    for axis, design in zip(axes, shown, strict=False):
        axis.set_title(_name(design), fontsize=9)
    for axis in axes[len(shown) :]:
        axis.set_visible(False)
    return figure, axes[: len(shown)]


def _maps(shown: Sequence[Design], quantity: str) -> Picture:
    """A map of one quantity for each rig, over distance and offset."""
    label, factor, unit = UNITS[quantity]
    figure, axes = _subplots(shown, 2.7, 1.1)
    values = factor * np.array([[result.sd[quantity] for result in design.results] for design in shown])
    finite = values[np.isfinite(values)]
    norm = LogNorm(float(finite.min()), float(finite.max())) if len(finite) and finite.min() < finite.max() else None
    for axis, design, of_places in zip(axes, shown, values, strict=True):
        mesh = _map(axis, design, of_places, norm, quantity)
    figure.supxlabel("offset from the image centre (image widths)", fontsize=9)
    figure.supylabel("distance (mm)", fontsize=9)
    bar = figure.colorbar(mesh, ax=axes, label=f"{label} ({unit})")
    for ticks in (bar.ax.yaxis.set_major_formatter, bar.ax.yaxis.set_minor_formatter):
        ticks(FuncFormatter(_tick))
    caption = (
        f"Standard deviation of the {label} ({unit}). Hatched: errors are larger than the bound, since the pose is "
        "flagged as weak in this quantity, or light of the same laser beyond a stripe hides its end. Grey: "
        "not determined. Numbers: stripes in view, where not all are."
    )
    return Picture(png=png_of(figure), caption=caption)


def _map(axis: Axes, design: Design, values: Float64[Array, "place"], norm: LogNorm | None, quantity: str) -> Any:
    """Draw a map; its places are a grid, row after row (`ringpose.bench.design.maps.places`)."""
    distances_m = sorted({result.place.distance_m for result in design.results})
    offsets = sorted({result.place.offset_x for result in design.results})
    axis.set_facecolor("0.85")
    grid = np.ma.masked_invalid(values.reshape(len(distances_m), len(offsets)))
    mesh = axis.pcolormesh(grid, norm=norm, cmap="viridis_r")
    for number, result in enumerate(design.results):
        row, column = divmod(number, len(offsets))
        if result.above_bound(quantity):
            dark = norm is not None and np.ma.filled(norm(values[number]), 0.0) > 0.5
            edge = "0.9" if dark else "0.3"
            axis.add_patch(Rectangle((column, row), 1, 1, fill=False, hatch="////", edgecolor=edge, linewidth=0))
        if result.stripes < len(design.rig.lasers.names):
            box = {"boxstyle": "circle,pad=0.15", "facecolor": "white", "edgecolor": "none"}
            axis.text(column + 0.5, row + 0.5, str(result.stripes), ha="center", va="center", fontsize=8, bbox=box)
    axis.set_xticks(np.arange(len(offsets)) + 0.5, [f"{offset:g}" for offset in offsets], fontsize=8)
    axis.set_yticks(np.arange(len(distances_m)) + 0.5, [f"{1e3 * each:.0f}" for each in distances_m], fontsize=8)
    return mesh


def _sketches(shown: Sequence[Design]) -> Picture:
    """Side view of each rig: the field of view and the light planes."""
    figure, axes = _subplots(shown, 2.2, 0.6)
    for axis, design in zip(axes, shown, strict=True):
        draw_side_view(axis, design.rig, max(result.place.distance_m for result in design.results))
        axis.tick_params(labelsize=8)
    figure.supxlabel("distance z (mm)", fontsize=9)
    figure.supylabel("y (mm), down", fontsize=9)
    return Picture(png=png_of(figure), caption="Side view of the rigs: field of view (grey) and light planes.")


def draw_side_view(axis: Axes, rig: Rig, farthest_m: float) -> None:
    """The field of view and the light planes of a rig, up to a little beyond a distance; y points down."""
    z = np.array([0.0, 1.1 * farthest_m])
    camera, lasers = rig.camera, rig.lasers
    above = camera.camera_matrix[1, 2] / camera.camera_matrix[1, 1]
    below = (camera.image_height - 1 - camera.camera_matrix[1, 2]) / camera.camera_matrix[1, 1]
    axis.fill_between(1e3 * z, -1e3 * above * z, 1e3 * below * z, color="0.92", label="field of view")
    for laser, name in enumerate(lasers.names):
        along = np.array([max(float(np.nan_to_num(lasers.projector_m[laser, 2])), 0.0), z[1]])
        heights = (lasers.distance_m[laser] - lasers.normal[laser, 2] * along) / lasers.normal[laser, 1]
        axis.plot(1e3 * along, 1e3 * heights, linewidth=1.2, label=f"light plane {drawn(name)}")
    if not axis.yaxis_inverted():  # shared axes are inverted once
        axis.invert_yaxis()
