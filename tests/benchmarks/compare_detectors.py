"""Speed and accuracy of line detectors on the same images: those of OpenCV, those of ringpose, and its detection chain.

    PYTHONPATH=tests python -m benchmarks.compare_detectors [--kind KIND] [--seeds N] [--rounds N] [IMAGE ...]

Images are synthetic stripes with truth (`stripe_images`), or photographs; those have true lines if `--lines FOLDER`
holds a NAME.csv with x1, y1, x2, y2 for each. Times are processor times on one core.
"""

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from benchmarks.detection_errors import WRONG_PX, break_point_errors
from benchmarks.limits import number
from benchmarks.opencv_detectors import GIVES_CENTERS, DetectorName, detector
from benchmarks.robust_statistics import joined, mean, median, rms, robust_sd
from benchmarks.segment_errors import COVERED, length_px, length_recalled_px, stripe_errors
from benchmarks.stripe_images import Kind, StripeImage, shot_of, stripe_image, stripe_rig

from ringpose.bench.speed import median_times_s, one_core
from ringpose.bench.table import aligned
from ringpose.detect.pipeline import detect
from ringpose.types.arrays import Array, Float64, UInt8
from ringpose.types.detection import BreakPoints, Segments

CHAIN = "ringpose detect"
"""From the image to break points, without the edges of the ring between them; only where the rig is given."""

LINE_DISTANCES_PX = (1.5, 3.0)
"""Maximum distances of a segment from an annotated line that it covers."""

STRIPE_COLUMNS = {
    "recall": ("recall", ".2f"),
    "fragments": ("pieces", ".1f"),
    "center_rms_px": ("center px", ".4f"),
    "end_bias_px": ("end bias px", ".3f"),
    "end_sd_px": ("end sd px", ".3f"),
    "false": ("false", ".1f"),
}
"""Heading and format of the figures that need stripes with truth."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BenchmarkImage:
    """An image with its truth, if there is one."""

    image: UInt8[Array, "row column"]
    stripes: StripeImage | None = None
    lines_px: Float64[Array, "line end=2 xy=2"] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectorFigures:
    """One detector on a group of images; figures are NaN without truth or without detections."""

    detector: str
    time_s: float
    """Processor time per image: the mean over the images of the median of each."""
    ratio: float
    """`time_s` divided by that of EdgeDrawing."""
    segments: float
    """Per image."""
    recall: float = math.nan
    """Share of the pieces of stripes that are covered; for the chain, of break points that are found."""
    fragments: float = math.nan
    """Segments on each line of a piece."""
    center_rms_px: float = math.nan
    """RMS error of the centre line; for the chain, robust standard deviation of break points across the stripe."""
    end_bias_px: float = math.nan
    """Median distance by which ends stop short of the true ones."""
    end_sd_px: float = math.nan
    """Robust standard deviation of the same."""
    false: float = math.nan
    """Per image: segments on no stripe; for the chain, break points off by more than `WRONG_PX` without a flag."""
    length_recall: dict[str, float] = field(default_factory=dict)
    """Share of the length of the annotated lines that is covered, by the maximum distance in pixels."""


def compare(images: Sequence[BenchmarkImage], rounds: int) -> list[DetectorFigures]:
    """Figures of each detector; all of them run on the same images in turns, on one core."""
    times = {str(name): 0.0 for name in (*DetectorName, CHAIN)}
    with one_core():
        for image in images:
            calls: dict[str, Callable[[], object]] = {
                str(name): partial(detector(name), image.image) for name in DetectorName
            }
            if image.stripes is not None:
                calls[CHAIN] = partial(detect, shot_of(image.stripes), image.stripes.rig, edges=False)
            for name, time_s in median_times_s(calls, rounds).items():
                times[name] += time_s / len(images)
        figures = [_detector_figures(name, images, times) for name in DetectorName]
        with_truth = [image.stripes for image in images if image.stripes is not None]
        return [*figures, _chain_figures(with_truth, times)] if with_truth else figures


def _detector_figures(name: DetectorName, images: Sequence[BenchmarkImage], times: dict[str, float]) -> DetectorFigures:
    found = [detector(name)(image.image) for image in images]
    return DetectorFigures(
        detector=name.value,
        time_s=times[name],
        ratio=times[name] / times[DetectorName.EDGE_DRAWING],
        segments=sum(len(segments.support) for segments in found) / len(images),
        **_stripe_figures(name, found, images),
        length_recall=_length_recall(found, images),
    )


def _stripe_figures(
    name: DetectorName, found: Sequence[Segments], images: Sequence[BenchmarkImage]
) -> dict[str, float]:
    parts = [
        stripe_errors(segments, image.stripes, name in GIVES_CENTERS)
        for segments, image in zip(found, images, strict=True)
        if image.stripes is not None
    ]
    if not parts:
        return {}
    errors = joined(parts)
    return {
        "recall": float(np.mean(errors.coverage > COVERED)),
        "fragments": mean(errors.segments[errors.segments > 0]),
        "center_rms_px": rms(errors.center_px),
        "end_bias_px": median(errors.short_px),
        "end_sd_px": robust_sd(errors.short_px),
        "false": errors.false / len(parts),
    }


def _length_recall(found: Sequence[Segments], images: Sequence[BenchmarkImage]) -> dict[str, float]:
    pairs = [(segments, image.lines_px) for segments, image in zip(found, images, strict=True)]
    annotated = [(segments, lines_px) for segments, lines_px in pairs if lines_px is not None]
    length = sum(length_px(lines_px) for _, lines_px in annotated)
    if not length:
        return {}
    return {
        f"{distance_px:g}": sum(length_recalled_px(lines_px, own, distance_px) for own, lines_px in annotated) / length
        for distance_px in LINE_DISTANCES_PX
    }


def _chain_figures(images: Sequence[StripeImage], times: dict[str, float]) -> DetectorFigures:
    found = [detect(shot_of(image), image.rig, edges=False) for image in images]
    errors = joined([break_point_errors(each, image) for each, image in zip(found, images, strict=True)])
    wrong = (errors.flags == 0) & (np.hypot(errors.along_px, errors.across_px) > WRONG_PX)
    return DetectorFigures(
        detector=CHAIN,
        time_s=times[CHAIN],
        ratio=times[CHAIN] / times[DetectorName.EDGE_DRAWING],
        segments=sum(isinstance(each.break_points, BreakPoints) for each in found) * 3 / len(images),
        recall=len(errors.along_px) / errors.expected,
        center_rms_px=robust_sd(errors.across_px),
        end_bias_px=-median(errors.along_px),
        end_sd_px=robust_sd(errors.along_px),
        false=float(wrong.sum()) / len(images),
    )


def group_table(title: str, figures: Sequence[DetectorFigures]) -> str:
    """A line for each detector on a group of images, without the columns that need truth where there is none."""
    stripes = any(not math.isnan(line.recall) for line in figures)
    annotated = any(line.length_recall for line in figures)
    heading = ["detector", "ms", "ratio", "segments"]
    heading += [name for name, _ in STRIPE_COLUMNS.values()] if stripes else []
    heading += [f"recall {distance_px:g} px" for distance_px in LINE_DISTANCES_PX] if annotated else []
    rows = [heading]
    for line in figures:
        cells = [line.detector, f"{line.time_s * 1e3:.2f}", f"{line.ratio:.3f}", f"{line.segments:.0f}"]
        if stripes:
            cells += [number(getattr(line, name), form) for name, (_, form) in STRIPE_COLUMNS.items()]
        if annotated:
            cells += [number(line.length_recall.get(f"{px:g}", math.nan), ".3f") for px in LINE_DISTANCES_PX]
        rows.append(cells)
    return "\n".join([title, *aligned(rows, left=1)]) + "\n"


def synthetic_images(kind: Kind, seeds: int) -> list[BenchmarkImage]:
    """Images of a kind without lens distortion, which the comparison of straight segments requires."""
    images = [stripe_image(kind, seed, stripe_rig(lens=False)) for seed in range(seeds)]
    return [BenchmarkImage(image=image.image, stripes=image) for image in images]


def photograph(path: Path, lines: Path | None) -> BenchmarkImage:
    """A photograph, and its annotated lines from the file of the same name in a folder."""
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        sys.exit(f"{path}: cannot be read as an image")
    if lines is None:
        return BenchmarkImage(image=image)
    rows = np.genfromtxt(lines / f"{path.stem}.csv", delimiter=",", usecols=range(4), ndmin=2)
    return BenchmarkImage(image=image, lines_px=rows[~np.isnan(rows).any(axis=1)].reshape(-1, 2, 2))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", nargs="*", type=Path, metavar="IMAGE")
    parser.add_argument("--kind", action="append", choices=list(map(str, Kind)), help="synthetic images; repeatable")
    parser.add_argument("--seeds", type=int, default=3, help="synthetic images of each kind")
    parser.add_argument("--rounds", type=int, default=5, help="repetitions of each time")
    parser.add_argument("--lines", type=Path, help="folder of the annotated lines of the images")
    options = parser.parse_args(arguments)
    if options.images:
        images = [photograph(path, options.lines) for path in options.images]
        print(group_table(f"{len(images)} images", compare(images, options.rounds)))
    for kind in map(Kind, options.kind or ([] if options.images else Kind)):
        print(group_table(str(kind), compare(synthetic_images(kind, options.seeds), options.rounds)))


if __name__ == "__main__":
    main()
