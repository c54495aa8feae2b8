"""Extraction of the laser stripes: sub-pixel centres and straight line segments (ringpose-method(7), section 3).

Stripes run roughly along the image rows. In each column a stripe is a ridge: the second derivative of the
Gaussian-smoothed grey values has a minimum, and the centre is the adjacent zero of the first derivative; the centre of
a speckled stripe is estimated from its flanks. Centres are linked along x into pieces.

The intersection of a light plane with a planar surface is a straight line. Pieces are therefore cut at kinks and joined
across gaps, in the undistorted image: the stripe on the ring's face is one such segment, and walls or foil
behind it add segments of other directions or offsets.

The centres are computed in kernels/stripes: stripe_search.c (noise, coarse search, ridges), stripe_patches.c (image
patches and their derivatives), stripe_links.c (ridges linked into pieces), stripe_centers.c (sub-pixel centres) and
stripe_sigmas.c (standard deviations).
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ringpose.kernels import _kernels, kernel_record
from ringpose.kernels.lines import SEGMENT_COLUMNS, Lens, SegmentParams
from ringpose.optics.feature_errors import BORDER_PX, MAX_SPECKLE, MIN_PEAK, REACH_SIGMAS
from ringpose.types.arrays import Array, Float32, Float64, Int32, Int64, UInt
from ringpose.types.detection import UNLABELLED, Stripes
from ringpose.types.image import full_scale_dn
from ringpose.types.rig import Camera

STRIPE_SIGMA_PX = 1.6
"""Width (sigma) of a typical stripe, for converting a peak value into a response of the ridge filter."""

COARSE_SHARE = 0.27
"""Ratio of the mean over the 8 rows of a window to the filter response times the cube of the filter's sigma, for a
narrow ridge: sqrt(2 pi) / 8 = 0.31, less at the least favourable position in the grid of windows."""

BLOCK = 16
"""Columns that are processed together."""

CELL = 4
"""Rows of a cell of the coarse search; a cell is one block wide."""

WINDOW_PIXELS = 2 * CELL * BLOCK

FILTER_SIGMA_PX = 2.5
"""Smoothing along the column for detection. Stripes up to twice as wide are found, and flat-topped, saturated ones up
to 40 px; neighbouring stripes are resolved from a distance of about 2.5 of these sigmas. For the measurement, the
filter is selected for each piece."""

MIN_COLUMNS = 8
"""Minimum length of a piece: noise may link over a few columns by chance."""


def find_stripes(
    image: UInt[Array, "row column"],
    dark: UInt[Array, "row column"] | None = None,
    bands: Int32[Array, "band side=4"] | None = None,
    saturation_dn: int | None = None,
) -> Stripes:
    """Sub-pixel stripe centres, linked along x into pieces without gap or jump, not assigned to lasers.

    `dark` is the same view with the lasers off: it is subtracted, and its noise is taken into account. `bands` are the
    windows to search, one a row: first column, column after the last, first row, row after the last. `saturation_dn` is
    the grey value at which a pixel saturates; by default it is estimated from the image.
    """
    full_dn = full_scale_dn(image) if saturation_dn is None else saturation_dn
    min_peak_dn = MIN_PEAK * full_dn
    params = StripeParams(
        min_response=min_peak_dn * STRIPE_SIGMA_PX / (FILTER_SIGMA_PX**2 + STRIPE_SIGMA_PX**2) ** 1.5,
        coarse_per_response=COARSE_SHARE * FILTER_SIGMA_PX**3 * WINDOW_PIXELS,
        full_dn=full_dn,
    )
    found = stripe_centers(image, dark, bands, stripe_filters(FILTER_SIGMA_PX), params)
    pieces = int(found.piece[-1]) + 1 if len(found.piece) else 0
    return Stripes(
        position_px=found.position_px,
        sigma_px=found.sigma_px,
        peak_dn=found.peak_dn,
        piece=found.piece,
        laser=np.full(pieces, UNLABELLED, dtype=np.int64),
    )


@kernel_record
@dataclass(frozen=True, slots=True, kw_only=True)
class StripeParams:
    """Detection thresholds."""

    min_response: float
    """Smallest response of the ridge filter."""
    coarse_per_response: float
    """Sum over a window of 8 x 16 pixels, less its surroundings, for a ridge with a response of 1."""
    full_dn: int
    """Grey value of a saturated pixel; speckle weights are not used on pieces with many of them."""
    begin_sigmas: float = 6.0
    """Response over its noise (clutter included) that at least `shortest` columns of a piece must have."""
    continue_sigmas: float = 4.0
    """Response over its noise that every column must have."""
    gap: int = 2
    """Largest number of missing columns inside a piece."""
    shortest: int = MIN_COLUMNS
    reach_sigmas: float = REACH_SIGMAS
    max_speckle: float = MAX_SPECKLE


class Centers(NamedTuple):
    """Stripe centres, sorted by piece, then column."""

    position_px: Float64[Array, "center xy=2"]
    sigma_px: Float64[Array, "center"]
    peak_dn: Float64[Array, "center"]
    piece: Int64[Array, "center"]


def stripe_centers(
    image: UInt[Array, "row column"],
    dark: UInt[Array, "row column"] | None,
    bands: Int32[Array, "band side=4"] | None,
    filters: "Filters",
    params: StripeParams,
) -> Centers:
    """Sub-pixel centres of ridges, column by column, linked into pieces; 8 or 16 bits a pixel.

    `dark` is the same view with the lasers off and is subtracted. `bands` are the windows to search, one a row: first
    column, column after the last, first row, row after the last; they are rounded outwards to cells of 4 x 16 pixels.
    Each piece is measured with the filter matched to its width, with a narrower one if clutter disturbs it, or by
    weighted least squares if speckle dominates. Sigmas are propagated from the sensor noise and raised to the scatter
    that second differences of the centres show.
    """
    lit = np.ascontiguousarray(image)
    black = None if dark is None else np.ascontiguousarray(dark)
    where = None if bands is None else np.ascontiguousarray(bands)
    position, sigma, peak, piece = _kernels.stripes(lit, black, where, filters.taps, filters.figures, params)
    return Centers(
        position_px=np.frombuffer(position, np.float64).reshape(-1, 2),
        sigma_px=np.frombuffer(sigma, np.float64),
        peak_dn=np.frombuffer(peak, np.float64),
        piece=np.frombuffer(piece, np.int64),
    )


FINEST_SIGMA_PX = 1.0

FILTERS_AN_OCTAVE = 3

REFINING_FILTERS = 11
"""Number of refinement filters of 1 to 10 px: with this spacing the nearest one loses less than 1 % of accuracy."""

RIDGE_REACH = 3.0

REFINING_REACH = 3.5
"""Half lengths of the filters in sigmas; detection needs less than the measurement."""


class Filters(NamedTuple):
    """Derivative-of-Gaussian filters: the first one detects ridges, the others, by ascending sigma, refine them."""

    taps: Float32[Array, "filter derivative=2 tap"]
    """First and second derivative, from the middle tap on; the first is odd (positive downwards), the second even."""
    figures: Float64[Array, "filter figure=4"]
    """Sigma, taps on one side, and the response of each derivative to white noise of standard deviation 1."""


@lru_cache(maxsize=16)
def stripe_filters(ridge_sigma_px: float) -> Filters:
    """The detection filter of that sigma, and the refinement filters."""
    steps = np.arange(REFINING_FILTERS) / FILTERS_AN_OCTAVE
    sigmas = [ridge_sigma_px, *(FINEST_SIGMA_PX * 2**steps)]
    reaches = [math.ceil(sigma * (RIDGE_REACH if i == 0 else REFINING_REACH)) for i, sigma in enumerate(sigmas)]
    taps = np.zeros((len(sigmas), 2, max(reaches) + 1))
    figures = np.zeros((len(sigmas), 4))
    for i, (sigma, reach) in enumerate(zip(sigmas, reaches, strict=True)):
        first, second = _derivatives(sigma, reach)
        taps[i, 0, : reach + 1], taps[i, 1, : reach + 1] = first, second
        figures[i] = sigma, reach, _two_sided_norm(first), _two_sided_norm(second)
    return Filters(taps=taps.astype(np.float32), figures=figures)


def _derivatives(sigma_px: float, reach: int) -> tuple[Float64[Array, "tap"], Float64[Array, "tap"]]:
    """Taps of the first and second derivative of a Gaussian, from the middle on; of zero response to a constant."""
    y = np.arange(reach + 1, dtype=np.float64)
    gauss = np.exp(-0.5 * (y / sigma_px) ** 2)
    gauss /= 2 * gauss.sum() - gauss[0]
    second = (y**2 / sigma_px**4 - 1 / sigma_px**2) * gauss
    second -= (2 * second.sum() - second[0]) / (2 * reach + 1)
    return y / sigma_px**2 * gauss, second


def _two_sided_norm(taps: Float64[Array, "tap"]) -> float:
    """Standard deviation of the filter's response to white noise of unit variance."""
    return math.sqrt(2 * float(taps @ taps) - float(taps[0]) ** 2)


def stripe_line_segments(stripes: Stripes, camera: Camera) -> Float64[Array, "segment column=11"]:
    """The straight line segments of the stripes, in undistorted pixels; columns as in `SEGMENT_COLUMNS`."""
    params = SegmentParams(image_width=camera.image_width, border_px=BORDER_PX)
    return straight_segments(stripes.position_px, stripes.sigma_px, stripes.piece, stripes.laser, lens(camera), params)


def straight_segments(
    position_px: Float64[Array, "center xy=2"],
    sigma_px: Float64[Array, "center"],
    piece: Int64[Array, "center"],
    laser: Int64[Array, "piece"],
    lens: Lens,
    params: SegmentParams,
) -> Float64[Array, "segment column=11"]:
    """Straight lines y = middle_y + slope (x - middle_x) through stripe centres, in undistorted pixels.

    Pieces are split at their kinks (Ramer-Douglas-Peucker on running medians of seven) and joined across gaps. Each
    line is fitted twice by least squares, the second time without outliers. Centres must be sorted by piece, then
    column.
    """
    position, sigma = np.ascontiguousarray(position_px), np.ascontiguousarray(sigma_px)
    found = _kernels.stripe_segments(position, sigma, piece, laser, lens, params)
    return np.frombuffer(found, dtype=np.float64).reshape(-1, len(SEGMENT_COLUMNS))


@lru_cache(maxsize=4)
def lens(camera: Camera) -> Lens:
    """Intrinsic parameters of a camera in the form that the kernels expect."""
    matrix = camera.camera_matrix.tolist()
    coefficients = dict(zip(DISTORTION, camera.distortion_coefficients.tolist(), strict=False))
    return Lens(fx=matrix[0][0], fy=matrix[1][1], cx=matrix[0][2], cy=matrix[1][2], **coefficients)


DISTORTION = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""OpenCV's order of the distortion coefficients; a camera has the first five or all of them."""
