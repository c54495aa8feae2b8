"""Centres of the laser stripes, column by column (ringpose-method(7), section 3).

Stripes run roughly along the image rows. In each column a stripe is a ridge: the second derivative of the
Gaussian-smoothed grey values has a minimum there, and the zero of the first derivative next to it is the centre; of a
speckled stripe, it is what its flanks say.

Derivatives of Gaussians down the columns, to find stripes and to refine them (ringpose-method(7), section 3).

Straight tracks: the stripes' pieces in the undistorted image, cut at kinks and joined across gaps.

A light plane draws a straight line on every planar surface, so the stripe on the ring's face is one track;
a wall or a foil behind it adds tracks of other directions or places.
"""

import math
from functools import lru_cache

import numpy as np

from ringpose.kernels import lines as kernels
from ringpose.kernels import stripes as kernel
from ringpose.kernels.lines import Lens, TrackParams
from ringpose.kernels.stripes import Filters
from ringpose.types.arrays import Array, Float64, Int32, UInt
from ringpose.types.camera import Camera
from ringpose.types.detection import UNLABELLED, Stripes
from ringpose.types.image import full_scale_dn

STRIPE_SIGMA_PX = 1.6
"""Typical stripe, by which a peak is turned into the response of the ridge filter."""

COARSE_SHARE = 0.27
"""Mean over the 8 rows of a window, for a ridge so narrow that it fills it with sqrt(2 pi) / 8 of its response times
the cube of the filter's sigma (0.31), at the least favourable place in the grid of windows."""

WINDOW_PIXELS = 2 * kernel.CELL * kernel.BLOCK

FILTER_SIGMA_PX = 2.5
"""Smoothing along the column to find stripes: those up to twice as wide are found, and flat-topped, saturated ones up
to 40 px; close ones are told apart if they are some 2.5 of these sigmas apart. To measure them, each piece gets the
filter that suits it."""

BEGIN_SIGMAS, CONTINUE_SIGMAS = 6.0, 4.0
"""A piece must have `MIN_COLUMNS` that stand out of the local noise of the response by the first factor, and goes on
where they stand out by the second."""

MIN_PEAK_DN = 3.0
"""And all are this bright above their surroundings, where a pixel is full at 255."""

GAP_COLUMNS = 2
"""Columns that may be missing inside a piece."""

MIN_COLUMNS = 8
"""Shorter pieces are dropped: noise links over a few columns by chance."""


def find_stripes(
    image: UInt[Array, "row column"],
    dark: UInt[Array, "row column"] | None = None,
    bands: Int32[Array, "band side=4"] | None = None,
    saturation_dn: int | None = None,
) -> Stripes:
    """Sub-pixel stripe centres, linked along x into pieces without gap or jump; their lasers are not known.

    `dark` is the same view with the lasers off; its ambient light is subtracted (and its noise added). `bands` restrict
    the search: first column, the one after the last, and likewise the rows. `saturation_dn` is the grey value at which
    a pixel is full; if it is not known, the image must tell.
    """
    full_dn = full_scale_dn(image) if saturation_dn is None else saturation_dn
    min_peak_dn = MIN_PEAK_DN * full_dn / 255
    rules = kernel.StripeParams(
        begin_sigmas=BEGIN_SIGMAS,
        continue_sigmas=CONTINUE_SIGMAS,
        min_response=min_peak_dn * STRIPE_SIGMA_PX / (FILTER_SIGMA_PX**2 + STRIPE_SIGMA_PX**2) ** 1.5,
        coarse_per_response=COARSE_SHARE * FILTER_SIGMA_PX**3 * WINDOW_PIXELS,
        full_dn=full_dn,
        gap=GAP_COLUMNS,
        shortest=MIN_COLUMNS,
    )
    found = kernel.stripes(image, dark, bands, stripe_filters(FILTER_SIGMA_PX), rules)
    pieces = int(found.piece[-1]) + 1 if len(found.piece) else 0
    return Stripes(
        position_px=found.position_px,
        sigma_px=found.sigma_px,
        peak_dn=found.peak_dn,
        piece=found.piece,
        laser=np.full(pieces, UNLABELLED, dtype=np.int64),
    )


FINEST_SIGMA_PX = 1.0

FILTERS_AN_OCTAVE = 3

REFINING_FILTERS = 11
"""Filters of 1 to 10 px to refine with, so close that the nearest one costs a stripe less than 1 % of its accuracy."""

RIDGE_REACH = 3.0

REFINING_REACH = 3.5
"""Sigmas at which a filter ends: to find a ridge less will do than to say where it is."""


@lru_cache(maxsize=16)
def stripe_filters(ridge_sigma_px: float) -> Filters:
    """The ridge filter of that sigma, and those that refine."""
    steps = np.arange(REFINING_FILTERS) / FILTERS_AN_OCTAVE
    sigmas = [ridge_sigma_px, *(FINEST_SIGMA_PX * 2**steps)]
    reaches = [math.ceil(sigma * (RIDGE_REACH if i == 0 else REFINING_REACH)) for i, sigma in enumerate(sigmas)]
    taps = np.zeros((len(sigmas), 2, max(reaches) + 1))
    figures = np.zeros((len(sigmas), 4))
    for i, (sigma, reach) in enumerate(zip(sigmas, reaches, strict=True)):
        slope, bend = _derivatives(sigma, reach)
        taps[i, 0, : reach + 1], taps[i, 1, : reach + 1] = slope, bend
        figures[i] = sigma, reach, _two_sided_norm(slope), _two_sided_norm(bend)
    return Filters(taps=taps.astype(np.float32), figures=figures)


def _derivatives(sigma_px: float, reach: int) -> tuple[Float64[Array, "tap"], Float64[Array, "tap"]]:
    """Taps of the first and second derivative of a Gaussian, from the middle on; a flat image answers with nothing."""
    y = np.arange(reach + 1, dtype=np.float64)
    gauss = np.exp(-0.5 * (y / sigma_px) ** 2)
    gauss /= 2 * gauss.sum() - gauss[0]
    bend = (y**2 / sigma_px**4 - 1 / sigma_px**2) * gauss
    bend -= (2 * bend.sum() - bend[0]) / (2 * reach + 1)
    return y / sigma_px**2 * gauss, bend


def _two_sided_norm(taps: Float64[Array, "tap"]) -> float:
    """Standard deviation of the filter's answer to white noise of 1."""
    return math.sqrt(2 * float(taps @ taps) - float(taps[0]) ** 2)


MINIMUM_COLUMNS = 10
"""A shorter track says nothing about direction; 20 mm of ring at 1 m are twice as many."""

BORDER_PX = 3.0
"""A centre so close to the image's left or right border is the last that could be seen."""

KINK_PX = 0.6
"""A piece that leaves its chord by more than this (and by its own scatter) is cut there."""

JOINED_PX = 0.5
"""Tracks whose lines meet this closely across a gap are one surface."""

ON_LINE_PX = 2.5
"""Centres so close to a track's line are on its surface; the nearest body behind a ring jumps by 4 px at 1 m."""

SHORT_SERIES = 1.25
"""A line fitted to a short series takes part of its likeness away: what is found is so much too small."""

TAKEN_BY_THE_FIT, MIN_SEGMENT_COLUMNS = 5.0, 0.5
"""Independent columns that a fit takes from a series, and the least that are left to it.

The line takes up part of what neighbours err alike, which then shows neither in the scatter nor in the likeness: at 29
columns and grains of 4 px, as 30 mm at 1 m before a wide lens, one line in ten was off by three sigmas.
"""

MAX_CORRELATION = 40
"""Columns over which errors of neighbouring centres are looked at for likeness: a facet of crinkled foil."""


def stripe_line_segments(stripes: Stripes, camera: Camera) -> Float64[Array, "track column=11"]:
    """The straight tracks among the stripes, in undistorted pixels; columns as in `TRACK_COLUMNS`."""
    optics, rules = lens(camera), _rules(camera.image_width)
    return kernels.stripe_line_segments(
        stripes.position_px, stripes.sigma_px, stripes.piece, stripes.laser, optics, rules
    )


@lru_cache(maxsize=4)
def _rules(image_width: int) -> TrackParams:
    return TrackParams(
        kink_px=KINK_PX,
        joined_px=JOINED_PX,
        short_series=SHORT_SERIES,
        on_line_px=ON_LINE_PX,
        border_px=BORDER_PX,
        min_columns=MINIMUM_COLUMNS,
        image_width=image_width,
        max_lag=MAX_CORRELATION,
    )


@lru_cache(maxsize=4)
def lens(camera: Camera) -> Lens:
    """The camera's parameters as the kernels take them."""
    matrix = camera.camera_matrix
    focal_and_principal = (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])
    return Lens(*(float(each) for each in (*focal_and_principal, *camera.distortion_coefficients)))
