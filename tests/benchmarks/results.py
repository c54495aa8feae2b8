"""Renew the generated tables of man/ringpose-results.7 and its charts: make results.

    python -m benchmarks.results [--output DIR] [--only NAME ...]

Every table is the result of commands that the page names: studies, and poses of the shared renders scored by
`ringpose bench`. DIR (default: build/results) keeps the results of the studies, which are resumed from there. It takes
about an hour on two cores, and for the captures three more.
"""

import argparse
import io
import json
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stdout
from math import degrees, nan
from pathlib import Path

import matplotlib as mpl
import numpy as np
from benchmarks.compare_baseline import ASSUMPTIONS, RENDERED
from benchmarks.compare_detectors import compare, peak_memory_mb
from benchmarks.opencv_detectors import DetectorName
from benchmarks.stripe_images import Kind, stripe_image, stripe_rig
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from ringpose.bench.capture.score import CaptureOutcome, CaptureStatistics, statistics_of
from ringpose.bench.integrity import integrity_table
from ringpose.bench.study.table import Statistics, StudySummary, sorted_keys, summarized, value_text
from ringpose.bench.table import number
from ringpose.cli.main import main as ringpose
from ringpose.files.records.captures import read_captures
from ringpose.files.studies.results import read_results
from ringpose.files.studies.specification import read_study, study_path
from ringpose.types.capture import CaptureLine

MANUAL = Path(__file__).parents[2] / "man"
PAGE = MANUAL / "ringpose-results.7"
CHART = MANUAL / "ringpose-results-distance.svg"

STILL = ("rig_a", "rig_b", "variants_a", "variants_b")
MOVING = ("moving_b",)

STUDIES = {
    "paper-lights": ("paper", "paper-detector", "paper-constrained", "ml", "ml-known"),
    "paper-synthetic": ("paper", "paper-constrained", "ml", "ml-known"),
    "calibrated": ("ml", "ml-known", "paper-constrained"),
    "tumbling": ("ml", "track"),
    "violations": ("ml",),
    "outliers": ("ml",),
}
"""The presets whose results the page shows, with the methods that stand in its tables."""

COUNTS = {"calibrated": 10, "integrity": 1000, "capture": 300}
"""Shots of each cell where the page does not take the preset's own number."""

DISTANCES_M = np.linspace(0.2, 1.0, 9)
"""Borders of the intervals of distance over which the chart takes medians."""


def main() -> None:
    """Compute what is missing, then write the page and its chart."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("build/results"))
    parser.add_argument("--only", nargs="+", choices=list(BLOCKS), default=list(BLOCKS), metavar="NAME")
    words = parser.parse_args()
    words.output.mkdir(parents=True, exist_ok=True)
    for name in words.only:
        lines = BLOCKS[name](words.output)
        PAGE.write_text(with_block(PAGE.read_text(), name, lines))


def with_block(text: str, name: str, lines: Sequence[str]) -> str:
    """The page with the lines between the marks of a generated table replaced."""
    marks = rf'(\.\\" generated: {name}\n).*?(\.\\" end of {name}\n)'
    block = "".join(f"{line}\n" for line in lines)
    changed, count = re.subn(marks, lambda found: found[1] + block + found[2], text, flags=re.DOTALL)
    if count != 1:
        raise SystemExit(f"{PAGE}: has no marks of the table {name}")
    return changed


def table(rows: Sequence[Sequence[str]], left: int = 1) -> Iterator[str]:
    """A table in tbl(1): the first row is the heading, the first columns (`left`) are text, the others are numbers."""
    sides = ["l"] * left + ["r"] * (len(rows[0]) - left)
    yield ".TS"
    yield " ".join(f"{side}b" for side in sides)
    yield " ".join(sides) + "."
    yield from ("\t".join(row) for row in rows)
    yield ".TE"


# Captures


def capture_block(preset: str, groups: Sequence[Sequence[str]]) -> Callable[[Path], list[str]]:
    """The block that makes the table of a preset of captures: a row for each value of single or combined groups."""

    def block(output: Path) -> list[str]:
        folder, count = output / preset, COUNTS.get(preset)
        words = [] if count is None else ["--count", str(count)]
        if (status := ringpose(["bench", "study", preset, "--output", str(folder), *words])) not in (0, 3):
            raise SystemExit(status)
        return capture_rows(list(read_captures(folder / "captures.jsonl")), groups)

    return block


def capture_rows(lines: Sequence[CaptureLine], groups: Sequence[Sequence[str]]) -> list[str]:
    """The rows by groups, and of all runs."""
    headings = ["runs", "captured", "missed", "open", "at least %", "error mm", "tilt deg", "time s", "claims"]
    rows = [["", *headings, "missed (most)"]]
    for by in (*groups, ()):
        for (_, key), each in sorted(statistics_of(lines, by).items(), key=lambda item: item[0]):
            name = ", ".join(map(capture_heading, by, key)) or "all"
            rows.append([name, *capture_cells(each)])
    return list(table(rows))


def capture_heading(group: str, text: str) -> str:
    """The name of a row."""
    names = {"floating_base": {"true": "floating base", "false": "fixed base"}}
    ends = {"lost_share": "shots lost: ", "latency_s": "latency (s): "}
    return names.get(group, {}).get(text) or f"{ends.get(group, '')}{text}"


def capture_cells(each: CaptureStatistics) -> list[str]:
    """The figures of a row; errors and times are medians of the closings.

    Last the closings with a claim above 0.95, how many of them missed, and how many may by chance.
    """
    counts = (CaptureOutcome.SUCCESS, CaptureOutcome.MISS, CaptureOutcome.NO_CLOSING)
    return [
        str(len(each.outcomes)),
        *(str(each.count(outcome)) for outcome in counts),
        number(100.0 * each.success_bound),
        number(1e3 * float(np.median(each.radial_m)) if each.radial_m else nan),
        number(degrees(np.median(each.tilt_rad)) if each.tilt_rad else nan),
        number(float(np.median(each.closed_s)) if each.closed_s else nan),
        str(len(each.claims)),
        f"{each.claimed_misses} ({each.most_misses})",
    ]


# Studies


def integrity_block(output: Path) -> list[str]:
    """The table of errors beyond their protection levels, by what is wrong."""
    return integrity_rows(study_summary("integrity", output))


def integrity_rows(summary: StudySummary) -> list[str]:
    """A row for each kind of fault, without the counts of single quantities."""
    made = integrity_table(summary.integrity, "wrong")
    shown = [0, 1, 2, 3, len(made.headings) - 2, len(made.headings) - 1]
    rows = [[str(row[column]) for column in shown] for row in (made.headings, *made.rows)]
    return list(table(rows, left=2))


def study_summary(preset: str, output: Path) -> StudySummary:
    """The statistics of a preset, which is computed or resumed first."""
    folder = output / preset
    count = COUNTS.get(preset)
    status = ringpose(["bench", "study", preset, "--output", str(folder), *(["--count", str(count)] if count else [])])
    if status not in (0, 3):  # 3: a limit is missed, which the table shows
        raise SystemExit(status)
    return summarized(read_study(study_path(preset), count), read_results(folder)[1])


def study_block(preset: str) -> Callable[[Path], list[str]]:
    """The table of a preset."""
    return lambda output: study_table(study_summary(preset, output), STUDIES[preset])


def study_table(summary: StudySummary, methods: Sequence[str]) -> list[str]:
    """A row for each method and cell of the grid: availability, errors (root mean square), bounds, wrong quantities."""
    headings = ["shots", "ok", "centre", "centre mm", "bound mm", "normal deg", "bound deg", "grasp mm", "wrong"]
    rows = [["method", *(name.split("_")[0] for name in summary.by), *headings]]
    for method in methods:
        for key in sorted_keys(key for name, key in summary.cells if name == method):
            values = [value_text(name, value) for name, value in zip(summary.by, key, strict=True)]
            rows.append([method, *values, *study_cells(summary.cells[method, key])])
    return list(table(rows, left=1 + len(summary.by)))


def study_cells(cell: Statistics) -> list[str]:
    """One method in one cell of the grid."""
    return [
        str(cell.shots),
        str(cell.available),
        str(cell.count("center_m")),
        number(1e3 * cell.rms("center_m")),
        number(1e3 * cell.rms("bound_center_m")),
        number(degrees(cell.rms("normal_rad"))),
        number(degrees(cell.rms("bound_normal_rad"))),
        number(1e3 * cell.rms("grasp_m")),
        f"{cell.wrong} of {cell.judged}",
    ]


def times_block(output: Path) -> list[str]:
    """Times of the methods by light, as ratios to that of `paper` in the dark."""
    summary = study_summary("paper-lights", output)
    lights = sorted_keys({key for _, key in summary.cells})
    unit_s = time_s(summary.cells["paper", lights[0]])
    rows = [["method", *(str(light) for (light,) in lights)]]
    for method in STUDIES["paper-lights"]:
        rows.append([method, *(f"{time_s(summary.cells[method, light]) / unit_s:.2f}" for light in lights)])
    return list(table(rows))


def time_s(cell: Statistics) -> float:
    """Median time from the shot in memory to its pose."""
    return cell.median("detect_s") + cell.median("pose_s")


def distance_chart(output: Path) -> list[str]:
    """Medians of the errors of `ml` over the distance in three lights, as a chart beside the page."""
    study_summary("paper-lights", output)
    rows = [row for row in read_results(output / "paper-lights")[1] if row["method"] == "ml"]
    mpl.rcParams["svg.hashsalt"] = "ringpose"  # the same chart has the same bytes
    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    axes = figure.subplots(1, 3)
    quantities = (
        ("grasp_m", 1e3, "grasp point, mm"),
        ("normal_rad", degrees(1), "normal, °"),
        ("center_m", 1e3, "centre, mm"),
    )
    for axis, (name, factor, title) in zip(axes, quantities, strict=True):
        for light, color in (("dim", "#1f2d4d"), ("normal", "#2a8a4a"), ("strong", "#d9822b")):
            axis.plot(*medians(rows, name, light, factor), "o-", color=color, label=light, markersize=3)
        axis.set(title=title, xlabel="distance, m", yscale="log")
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_locator(NullLocator())
        axis.grid(visible=True, alpha=0.25)
    axes[0].legend(frameon=False, fontsize="small")
    figure.savefig(CHART, metadata={"Date": None})
    return []


def medians(rows: Sequence[dict], name: str, light: str, factor: float) -> tuple[list[float], list[float]]:
    """Middle of each interval of distance, and the median error of the shots in it that have the quantity."""
    shots = [row for row in rows if row["light"] == light and row[name] is not None]
    interval = np.digitize([row["distance_m"] for row in shots], DISTANCES_M) - 1
    error = np.abs([row[name] for row in shots])
    seen = [i for i in range(len(DISTANCES_M) - 1) if (interval == i).any()]
    middle = 0.5 * (DISTANCES_M[:-1] + DISTANCES_M[1:])
    return [float(middle[i]) for i in seen], [factor * float(np.median(error[interval == i])) for i in seen]


# Renders of the other program


def bench_groups(output: Path, name: str, sets: Sequence[str], words: Sequence[str], by: str) -> list[dict]:
    """The groups of `ringpose bench --json` on the poses that `ringpose pose` gives with these words."""
    files = []
    for folder in (RENDERED / each for each in sets):
        files.append(output / f"{name}.{folder.name}.jsonl")
        files[-1].write_text(
            printed(["pose", str(folder / "shots"), "--rig", str(folder / "rig.yaml"), "--brief", *words])
        )
    truths = [word for each in sets for word in ("--truth", str(RENDERED / each / "truth.jsonl"))]
    result = output / f"{name}.json"
    printed(["bench", *map(str, files), *truths, "--by", by, "--json", str(result), "--force"])
    return json.loads(result.read_text())["groups"]


def printed(words: Sequence[str]) -> str:
    """What a command prints; shots without a pose are no failure."""
    with redirect_stdout(io.StringIO()) as stream:
        status = ringpose([*words, "--quiet"] if words[0] == "pose" else list(words))
    if status not in (0, 3):
        raise SystemExit(status)
    return stream.getvalue()


def rendered_block(output: Path) -> list[str]:
    """Median and largest errors of `ml`, by rig and distance."""
    rows = [["rig", "distance mm", "shots", "ok", "normal deg", "grasp mm", "centre mm", "wrong"]]
    for group in bench_groups(output, "still-ml", STILL, ASSUMPTIONS, "rig,distance_m"):
        wrong = f"{group['wrong']['count']} of {group['wrong']['judged']}"
        errors = [pair(group, "normal_rad", degrees(1)), pair(group, "grasp_m", 1e3), pair(group, "center_m", 1e3)]
        rows.append([*place_of(group), str(group["shots"]), str(group["available"]), *errors, wrong])
    return list(table(rows))


def papers_block(output: Path) -> list[str]:
    """The same of the paper's closed form, from our break points and from the pixels where its line detector ends."""
    rows = [["rig", "distance mm", "method", "poses", "normal deg", "grasp mm", "centre mm"]]
    methods = ("paper", "paper-detector")
    of_methods = [
        bench_groups(output, f"still-{method}", STILL, (*ASSUMPTIONS, "--method", method), "rig,distance_m")
        for method in methods
    ]
    for of_group in zip(*of_methods, strict=True):
        for method, group in zip(methods, of_group, strict=True):
            poses = (group["errors"].get("normal_rad") or {"count": 0})["count"]
            errors = [pair(group, "normal_rad", degrees(1)), pair(group, "grasp_m", 1e3), pair(group, "center_m", 1e3)]
            rows.append([*place_of(group), method, f"{poses} of {group['shots']}", *errors])
    return list(table(rows, left=3))


def place_of(group: dict) -> tuple[str, str]:
    """Rig and distance of a group; `all` for the one of all shots."""
    values = group["group"]
    return (values["rig"], f"{1e3 * values['distance_m']:g}") if values else ("all", "")


def pair(group: dict, name: str, factor: float) -> str:
    """Median and largest error."""
    errors = group["errors"].get(name) or {"count": 0}
    return f"{number(factor * errors['median'])} / {number(factor * errors['max'])}" if errors["count"] else "-"


def detectors_block(_: Path) -> list[str]:
    """Line detectors on one image each of stripes on black, with speckle, and before foil; memory before foil."""
    kinds = (Kind.DARK, Kind.SPECKLE, Kind.BRIGHT_FOIL)
    shown = (
        DetectorName.HOUGH, DetectorName.LSD, DetectorName.EDGE_DRAWING,
        DetectorName.LENGTH, DetectorName.REFINED, DetectorName.STRIPES,
    )  # fmt: skip
    images = {kind: [stripe_image(kind, seed, stripe_rig(lens=False)) for seed in range(3)] for kind in kinds}
    figures = {kind: compare(images[kind], rounds=5) for kind in kinds}
    rows = [["detector", *(f"{what}, {kind}" for what in ("time", "recall") for kind in kinds), "memory MB"]]
    for name in shown:
        times = [f"{figures[kind][name]['ratio']:.2f}" for kind in kinds]
        recalls = [f"{figures[kind][name]['recall']:.2f}" for kind in kinds]
        rows.append([str(name), *times, *recalls, f"{peak_memory_mb(name, images[Kind.BRIGHT_FOIL][0].image):.0f}"])
    return list(table(rows))


def assumptions_block(output: Path) -> list[str]:
    """What the assumptions of `ringpose pose` change, on targets at rest and in motion."""
    rows = [["shots", "assumed", "wrong", "ok", "normal deg", "grasp mm", "centre mm"]]
    cases = [
        ("at rest", STILL, "rig", "perfect ring at rest, unchanged rig", ASSUMPTIONS),
        ("at rest", STILL, "rig", "--still", ("--still",)),
        ("at rest", STILL, "rig", "the defaults", ()),
        ("moving", MOVING, "motion", "perfect ring at rest, unchanged rig", ASSUMPTIONS),
        ("moving", MOVING, "motion", "the defaults", ()),
    ]
    for case, (title, sets, by, assumed, words) in enumerate(cases):
        group = bench_groups(output, f"assumed-{case}", sets, words, by)[-1]  # of all shots
        wrong = f"{group['wrong']['count']} of {group['wrong']['judged']}"
        errors = [
            (group["errors"].get(name) or {}).get("median", nan) for name in ("normal_rad", "grasp_m", "center_m")
        ]
        cells = [number(factor * error) for factor, error in zip((degrees(1), 1e3, 1e3), errors, strict=True)]
        rows.append([f"{group['shots']} {title}", assumed, wrong, str(group["available"]), *cells])
    return list(table(rows, left=2))


BLOCKS: dict[str, Callable[[Path], list[str]]] = {
    "rendered": rendered_block,
    "papers": papers_block,
    "assumptions": assumptions_block,
    "times": times_block,
    "chart": distance_chart,
    "detectors": detectors_block,
    "capture-lights": capture_block("capture-lights", [("light", "floating_base")]),
    "capture": capture_block(
        "capture", [("target_rate_rad_s",), ("light",), ("floating_base",), ("lost_share",), ("latency_s",)]
    ),
    **{preset: study_block(preset) for preset in STUDIES},
    "integrity": integrity_block,
}
"""The generated parts of the page by their names in its marks."""

if __name__ == "__main__":
    main()
