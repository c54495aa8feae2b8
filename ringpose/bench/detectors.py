"""Images -> how fast and how good each line detector is on them."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ringpose.bench.detectors_break_points import break_point_errors
from ringpose.bench.detectors_lines import length_px, length_recalled_px
from ringpose.bench.detectors_spread import joined, mean, median, rms, robust_sd
from ringpose.bench.detectors_stripes import COVERED, stripe_errors
from ringpose.bench.speed_times import median_times_s, one_core
from ringpose.bench.stripe_images import StripeImage
from ringpose.detect.peers import GIVES_CENTERS, DetectorName, detector
from ringpose.detect.pipeline import detect
from ringpose.types.arrays import Array, Float64, UInt8
from ringpose.types.detection import BreakPoints, Segments
from ringpose.types.image import Shot

CHAIN = "ringpose detect"
"""From the image to break points, without the ring's edges between them; only where the rig is known."""

LINE_DISTANCES_PX = (1.5, 3.0)
"""How far a segment may be from a drawn line."""

WRONG_PX = 1.5
"""A break point farther off than this, without a flag, is false."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnownImage:
    """An image with what is known of it."""

    image: UInt8[Array, "row column"]
    stripes: StripeImage | None = None
    lines_px: Float64[Array, "line end=2 xy=2"] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectorLine:
    """One detector on a group of images; figures are NaN where nothing is known or found."""

    detector: str
    time_s: float
    """Processor time an image: the sum of each image's median over the number of images."""
    ratio: float
    """To EdgeDrawing's."""
    segments: float
    """An image."""
    recall: float = math.nan
    """Share of the stripes' pieces that are covered; of break points, those found."""
    fragments: float = math.nan
    """Segments on each line of a piece."""
    center_rms_px: float = math.nan
    """Root mean square error of the centre line; of break points their robust deviation across the stripe."""
    end_bias_px: float = math.nan
    """How far ends stop short of the true ones, median."""
    end_sd_px: float = math.nan
    """Robust standard deviation of the same."""
    false: float = math.nan
    """Segments on no stripe, an image; break points that are off by more than `WRONG_PX` and say nothing."""
    length_recall: dict[str, float] = field(default_factory=dict)
    """Share of the drawn lines' length, by the distance in pixels."""


def compared(images: Sequence[KnownImage], rounds: int) -> list[DetectorLine]:
    """A line for each detector, all of them on the same images in turns, on one core."""
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
        lines = [_line(name, images, times) for name in DetectorName]
        known = [image.stripes for image in images if image.stripes is not None]
        return [*lines, _chain_line(known, times)] if known else lines


def shot_of(stripes: StripeImage) -> Shot:
    """The image as a shot of one frame with all lasers on."""
    return Shot(
        name="synthetic",
        images=stripes.image[None],
        lasers=np.array([2 ** len(stripes.rig.lasers.names) - 1], np.uint8),
        stamp_s=np.zeros(1),
        exposure_s=np.full(1, 1e-3),
    )


def _line(name: DetectorName, images: Sequence[KnownImage], times: dict[str, float]) -> DetectorLine:
    found = [detector(name)(image.image) for image in images]
    return DetectorLine(
        detector=name.value,
        time_s=times[name],
        ratio=times[name] / times[DetectorName.EDGE_DRAWING],
        segments=sum(len(segments.support) for segments in found) / len(images),
        **_stripe_figures(name, found, images),
        length_recall=_length_recall(found, images),
    )


def _stripe_figures(name: DetectorName, found: Sequence[Segments], images: Sequence[KnownImage]) -> dict[str, float]:
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


def _length_recall(found: Sequence[Segments], images: Sequence[KnownImage]) -> dict[str, float]:
    drawn = [
        (segments, image.lines_px) for segments, image in zip(found, images, strict=True) if image.lines_px is not None
    ]
    length = sum(length_px(lines) for _, lines in drawn)
    if not length:
        return {}
    return {
        f"{distance_px:g}": sum(length_recalled_px(lines, own, distance_px) for own, lines in drawn) / length
        for distance_px in LINE_DISTANCES_PX
    }


def _chain_line(images: Sequence[StripeImage], times: dict[str, float]) -> DetectorLine:
    found = [detect(shot_of(image), image.rig, edges=False) for image in images]
    errors = joined([break_point_errors(each, image) for each, image in zip(found, images, strict=True)])
    wrong = (errors.flags == 0) & (np.hypot(errors.along_px, errors.across_px) > WRONG_PX)
    return DetectorLine(
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
