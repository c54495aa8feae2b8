"""Extraction of the laser stripes: sub-pixel centres and straight line segments (ringpose-method(7), section 3).

Stripes run roughly along the image rows. In each column a stripe is a ridge: the second derivative of the
Gaussian-smoothed grey values has a minimum, and the centre is the adjacent zero of the first derivative; the centre of
a speckled stripe is estimated from its flanks. Centres are linked along x into pieces.

The intersection of a light plane with a planar surface is a straight line. Pieces are therefore cut at kinks and joined
across gaps, in the undistorted image: the stripe on the ring's face is one such segment, and walls or foil
behind it add segments of other directions or offsets.

A ghost is a fainter copy of all laser light in a frame, some rows beside it: light that is reflected twice, between the
surfaces of lens, filter and sensor. Offset and ratio are the same along the whole image, and the copy has the same
speckle, from column to column, which light of another laser or on another surface does not have.

The centres are computed in kernels/stripes: stripe_search.c (noise, coarse search, ridges), stripe_patches.c (image
patches and their derivatives), stripe_links.c (ridges linked into pieces), stripe_centers.c (sub-pixel centres) and
stripe_sigmas.c (standard deviations).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ringpose.detect.difference_images import LaserImage
from ringpose.estimate.solver import CERTAIN_SIGMAS
from ringpose.geometry.least_squares import STD_PER_MAD, robust_std
from ringpose.kernels import _kernels, kernel_record
from ringpose.kernels.lines import MIDDLE_X, MIDDLE_Y, SEGMENT_COLUMNS, SLOPE, Lens, SegmentParams
from ringpose.optics.feature_errors import BORDER_PX, MAX_SPECKLE, MIN_PEAK, MIN_PEAK_SIGMAS, REACH_SIGMAS
from ringpose.types.arrays import Array, Float32, Float64, Int32, Int64, UInt
from ringpose.types.detection import UNLABELLED, Stripes, SubtractedGhost
from ringpose.types.image import full_scale_dn
from ringpose.types.rig import Camera, LaserGhost

STRIPE_SIGMA_PX = 1.6
"""Width (sigma) of a typical stripe, for converting a peak value into a response of the ridge filter."""

COARSE_SHARE = 0.27
"""Ratio of the mean over the 8 rows of a window to the filter response times the cube of the filter's sigma, for a
narrow ridge: sqrt(2 pi) / 8 = 0.31, less at the least favourable position in the grid of windows."""

BLOCK, CELL = _kernels.BLOCK, _kernels.CELL
"""Columns that are processed together, and rows of a cell of the coarse search; a cell is one block wide."""

FILTER_SIGMA_PX = 2.5
"""Smoothing along the column for detection. Stripes up to twice as wide are found, and flat-topped, saturated ones up
to 40 px; neighbouring stripes are resolved from a distance of about 2.5 of these sigmas. For the measurement, the
filter is selected for each piece."""

SAME_STRIPE_PX = 3.0
"""Largest distance of a centre from the line of its stripe: half of that at which two stripes are told apart."""

MIN_COLUMNS = 8
"""Minimum length of a piece, or of the overlap of two edges: noise may link over a few columns by chance."""

MAX_GAP = 2
"""Largest number of missing columns inside a piece."""


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
        coarse_per_response=COARSE_SHARE * FILTER_SIGMA_PX**3 * 2 * CELL * BLOCK,
        full_dn=full_dn,
    )
    centers = stripe_centers(image, dark, bands, stripe_filters(FILTER_SIGMA_PX), params)
    pieces = int(centers.piece[-1]) + 1 if len(centers.piece) else 0
    return Stripes(
        position_px=centers.position_px,
        sigma_px=centers.sigma_px,
        peak_dn=centers.peak_dn,
        piece=centers.piece,
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
    continue_sigmas: float = MIN_PEAK_SIGMAS
    """Response over its noise that every column must have."""
    gap: int = MAX_GAP
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


REFINING_SIGMAS_PX = np.geomspace(1.0, 10.0, 11)
"""Refinement filters: with this spacing the nearest one loses less than 1 % of accuracy."""

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
    sigmas = [ridge_sigma_px, *REFINING_SIGMAS_PX]
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


def stripe_line_segments(stripes: Stripes, camera: Camera) -> Float64[Array, "segment column=12"]:
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
) -> Float64[Array, "segment column=12"]:
    """Straight lines y = middle_y + slope (x - middle_x) through stripe centres, in undistorted pixels.

    Pieces are split at their kinks (Ramer-Douglas-Peucker on running medians of seven) and joined across gaps. Each
    line is fitted twice by least squares, the second time without outliers. Centres must be sorted by piece, then
    column.
    """
    position, sigma = np.ascontiguousarray(position_px), np.ascontiguousarray(sigma_px)
    rows = _kernels.stripe_segments(position, sigma, piece, laser, lens, params)
    return np.frombuffer(rows, dtype=np.float64).reshape(-1, len(SEGMENT_COLUMNS))


def line_y_px(segments: Float64[Array, "*segment column=12"], x_px: float | Float64[Array, "..."]) -> Array:
    """Rows of the lines of segments at the columns `x_px`, which are one each, or all of one segment, or one of all."""
    return np.asarray(segments[..., MIDDLE_Y] + segments[..., SLOPE] * (x_px - segments[..., MIDDLE_X]))


@lru_cache(maxsize=4)
def lens(camera: Camera) -> Lens:
    """Intrinsic parameters of a camera in the form that the kernels expect."""
    matrix = camera.camera_matrix.tolist()
    coefficients = dict.fromkeys(DISTORTION, 0.0)
    coefficients |= dict(zip(DISTORTION, camera.distortion_coefficients.tolist(), strict=False))
    return Lens(fx=matrix[0][0], fy=matrix[1][1], cx=matrix[0][2], cy=matrix[1][2], **coefficients)


DISTORTION = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""OpenCV's order of the distortion coefficients; a camera has the first five or all of them."""


# Ghosts

MAX_GHOST_ROWS = 60
"""Largest offset of a ghost that is sought: twice that of a reflection between a sensor and its cover glass. With half
of it those of filters before the lens are missed, with twice as much more stripes of other lasers are compared."""

MAX_GHOST_RATIO = 0.5
"""Largest brightness of a ghost, as a share of the light that it copies: two reflections at coated or bare glass give
up to 0.35. It says which of two stripes is the copy: twice as much would leave that open, half would miss some."""

GHOST_ROWS = 0.75
"""Largest deviation of a pair of centres from the offset of a ghost: three standard deviations of a centre in speckle.
Half of it loses centres in strong light, and twice as much admits neighbouring stripes, whose distance varies."""

SAME_SPECKLE = 0.5
"""Correlation, from column to column, of the brightness of a stripe and of its ghost. Copies in 69 rendered frames have
0.6 to 0.98, different stripes in 249 frames at most 0.45; with 0.25 these are taken for ghosts, with 1 none is."""

LONG_COLUMNS = 30
"""Columns of a ghost from which that correlation is known: its error is 0.13. Minimum length of segments that are
examined for another explanation; shorter ones may be reflections, or on facets of foil."""


def without_ghosts(
    images: Sequence[LaserImage],
    parts: Sequence[Stripes],
    known: Sequence[SubtractedGhost],
    of_lasers: Mapping[int, LaserGhost],
    stripes_of: Callable[[LaserImage], Stripes],
) -> tuple[list[LaserImage], list[Stripes], tuple[SubtractedGhost, ...]]:
    """Frames and their stripes without ghosts, and without reflections in frames of one laser; and the ghosts.

    A frame that does not show a ghost by itself is searched for those that the rig states `of_lasers`, for those of the
    other frames, and for known ones. `stripes_of` finds the stripes of a frame from which one was subtracted.
    """
    pairs = [_pairs_in_columns(part) for part in parts]
    own_px = [_ghost_offset_px(part, of_part) for part, of_part in zip(parts, pairs, strict=True)]
    others_px = [*own_px, *(ghost.offset_px for ghost in known)]
    clean_images, clean_parts, ghosts = [], [], []
    for image, part, of_part, offset_px in zip(images, parts, pairs, own_px, strict=True):
        stated = [of_lasers[laser] for laser in image.lasers if laser in of_lasers]
        offsets_px = (offset_px, *(each.offset_px for each in stated), *others_px)
        ghost = _ghost_at(image, part, [each for each in offsets_px if each is not None], stated)
        clean, stripes, of_stripes = image, part, of_part
        if ghost is not None:
            ghosts.append(ghost)
            clean = _without_ghost(image, ghost)
            stripes = stripes_of(clean)
            of_stripes = _pairs_in_columns(stripes)
        clean_images.append(clean)
        clean_parts.append(_without_reflections(stripes, of_stripes, image.label, ghost))
    return clean_images, clean_parts, tuple(ghosts)


def shown_ghost(image: LaserImage) -> SubtractedGhost | None:
    """The ghost that the stripes of a frame, along its rows, show by themselves; None if they show none."""
    stripes = find_stripes(image.lit, image.dark, saturation_dn=image.threshold_scale_dn)
    offset_px = _ghost_offset_px(stripes, _pairs_in_columns(stripes))
    return None if offset_px is None else _ghost_at(image, stripes, [offset_px], ())


MIN_GHOSTS = 3
"""Frames that must show a ghost for the rig to have it: fewer have no scatter. Twice as many are more than the stripes
of a laser in a usual calibration; half would take one board's reflection for it."""


def ghost_of_rig(ghosts: Sequence[SubtractedGhost]) -> LaserGhost | None:
    """The ghost of a laser by those of its frames, with the scatter between these; None if too few show the same one.

    A reflection of a board or a target, or another stripe, has another offset in every view.
    """
    offset_px, ratio = np.array([[each.offset_px, each.ratio] for each in ghosts]).reshape(-1, 2).T
    same = np.abs(offset_px - np.median(offset_px)) < GHOST_ROWS if len(ghosts) else np.zeros(0, dtype=bool)
    if np.count_nonzero(same) < max(MIN_GHOSTS, len(ghosts) / 2):
        return None
    return LaserGhost(
        offset_px=float(offset_px[same].mean()),
        offset_sd_px=float(offset_px[same].std(ddof=1)),
        ratio=float(ratio[same].mean()),
        ratio_sd=float(ratio[same].std(ddof=1)),
    )


class Pairs(NamedTuple):
    """Indices of two centres in one column."""

    brighter: Int64[Array, "pair"]
    fainter: Int64[Array, "pair"]


def _ghost_offset_px(stripes: Stripes, pairs: Pairs) -> float | None:
    """Row of the copy less that of the light, of a ghost that the stripes of one frame show; None if they show none.

    The most frequent offset in rows between two centres of a column, of which one is fainter, is that of a ghost if the
    brightness of both has the same speckle.
    """
    column, row = stripes.position_px.T
    peak_dn = stripes.peak_dn
    light, copy = pairs
    offset_px = row[copy] - row[light]
    possible = (peak_dn[copy] < MAX_GHOST_RATIO * peak_dn[light]) & (np.abs(offset_px) <= MAX_GHOST_ROWS)
    light, copy, offset_px = light[possible], copy[possible], offset_px[possible]
    if len(offset_px) < LONG_COLUMNS:
        return None
    count = np.convolve(np.bincount(np.rint(2.0 * (offset_px + MAX_GHOST_ROWS)).astype(np.int64)), np.ones(3), "same")
    near = np.abs(offset_px - (0.5 * float(count.argmax()) - MAX_GHOST_ROWS)) < GHOST_ROWS
    near = np.abs(offset_px - np.median(offset_px[near])) < GHOST_ROWS
    light, copy = light[near], copy[near]
    is_copy = _speckle_correlation(column[light], peak_dn[light], peak_dn[copy]) > SAME_SPECKLE
    return float(np.median(offset_px[near])) if is_copy else None


def _pairs_in_columns(stripes: Stripes) -> Pairs:
    """All pairs of centres in one column."""
    order = np.argsort(stripes.position_px[:, 0], kind="stable")
    column = stripes.position_px[order, 0]
    pairs, lag = [np.zeros((0, 2), dtype=np.int64)], 1
    while lag < len(column) and (same := column[lag:] == column[:-lag]).any():
        first = np.flatnonzero(same)
        pairs.append(np.stack([order[first], order[first + lag]], axis=1))
        lag += 1
    first, second = np.concatenate(pairs).T
    is_first = stripes.peak_dn[first] > stripes.peak_dn[second]
    return Pairs(np.where(is_first, first, second), np.where(is_first, second, first))


def _speckle_correlation(
    column: Float64[Array, "pair"], light_dn: Float64[Array, "pair"], copy_dn: Float64[Array, "pair"]
) -> float:
    """Correlation of the changes of log brightness from column to column; 0 for too few columns.

    Changes are limited to twice their scatter: the ends of all stripes on a face are in nearly the same columns.
    """
    order = np.argsort(column, kind="stable")
    neighbours = np.diff(column[order]) == 1.0
    if np.count_nonzero(neighbours) < LONG_COLUMNS:
        return 0.0
    changes = [np.diff(np.log(each[order]))[neighbours] for each in (light_dn, copy_dn)]
    limits = [2.0 * STD_PER_MAD * float(np.median(np.abs(change))) for change in changes]
    if min(limits) == 0.0:
        return 0.0
    light, copy = (np.clip(change, -limit, limit) for change, limit in zip(changes, limits, strict=True))
    return float(np.corrcoef(light, copy)[0, 1])


def _ghost_at(
    image: LaserImage, stripes: Stripes, offsets_px: Sequence[float], stated: Sequence[LaserGhost]
) -> SubtractedGhost | None:
    """The ghost at the first of some offsets at which a frame shows one; None if it does at none of them.

    Its ratio is the mean, by their variances, of the measured one and of the one that the rig states, unless these
    contradict each other. Of saturated stripes the latter is the only one.
    """
    if not offsets_px or len(stripes.piece) < LONG_COLUMNS:
        return None
    for offset_px in offsets_px:
        ratio, sigma = _ghost_ratio(image, stripes, offset_px)
        for each in stated:
            close = math.hypot(GHOST_ROWS, CERTAIN_SIGMAS * each.offset_sd_px)
            agrees = abs(each.ratio - ratio) < CERTAIN_SIGMAS * math.hypot(each.ratio_sd, sigma)
            if abs(each.offset_px - offset_px) < close and agrees:
                weight = 1.0 if math.isinf(sigma) else sigma**2 / (sigma**2 + each.ratio_sd**2)
                ratio, sigma = ratio + weight * (each.ratio - ratio), math.sqrt(weight) * each.ratio_sd
                break
        if CERTAIN_SIGMAS * sigma < ratio < MAX_GHOST_RATIO:
            return SubtractedGhost(offset_px=offset_px, ratio=ratio)
    return None


def _ghost_ratio(image: LaserImage, stripes: Stripes, offset_px: float) -> tuple[float, float]:
    """The ratio of a ghost of this offset, and its standard deviation: infinite where the frame does not show it.

    It is the median, over the brighter half of the stripes' centres that are not saturated, of the light there less
    that on the other side of the stripe, which is the stripe's own, over the light at the stripe.
    """
    light, half = _laser_light(image), int(SAME_STRIPE_PX)
    column, row = np.rint(stripes.position_px).astype(np.int64).T
    rows = np.arange(-half, half + 1)  # twice the width of a stripe
    reach = math.ceil(abs(offset_px)) + half
    inside = (image.lit[row, column] < image.saturation_dn) & (row >= reach) & (row < len(light) - reach)
    if np.count_nonzero(inside) < LONG_COLUMNS:
        return 0.0, math.inf
    inside &= stripes.peak_dn >= np.median(stripes.peak_dn[inside])
    at, beside, opposite = (
        light[(row[inside] + round(step_px))[:, None] + rows, column[inside, None]].sum(axis=1, dtype=np.float64)
        for step_px in (0.0, offset_px, -offset_px)
    )
    is_light = opposite < at  # a copy has its light on the other side
    if np.count_nonzero(is_light) < LONG_COLUMNS:
        return 0.0, math.inf
    ratios = (beside - opposite)[is_light] / np.maximum(at[is_light], 1.0)
    ratio = float(np.median(ratios))
    return ratio, math.sqrt(math.pi / 2) * robust_std(ratios - ratio) / math.sqrt(len(ratios))  # of a median


def _without_ghost(image: LaserImage, ghost: SubtractedGhost) -> LaserImage:
    """The image less the ghost of its laser light (of all light without a background), to the third order of the ratio.

    The light itself is what is seen, less its ghost; the background has the ghost of the ambient light in both frames.
    How bright the copy of saturated light is is not known: in a frame of one laser it is left out.
    """
    seen = _laser_light(image)
    light = seen - np.float32(ghost.ratio) * _moved_rows(seen, ghost.offset_px)
    copy = np.float32(ghost.ratio) * _moved_rows(light, ghost.offset_px)
    clean = np.rint(image.lit - np.maximum(copy, 0.0)).clip(0.0).astype(image.lit.dtype)
    if image.label == UNLABELLED or image.dark is None:
        return replace(image, lit=clean)
    saturated = (image.lit >= image.saturation_dn) & (image.dark < image.saturation_dn)
    unknown = _moved_rows(saturated.astype(np.float32), ghost.offset_px) > 0.0
    left_out = np.where(unknown, np.subtract(clean, image.dark, dtype=np.float32), np.float32(0.0))
    return replace(image, lit=np.where(unknown, image.dark, clean), left_out=left_out)


def _laser_light(image: LaserImage) -> Float32[Array, "row column"]:
    """The light of the lasers, or all light without a background."""
    return image.lit.astype(np.float32) if image.dark is None else np.subtract(image.lit, image.dark, dtype=np.float32)


def _moved_rows(image: Float32[Array, "row column"], rows: float) -> Float32[Array, "row column"]:
    """The image moved down by a number of rows, which need not be whole; 0 where nothing is moved to."""
    whole = math.floor(rows)
    share = np.float32(rows - whole)
    moved = np.zeros_like(image)
    for step, weight in ((whole, 1 - share), (whole + 1, share)):
        height = max(len(image) - abs(step), 0)
        moved[max(step, 0) :][:height] += weight * image[max(-step, 0) :][:height]
    return moved


def _without_reflections(stripes: Stripes, pairs: Pairs, label: int, ghost: SubtractedGhost | None) -> Stripes:
    """The stripes less pieces of which most columns have a brighter centre: elsewhere, or at the light of a ghost.

    A column of a frame with one laser is nearly one ray of its light sheet, which meets one surface: what is fainter is
    a reflection. (Face and body are lit in the same columns over the parallax between projector and lens only.) In a
    frame with several lasers, what is left of a ghost after its subtraction is a copy of light that was saturated.
    """
    light, copy = pairs
    if label == UNLABELLED:
        row, offset_px = stripes.position_px[:, 1], math.nan if ghost is None else ghost.offset_px
        copy = copy[np.abs(row[copy] - row[light] - offset_px) < GHOST_ROWS]  # none without a ghost
    is_copy = np.zeros(len(stripes.piece), dtype=bool)
    is_copy[copy] = True
    count = len(stripes.laser)
    dropped = 2 * np.bincount(stripes.piece[is_copy], minlength=count) > np.bincount(stripes.piece, minlength=count)
    return stripes.without(dropped[stripes.piece]) if dropped.any() else stripes
