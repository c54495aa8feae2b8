"""Line detectors beside each other on synthetic stripes: those of OpenCV, those of ringpose, and its detection chain.

    PYTHONPATH=tests python -m benchmarks.compare_detectors [--seeds N] [--rounds N]  (`make bench-speed`)

The lens has no distortion, so that stripes are straight. A stripe has two edges; for a detector of edges its centre
line is the mean of the two. Times are processor times on one core.
"""

import math
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from benchmarks.detection_errors import WRONG_PX, break_point_errors, joined, mean, median, rms, robust_sd
from benchmarks.limits import number, options
from benchmarks.opencv_detectors import GIVES_CENTERS, DetectorName, detector
from benchmarks.stripe_images import Kind, StripeImage, shot_of, stripe_image, stripe_rig
from benchmarks.timing import median_times_s, one_core

from ringpose.detect.pipeline import detect
from ringpose.types.arrays import Array, Float64, UInt8
from ringpose.types.detection import Segments
from ringpose.types.table import Table

CHAIN = "ringpose detect"
"""From the image to break points, without the edges of the ring between them.

Its `recall` is the share of break points that are found, its `center` the robust standard deviation of break points
across the stripe, and its `false` the break points that are off by more than `WRONG_PX` without a flag.
"""

COVERED = 0.8
"""A piece of a stripe is recalled if segments on it cross more than this share of its columns."""

MAX_ANGLE_RAD = math.radians(10)
"""A segment belongs to a piece if the angle between them is not larger; the direction of short ones is noisy,"""

MAX_DISTANCE_SIGMAS, MAX_DISTANCE_PX = 2.0, 2.0
"""if its midpoint is within this many standard deviations of the stripe plus this many pixels of the centre line (edges
lie at one standard deviation, those of saturated stripes at nearly two),"""

END_MARGIN_PX = 4.0
"""and if its midpoint is not farther beyond an end of the piece."""

COLUMNS = {
    "ms": ".2f",
    "ratio": ".3f",
    "segments": ".0f",
    "recall": ".2f",
    "pieces": ".1f",
    "center px": ".4f",
    "end bias px": ".3f",
    "end sd px": ".3f",
    "false": ".1f",
}
"""Headings and formats: time of an image, that time over EdgeDrawing's, segments of an image, share of the pieces that
are recalled, segments on each line of a piece, RMS error of the centre line, median distance by which ends stop short
of the true ones, its robust standard deviation, and segments on no piece."""


def stripe_errors(segments: Segments, image: StripeImage, centers: bool) -> dict[str, Float64[Array, "n"]]:
    """Errors on an image; `centers` states that segments run along centres, not along edges.

    `coverage`: share of the columns of each piece that segments cross; `pieces`: segments on each line of a piece;
    `center_px`: row of the centre line minus the true row, in each column with both edges, or a centre; `short_px`: how
    far ends of recalled pieces stop short of the true ones; `false`: the number of segments on no piece.
    """
    both_px = np.stack([segments.start_px, segments.end_px], axis=1)
    order = np.argsort(both_px[..., 0], axis=1, kind="stable")
    left, right = np.take_along_axis(both_px, order[..., None], axis=1).swapaxes(0, 1)
    along, down = (right - left).T
    middle = (left + right) / 2
    coverage, pieces, center_px, short_px = [], [], [np.empty(0)], []
    is_false = np.ones(len(left), dtype=bool)
    for (first, row), (last, last_row) in image.pieces_px.tolist():
        slope = (last_row - row) / (last - first)
        off_px = middle[:, 1] - row - slope * (middle[:, 0] - first)
        own = np.abs(np.arctan2(down, along) - math.atan(slope)) <= MAX_ANGLE_RAD
        own &= np.abs(off_px) <= MAX_DISTANCE_SIGMAS * image.stripe_sigma_px + MAX_DISTANCE_PX
        own &= (middle[:, 0] >= first - END_MARGIN_PX) & (middle[:, 0] <= last + END_MARGIN_PX)
        is_false &= ~own
        x = np.arange(math.ceil(first), math.floor(last) + 1.0)[:, None]
        rows = left[:, 1] + down / np.maximum(along, 1e-9) * (x - left[:, 0]) - (row + slope * (x - first))
        crosses = (left[:, 0] <= x) & (x <= right[:, 0])
        sides = [own] if centers else [own & (off_px < 0), own & (off_px >= 0)]
        counts = np.array([(crosses & side).sum(axis=1) for side in sides])
        sums = np.array([np.where(crosses & side, rows, 0.0).sum(axis=1) for side in sides])
        whole = (counts > 0).all(axis=0)
        coverage.append((counts > 0).any(axis=0).mean())
        pieces.append(own.sum() / len(sides))
        center_px.append((sums[:, whole] / counts[:, whole]).mean(axis=0))
        if coverage[-1] > COVERED:
            ends = [(left[side, 0].min() - first, last - right[side, 0].max()) for side in sides if side.any()]
            short_px += np.mean(ends, axis=0).tolist()
    return {
        "coverage": np.array(coverage),
        "pieces": np.array(pieces),
        "center_px": np.concatenate(center_px),
        "short_px": np.array(short_px),
        "false": np.array([float(is_false.sum())]),
    }


def compare(images: Sequence[StripeImage], rounds: int) -> dict[str, dict[str, float]]:
    """Figures of each detector by the names of `COLUMNS`; all of them run on the same images in turns, on one core."""
    times_s = {str(name): 0.0 for name in (*DetectorName, CHAIN)}
    with one_core():
        for image in images:
            calls: dict[str, Callable[[], object]] = {
                str(name): partial(detector(name), image.image) for name in DetectorName
            }
            calls[CHAIN] = partial(detect, shot_of(image), image.rig, edges=False)
            for name, time_s in median_times_s(calls, rounds).items():
                times_s[name] += time_s / len(images)
        figures = {str(name): _detector_figures(name, images) for name in DetectorName}
        figures[CHAIN] = _chain_figures(images)
    reference_s = times_s[DetectorName.EDGE_DRAWING]
    return {
        name: {"ms": 1e3 * time_s, "ratio": time_s / reference_s, **figures[name]} for name, time_s in times_s.items()
    }


def _detector_figures(name: DetectorName, images: Sequence[StripeImage]) -> dict[str, float]:
    found = [detector(name)(image.image) for image in images]
    each = [stripe_errors(own, image, name in GIVES_CENTERS) for own, image in zip(found, images, strict=True)]
    errors = {key: np.concatenate([part[key] for part in each]) for key in each[0]}
    return {
        "segments": sum(len(own.support) for own in found) / len(images),
        "recall": float(np.mean(errors["coverage"] > COVERED)),
        "pieces": mean(errors["pieces"][errors["pieces"] > 0]),
        "center px": rms(errors["center_px"]),
        "end bias px": median(errors["short_px"]),
        "end sd px": robust_sd(errors["short_px"]),
        "false": mean(errors["false"]),
    }


def _chain_figures(images: Sequence[StripeImage]) -> dict[str, float]:
    errors = joined([break_point_errors(detect(shot_of(image), image.rig, edges=False), image) for image in images])
    is_wrong = (errors.flags == 0) & (np.hypot(errors.along_px, errors.across_px) > WRONG_PX)
    return {
        "recall": len(errors.along_px) / errors.expected,
        "center px": robust_sd(errors.across_px),
        "end bias px": -median(errors.along_px),
        "end sd px": robust_sd(errors.along_px),
        "false": float(is_wrong.sum()) / len(images),
    }


_MEMORY = """
import sys
from benchmarks.opencv_detectors import DetectorName, detector
import numpy as np

def kilobytes(key):
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith(key))

image = np.load(sys.argv[2])
find = detector(DetectorName(sys.argv[1]))
find(image[:64, :64].copy())
with open("/proc/self/clear_refs", "w") as refs:
    refs.write("5")  # the peak begins anew
before = kilobytes("VmRSS")
find(image)
print(kilobytes("VmHWM") - before)
"""
"""Prints by how many kB the memory of a new process grows, at its peak, while a detector runs for the first time."""


def peak_memory_mb(name: DetectorName, image: UInt8[Array, "row column"]) -> float:
    """Memory that a detector needs at its peak for an image, beside the image."""
    with TemporaryDirectory() as folder:
        np.save(f"{folder}/image.npy", image)
        program = [sys.executable, "-c", _MEMORY, str(name), f"{folder}/image.npy"]
        done = subprocess.run(program, cwd=Path(__file__).parents[1], check=True, capture_output=True, text=True)
    return int(done.stdout) / 1024


def table(title: str, figures: Mapping[str, Mapping[str, Any]]) -> str:
    """A line for each detector."""
    rows = [
        [name, *(number(of_detector.get(key, math.nan), form) for key, form in COLUMNS.items())]
        for name, of_detector in figures.items()
    ]
    return "\n".join([title, *Table(headings=["detector", *COLUMNS], rows=rows).lines()]) + "\n"


def main() -> None:
    chosen = options(__doc__, seeds=3, rounds=5).parse_args()
    for kind in Kind:
        images = [stripe_image(kind, seed, stripe_rig(lens=False)) for seed in range(chosen.seeds)]
        print(table(str(kind), compare(images, chosen.rounds)), flush=True)


if __name__ == "__main__":
    main()
