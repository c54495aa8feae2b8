"""The limits on the accuracy of stripe centres and break points, on synthetic images with truth."""

import math
from collections.abc import Callable

import numpy as np

from ringpose.bench.detectors import WRONG_PX, shot_of
from ringpose.bench.detectors_break_points import (
    BreakPointErrors,
    CenterErrors,
    break_point_errors,
    center_errors,
)
from ringpose.bench.detectors_spread import joined, mean, median, rms, robust_sd
from ringpose.bench.speed_gates import Gate
from ringpose.bench.stripe_images import Kind, StripeImage, stripe_image
from ringpose.detect.pipeline import detect
from ringpose.detect.stripes import find_stripes
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.detection import BreakPointFlag, Detection

CLEAN = (Kind.DARK, Kind.DIM)
"""Kinds whose noise is that of the sensor alone: the bound holds for them."""

SIGMA_LIMITS_PX = {Kind.DARK: 0.05, Kind.DIM: 0.12, Kind.SPECKLE: 0.35, Kind.FOIL: 0.35}

HONEST_NEES = (0.8, 1.25)

WRONG_SIGMAS = 5.0


def accuracy_gates(
    seeds: int, found: Callable[[StripeImage], Detection] | None = None
) -> tuple[list[Gate], list[Gate]]:
    """Of stripe centres, column by column, and of the ends of stripes on the face, on the same images of each kind.

    Centres: their error over the least possible one, and the honesty of their sigmas; ends: all that `detect` does.
    """
    find = found or (lambda image: detect(shot_of(image), image.rig))
    centers, ends = [], []
    for kind in Kind:
        errors = [_errors(image, find) for image in (stripe_image(kind, seed) for seed in range(seeds))]
        if kind in SIGMA_LIMITS_PX:
            centers += _center_gates(kind, joined([of_centers for of_centers, _ in errors]))
        ends += _gates_of_kind(kind, joined([of_ends for _, of_ends in errors]))
    return centers, ends


def _errors(image: StripeImage, find: Callable[[StripeImage], Detection]) -> tuple[CenterErrors, BreakPointErrors]:
    return center_errors(find_stripes(image.image), image), break_point_errors(find(image), image)


def _center_gates(kind: Kind, errors: CenterErrors) -> list[Gate]:
    over = rms(errors.error_px / errors.bound_px) if kind in CLEAN else rms(errors.error_px)
    unit, most = ("x bound", 1.15) if kind in CLEAN else ("px", math.inf)
    nees = mean((errors.error_px / errors.sigma_px) ** 2)
    return [
        Gate(what=f"{kind}: error", measured=over, unit=unit, most=most),
        Gate(what=f"{kind}: squared errors in sigmas", measured=nees, least=0.8, most=1.25),
    ]


def _gates_of_kind(kind: Kind, errors: BreakPointErrors) -> list[Gate]:
    limit = SIGMA_LIMITS_PX.get(kind, math.inf)
    limited = kind in SIGMA_LIMITS_PX
    least, most = HONEST_NEES if limited else (-math.inf, math.inf)
    clear = errors.flags & ~BreakPointFlag.SATURATED == 0
    gates = [
        Gate(what=f"{kind}: found", measured=len(errors.along_px) / errors.expected, unit="of all"),
        Gate(what=f"{kind}: sigma along", measured=robust_sd(errors.along_px), unit="px", most=limit),
        Gate(what=f"{kind}: bias along", measured=abs(median(errors.along_px)), unit="px", most=limit / 3),
        Gate(what=f"{kind}: sigma across", measured=robust_sd(errors.across_px), unit="px"),
        Gate(what=f"{kind}: squared errors in sigmas", measured=mean(errors.nees[clear]), least=least, most=most),
        Gate(what=f"{kind}: of that along", measured=_squares(errors.along_px, errors.along_sigma_px, clear)),
        Gate(what=f"{kind}: of that across", measured=_squares(errors.across_px, errors.across_sigma_px, clear)),
        Gate(what=f"{kind}: wrong without a flag", measured=_wrong(errors), most=0.0 if limited else math.inf),
    ]
    if kind in CLEAN:
        over = robust_sd(errors.along_px / errors.bound_px)
        gates.append(Gate(what=f"{kind}: sigma along", measured=over, unit="x bound", most=1.5))
    return gates


def _squares(
    error_px: Float64[Array, "point"], sigma_px: Float64[Array, "point"], which: Bool[Array, "point"]
) -> float:
    return mean((error_px[which] / sigma_px[which]) ** 2)


def _wrong(errors: BreakPointErrors) -> float:
    """Break points without a flag that are off by more than 1.5 px, or 5 of their own sigmas."""
    far = np.hypot(errors.along_px, errors.across_px) > WRONG_PX
    far |= np.abs(errors.along_px) > WRONG_SIGMAS * errors.along_sigma_px
    far |= np.abs(errors.across_px) > WRONG_SIGMAS * errors.across_sigma_px
    return float((far & (errors.flags == 0)).sum())
