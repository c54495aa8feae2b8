"""Automatic exposure: the stripes on the ring's face, on top of its ambient light, just below saturation.

The exposures of a shot follow from the previous one, and a shot whose stripes are far too bright or too dim is taken
again. If the stripe of one laser would be too dim at the exposure that another one allows, each of them has its own;
steps without lasers or with several of them are taken with all of these exposures, which are merged
(`ringpose.capture.hdr`).
"""

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple, TypeAlias

import numpy as np

from ringpose.detect.difference_images import (
    BRIGHT_PERCENTILE,
    LASER_RATIO,
    LaserImage,
    laser_images,
    overexposure,
)
from ringpose.detect.pipeline import detect
from ringpose.detect.stripes import find_stripes
from ringpose.geometry.rays import project, undistorted_rays
from ringpose.types.arrays import Array, Float64
from ringpose.types.detection import BreakPoints, NoBreakPoints
from ringpose.types.image import Shot
from ringpose.types.rig import Rig

TARGET_SHARE = 0.75
"""Grey value of the bright parts of a stripe, as a share of the saturation value: some speckle is brighter."""

MAX_RATIO = 2.0
"""A shot is taken again if its exposure is off by more than this factor."""

BELOW_TOO_LONG = 1.5
"""Factor by which an exposure stays below one that was far too long."""

MAX_CLIPPED = 0.3
"""Share of saturated columns above which a stripe's brightness is not known."""

STEP = 4.0
"""Factor by which the exposure changes if the image does not show how far it is off."""

MIN_STRIPE_COLUMNS = 20
"""Minimum number of columns of a stripe."""

DARK_SHARE, BRIGHT_SHARE = 0.4, 0.9
"""Shares of the saturation value: an image without stripes is too dark if its brightest pixels, or too bright if its
median, are below or above these."""


Exposures: TypeAlias = dict[int, float]
"""The exposure of each laser, by its number, in seconds."""


class Wanted(NamedTuple):
    """The exposure at which a laser's stripe reaches its grey value."""

    best_s: float
    longest_s: float
    """The longest one that it may be: longer for a saturated stripe, whose brightness is not known."""


class ExposureControl:
    """Determines the next shot's exposures from the stripes of the last one, within the limits of camera and lasers."""

    def __init__(self, rig: Rig | None, lasers: int, min_s: float, max_s: float) -> None:
        self._rig = rig
        self._lasers = lasers
        self._min_s, self._max_s = min_s, max_s
        self._too_long_s = math.inf
        self.exposures: Exposures | None = None
        """Exposures of the next shot; None before the first one, which has the exposure that the camera is set to."""

    def of_step(self, mask: int) -> tuple[float | None, ...]:
        """The exposures of a step with these lasers, in ascending order; without lasers, or with several, all."""
        if self.exposures is None:
            return (None,)
        own = [self.exposures[laser] for laser in self.exposures if mask == 1 << laser]
        return tuple(own or sorted(set(self.exposures.values())))

    def accepts(self, shot: Shot) -> bool:
        """Whether a shot is well exposed, or cannot be exposed better; sets the exposures of the next one.

        An exposure that was far too long is not reached again until a shot is accepted: the ring's stripes alone may
        suggest it, but what is saturated at that exposure may hide the ring.
        """
        used, wanted = _exposures_by_laser(shot, self._lasers), wanted_exposures(shot, self._lasers, self._rig)
        longest_s = max(max(each) for each in used.values())
        if max(each.best_s for each in wanted.values()) < longest_s / MAX_RATIO:
            self._too_long_s = min(self._too_long_s, longest_s)
        max_s = max(self._min_s, min(self._max_s, self._too_long_s / BELOW_TOO_LONG))
        possible = {laser: Wanted(*np.clip(each, self._min_s, max_s).tolist()) for laser, each in wanted.items()}
        self.exposures = _in_common(possible)
        accepted = all(
            any(self.exposures[laser] / MAX_RATIO <= used_s <= each.best_s * MAX_RATIO for used_s in used[laser])
            for laser, each in possible.items()
        )
        if accepted:
            self._too_long_s = math.inf
        return accepted


def _in_common(wanted: Mapping[int, Wanted]) -> Exposures:
    """The shortest exposure for lasers whose best ones may differ by `LASER_RATIO` at most: fewer take less time."""
    common: Exposures = {}
    first = Wanted(0.0, 0.0)
    for laser, each in sorted(wanted.items(), key=lambda item: item[1]):
        first = each if each.best_s > LASER_RATIO * first.longest_s else first
        common[laser] = first.best_s
    return common


def _exposures_by_laser(shot: Shot, lasers: int) -> dict[int, list[float]]:
    """The exposures that the stripes of each laser were taken with, or all where no frame shows it alone."""
    merged = shot.meta.get("merged")
    groups = [[each] for each in shot.exposure_s.tolist()] if merged is None else merged["exposures_s"]
    masks = shot.lasers.tolist()
    return {
        laser: [each for mask, group in zip(masks, groups, strict=True) if mask == 1 << laser for each in group]
        or sorted({each for group in groups for each in group})
        for laser in range(lasers)
    }


def wanted_exposures(shot: Shot, lasers: int, rig: Rig | None) -> dict[int, Wanted]:
    """The exposures at which the stripes of each laser of the shot would reach `TARGET_SHARE`.

    With a known rig, the stripes on the ring's face are measured, else all stripes. Lasers without a stripe have the
    shortest one of the others. If no ring is found and the ambient light saturates, the exposures are shortened.
    """
    images, used = laser_images(shot, lasers), _exposures_by_laser(shot, lasers)
    points = None if rig is None else detect(shot, rig, edges=False).break_points
    shorter = overexposure(points, images) if isinstance(points, NoBreakPoints) else 1.0
    if shorter > MAX_RATIO:  # the face is brighter than what is seen of the stripes
        return {laser: Wanted(max(each) / shorter, max(each)) for laser, each in used.items()}
    stripes = list(_stripes_on_face(points, images, rig)) if rig is not None and isinstance(points, BreakPoints) else []
    stripes = stripes or list(_all_stripes(images))
    if not stripes:
        factor = factor_without_stripes(shot)
        return {laser: Wanted(factor * max(each), factor * max(each)) for laser, each in used.items()}
    merged = shot.meta.get("merged")  # its grey values are as of one exposure
    best: dict[int, Wanted] = {}
    for on, image, position_px in stripes:
        for laser in on:
            scale_s, zero_dn = (max(used[laser]), 0.0) if merged is None else (merged["scale_s"], merged["pedestal_dn"])
            of_stripe = _best_exposure(image, position_px, scale_s, zero_dn, min(used[laser]))
            best[laser] = min(of_stripe, best.get(laser, of_stripe))
    return {laser: best.get(laser, min(best.values())) for laser in range(lasers)}


def _stripes_on_face(
    points: BreakPoints, images: list[LaserImage], rig: Rig
) -> Iterator[tuple[tuple[int, ...], LaserImage, Float64[Array, "column xy=2"]]]:
    """Each stripe on the ring's face: its laser, its image, and a pixel position in each of its columns."""
    for image in images:
        for laser in image.lasers:
            ends_px = np.stack([points.face_start_undistorted_px[laser], points.face_end_undistorted_px[laser]])
            if np.isfinite(ends_px).all():
                start, end = project(undistorted_rays(ends_px, rig.camera), rig.camera)
                columns = np.arange(np.ceil(start[0]), end[0])
                if len(columns) >= MIN_STRIPE_COLUMNS:
                    yield (
                        (laser,),
                        image,
                        np.column_stack([columns, np.interp(columns, *np.stack([start, end], axis=1))]),
                    )


def _all_stripes(
    images: list[LaserImage],
) -> Iterator[tuple[tuple[int, ...], LaserImage, Float64[Array, "column xy=2"]]]:
    """The images with their lasers and their stripes' centres, on any surface; those with too few are left out."""
    for image in images:
        centers = find_stripes(image.lit, image.dark, saturation_dn=image.threshold_scale_dn)
        if len(centers.position_px) >= MIN_STRIPE_COLUMNS:
            yield image.lasers, image, centers.position_px


def _best_exposure(
    image: LaserImage, position_px: Float64[Array, "column xy=2"], scale_s: float, zero_dn: float, shortest_s: float
) -> Wanted:
    """The exposure at which the bright parts of a stripe reach their grey value.

    `scale_s` is the exposure that the grey values refer to, `zero_dn` the one of no light, `shortest_s` the shortest
    exposure that was taken, at which pixels shown as saturated are saturated, too.
    """
    column, row = np.rint(position_px).astype(np.int64).T
    rows = np.clip(row + np.array([[-1], [0], [1]]), 0, image.lit.shape[0] - 1)
    level_dn = image.lit[rows, np.clip(column, 0, image.lit.shape[1] - 1)].max(axis=0)
    if float((level_dn >= image.saturation_dn).mean()) > MAX_CLIPPED:
        return Wanted(shortest_s / STEP, TARGET_SHARE * shortest_s)
    bright_dn = max(float(np.percentile(level_dn, BRIGHT_PERCENTILE)) - zero_dn, 1.0)
    best_s = scale_s * TARGET_SHARE * image.threshold_scale_dn / bright_dn
    return Wanted(best_s, best_s)


def factor_without_stripes(shot: Shot) -> float:
    """Factor on the exposure of a shot in which no stripe is seen; 1 if the stripes are not the cause."""
    thinned = shot.images[:, ::4, ::4]
    if float(np.percentile(thinned, 99.9)) < DARK_SHARE * shot.saturation_dn:
        return STEP
    if float(np.median(thinned)) > BRIGHT_SHARE * shot.saturation_dn:
        return 1 / STEP
    return 1.0
