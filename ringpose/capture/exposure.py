"""Automatic exposure: the stripes on the ring's face, on top of its ambient light, just below saturation.

The exposure of a shot follows from the previous one, and a shot whose stripes are far too bright or too dim is taken
again. If one stripe would be too dim at the exposure that the brightest one allows, every step is exposed twice; the
two exposures are merged (`ringpose.capture.hdr`).
"""

import math
from collections.abc import Iterator
from typing import TypeAlias

import numpy as np

from ringpose.detect.difference_images import LaserImage, laser_images, overexposure
from ringpose.detect.pipeline import detect
from ringpose.detect.stripes import find_stripes
from ringpose.geometry.rays import project, undistorted_rays
from ringpose.types.arrays import Array, Float64
from ringpose.types.detection import BreakPoints, NoBreakPoints
from ringpose.types.image import Shot
from ringpose.types.rig import Rig

TARGET_SHARE = 0.75
"""Grey value of the bright parts of a stripe, as a share of the saturation value: some speckle is brighter."""

BRIGHT_PERCENTILE = 90
"""Percentile of a stripe's columns that this grey value applies to."""

MAX_RATIO = 2.0
"""A shot is taken again if its exposure is off by more than this factor."""

BELOW_TOO_LONG = 1.5
"""Factor by which an exposure stays below one that was far too long."""

MAX_CLIPPED = 0.3
"""Share of saturated columns above which a stripe's brightness is not known."""

STEP = 4.0
"""Factor by which the exposure changes if the image does not show how far it is off."""

BRACKET_RATIO = 4.0
"""Ratio of the best exposures of two stripes from which both are taken."""

MIN_STRIPE_COLUMNS = 20
"""Minimum number of columns of a stripe."""

DARK_SHARE, BRIGHT_SHARE = 0.4, 0.9
"""Shares of the saturation value: an image without stripes is too dark if its brightest pixels, or too bright if its
median, are below or above these."""


Exposures: TypeAlias = tuple[float, ...]
"""The exposures of every step of a shot in seconds, in ascending order."""


class ExposureControl:
    """Determines the next shot's exposures from the stripes of the last one, within the limits of camera and lasers."""

    def __init__(self, rig: Rig | None, lasers: int, min_s: float, max_s: float) -> None:
        self._rig = rig
        self._lasers = lasers
        self._min_s, self._max_s = min_s, max_s
        self._too_long_s = math.inf
        self.exposures: Exposures | None = None
        """Exposures of the next shot; None before the first one, which has the exposure that the camera is set to."""

    def accepts(self, shot: Shot) -> bool:
        """Whether a shot is well exposed, or cannot be exposed better; sets the exposures of the next one.

        An exposure that was far too long is not reached again until a shot is accepted: the ring's stripes alone may
        suggest it, but what is saturated at that exposure may hide the ring.
        """
        used, wanted = exposures_of(shot), wanted_exposures(shot, self._lasers, self._rig)
        if wanted[-1] < used[-1] / MAX_RATIO:
            self._too_long_s = min(self._too_long_s, used[-1])
        max_s = max(self._min_s, min(self._max_s, self._too_long_s / BELOW_TOO_LONG))
        wanted = tuple(sorted({float(np.clip(each, self._min_s, max_s)) for each in wanted}))
        self.exposures = wanted
        pairs = [(used[place], wanted[place]) for place in (0, -1)]
        accepted = all(1 / MAX_RATIO <= better_s / used_s <= MAX_RATIO for used_s, better_s in pairs)
        if accepted:
            self._too_long_s = math.inf
        return accepted


def exposures_of(shot: Shot) -> Exposures:
    """The exposures that a shot was taken with; for a merged shot they are in its `meta`."""
    merged = shot.meta.get("merged")
    every = shot.exposure_s.tolist() if merged is None else [each for group in merged["exposures_s"] for each in group]
    return tuple(sorted(set(every)))


def wanted_exposures(shot: Shot, lasers: int, rig: Rig | None) -> Exposures:
    """The exposures at which the stripes of the shot would reach `TARGET_SHARE`.

    One exposure if it suits all stripes, else the shortest and the longest. With a known rig, the stripes on the ring's
    face are measured, else all stripes. If no ring is found and the ambient light saturates, the exposures are
    shortened.
    """
    images = laser_images(shot, lasers)
    points = None if rig is None else detect(shot, rig, edges=False).break_points
    shorter = overexposure(points, images) if isinstance(points, NoBreakPoints) else 1.0
    if shorter > MAX_RATIO:  # the face is brighter than what is seen of the stripes
        return tuple(exposure_s / shorter for exposure_s in exposures_of(shot))
    stripes = list(_stripes_on_face(points, images, rig)) if rig is not None and isinstance(points, BreakPoints) else []
    stripes = stripes or list(_all_stripes(images))
    if not stripes:
        return tuple(factor_without_stripes(shot) * exposure_s for exposure_s in exposures_of(shot))
    merged = shot.meta.get("merged")  # its grey values are as of one exposure
    scale_s = float(shot.exposure_s.max()) if merged is None else merged["scale_s"]
    shortest_s = exposures_of(shot)[0]
    best_s = [_best_exposure_s(image, position_px, scale_s, shortest_s) for image, position_px in stripes]
    if max(best_s) > BRACKET_RATIO * min(best_s):
        return min(best_s), max(best_s)
    return (min(best_s),)


def _stripes_on_face(
    points: BreakPoints, images: list[LaserImage], rig: Rig
) -> Iterator[tuple[LaserImage, Float64[Array, "column xy=2"]]]:
    """Each stripe on the ring's face: its image, and a pixel position in each of its columns."""
    for image in images:
        for laser in image.lasers:
            ends_px = np.stack([points.face_start_undistorted_px[laser], points.face_end_undistorted_px[laser]])
            if np.isfinite(ends_px).all():
                start, end = project(undistorted_rays(ends_px, rig.camera), rig.camera)
                columns = np.arange(np.ceil(start[0]), end[0])
                if len(columns) >= MIN_STRIPE_COLUMNS:
                    yield image, np.column_stack([columns, np.interp(columns, *np.stack([start, end], axis=1))])


def _all_stripes(images: list[LaserImage]) -> Iterator[tuple[LaserImage, Float64[Array, "column xy=2"]]]:
    """The images with the centres of their stripes, on any surface; those with too few are left out."""
    for image in images:
        centers = find_stripes(image.lit, image.dark, saturation_dn=image.threshold_scale_dn)
        if len(centers.position_px) >= MIN_STRIPE_COLUMNS:
            yield image, centers.position_px


def _best_exposure_s(
    image: LaserImage, position_px: Float64[Array, "column xy=2"], scale_s: float, shortest_s: float
) -> float:
    """The exposure at which the bright parts of a stripe reach their grey value.

    `scale_s` is the exposure that the grey values refer to, `shortest_s` the shortest exposure that was taken, at which
    pixels shown as saturated are saturated, too.
    """
    column, row = np.rint(position_px).astype(np.int64).T
    rows = np.clip(row + np.array([[-1], [0], [1]]), 0, image.lit.shape[0] - 1)
    level_dn = image.lit[rows, np.clip(column, 0, image.lit.shape[1] - 1)].max(axis=0)
    if float((level_dn >= image.saturation_dn).mean()) > MAX_CLIPPED:
        return shortest_s / STEP
    bright_dn = max(float(np.percentile(level_dn, BRIGHT_PERCENTILE)), 1.0)
    return scale_s * TARGET_SHARE * image.threshold_scale_dn / bright_dn


def factor_without_stripes(shot: Shot) -> float:
    """Factor on the exposure of a shot in which no stripe is seen; 1 if the stripes are not the cause."""
    thinned = shot.images[:, ::4, ::4]
    if float(np.percentile(thinned, 99.9)) < DARK_SHARE * shot.saturation_dn:
        return STEP
    if float(np.median(thinned)) > BRIGHT_SHARE * shot.saturation_dn:
        return 1 / STEP
    return 1.0
