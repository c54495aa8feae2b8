"""The limits on the accuracy of stripe centres and break points, on synthetic images with truth."""

import math
from collections.abc import Callable

import numpy as np

from ringpose.bench.detectors import WRONG_PX, shot_of
from ringpose.bench.detectors_break_points import (
    BreakPointErrors,
    break_point_errors,
    center_errors,
    joined_break_points,
    joined_centers,
)
from ringpose.bench.detectors_spread import mean, median, rms, robust_sd
from ringpose.bench.speed_gates import Gate
from ringpose.bench.stripe_images import Kind, StripeImage, stripe_image
from ringpose.detect.pipeline import detect
from ringpose.detect.stripe_centers import find_stripes
from ringpose.types.break_points import BreakPointFlag, Detection

CLEAN = (Kind.DARK, Kind.DIM)
"""Kinds whose noise is that of the sensor alone: the bound holds for them."""

SIGMA_LIMITS_PX = {Kind.DARK: 0.05, Kind.DIM: 0.12, Kind.SPECKLE: 0.35, Kind.FOIL: 0.35}

HONEST_NEES = (0.8, 1.25)

WRONG_SIGMAS = 5.0


def center_gates(seeds: int) -> list[Gate]:
    """Centres column by column: their error over the least possible one, their sigmas' honesty."""
    gates = []
    for kind in (*CLEAN, Kind.SPECKLE, Kind.FOIL):
        images = (stripe_image(kind, seed) for seed in range(seeds))
        errors = joined_centers([center_errors(find_stripes(image.image), image) for image in images])
        nees = mean((errors.error_px / errors.sigma_px) ** 2)
        if kind in CLEAN:
            over = rms(errors.error_px / errors.bound_px)
            gates.append(Gate(what=f"{kind}: error", measured=over, unit="x bound", most=1.15))
        else:
            gates.append(Gate(what=f"{kind}: error", measured=rms(errors.error_px), unit="px"))
        gates.append(Gate(what=f"{kind}: squared errors in sigmas", measured=nees, least=0.8, most=1.25))
    return gates


def break_point_gates(seeds: int, found: Callable[[StripeImage], Detection] | None = None) -> list[Gate]:
    """Ends of the stripes on the face, by all that `detect` does."""
    find = found or (lambda image: detect(shot_of(image), image.rig))
    gates = []
    for kind in Kind:
        images = (stripe_image(kind, seed) for seed in range(seeds))
        errors = joined_break_points([break_point_errors(find(image), image) for image in images])
        gates += _gates_of_kind(kind, errors)
    return gates


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
        Gate(what=f"{kind}: wrong without a flag", measured=_wrong(errors), most=0.0 if limited else math.inf),
    ]
    if kind in CLEAN:
        over = robust_sd(errors.along_px / errors.bound_px)
        gates.append(Gate(what=f"{kind}: sigma along", measured=over, unit="x bound", most=1.5))
    return gates


def _wrong(errors: BreakPointErrors) -> float:
    """Break points without a flag that are off by more than 1.5 px, or 5 of their own sigmas."""
    far = np.hypot(errors.along_px, errors.across_px) > WRONG_PX
    far |= np.abs(errors.along_px) > WRONG_SIGMAS * errors.along_sigma_px
    far |= np.abs(errors.across_px) > WRONG_SIGMAS * errors.across_sigma_px
    return float((far & (errors.flags == 0)).sum())
