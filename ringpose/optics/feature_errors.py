"""Errors of the features of an image: stripe centres, the line through them, stripe ends and visible edges.

A stripe is a Gaussian section of light, multiplied by speckle, blurred by the lens, and sampled by pixels with their
noise. At its end the intensity falls from the level on the face to that beyond as an error function. Positions are
fitted to such profiles by weighted least squares, and have the variance u^T C u, with the influence u of each value on
the position and the covariance C of the values (ringpose-method(7), section 3). The detector measures C in the image;
`center_errors`, `end_errors_px` and `edge_step_influence` compute it from a scene. Lengths are in pixels, light is
relative to the stripe's peak.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import hypot, pi, sqrt

import numpy as np

from ringpose.geometry.least_squares import influence_on
from ringpose.optics.image_noise import PIXEL_VARIANCE, ImageNoise, gauss, normal_cdf, speckle_correlation
from ringpose.types.arrays import Array, Float64
from ringpose.types.rig import Rig

# A stripe that is detected

MIN_PEAK = 3.0 / 255.0
"""Minimum height of a stripe above its surroundings, as a share of the saturation value."""

MIN_PEAK_SIGMAS = 4.0
"""Minimum height in standard deviations of a pixel."""

MIN_ROWS = 6
"""Minimum number of rows that are not saturated."""

MIN_COLUMNS = 10
"""Minimum length of a piece whose direction is usable; 20 mm of ring at 1 m are twice as long."""

BORDER_PX = 3.0
"""Distance from the image's left or right border within which a stripe is regarded as truncated by the image."""

CUT_OFF_PX = 10.0
"""Distance from the image's border within which an end is due to the border, not to the face, and a stripe may be
missed: only those with a complete cross-section are measured, up to 6.5 px beside the upper and lower border."""

AGREEMENT = 3.0
"""Gain in log likelihood by an end that agrees with a ring, the log of its range by chance over its sigma (method(7),
3.14): also the loss by one that is not seen, the largest cost of one that agrees, and the least gain that is not by
chance, in all comparisons of explanations: a factor of 20 in likelihood."""


FULL_WIDTH_SIGMAS = 2.355
"""Full width at half maximum of a Gaussian section, in standard deviations."""


def row_offset_px_m(rig: Rig) -> Float64[Array, "laser"]:
    """By how many pixels each stripe moves across itself when the inverse depth changes by 1/m: f |d / m_y|.

    A face at the depth z is a step of this times 1/z - 1/(z + h) before what lies h behind it (method(7), section 14).
    """
    across = 0 if rig.stripes_along_columns else 1
    focal = rig.camera.camera_matrix[across, across]
    offset: Float64[Array, "laser"] = np.abs(focal * rig.lasers.distance_m / rig.lasers.normal[:, across])
    return offset


@dataclass(frozen=True, slots=True, kw_only=True)
class Stripe:
    """The image of one laser's stripe on the ring's face, before the blur by the lens."""

    sigma_px: float
    """Sigma of the stripe's section along an image column."""
    peak_e: float
    """Expected electrons at its peak, if the lens did not blur."""
    background_e: float = 0.0
    """Electrons of other light."""

    def blurred(self, blur_px: float) -> tuple[float, float, float]:
        """Sigma of the section sampled by pixels, before and after the blur by the lens; its peak (electrons) after."""
        sigma = sqrt(self.sigma_px**2 + PIXEL_VARIANCE)
        section = sqrt(sigma**2 + blur_px**2)
        return sigma, section, self.peak_e * self.sigma_px / section


# Its centre in a column

REACH_SIGMAS = 5.0
"""Half height, in sigmas of a stripe, of the rows from which its centre is estimated; the outer ones determine the
background."""

MAX_SPECKLE = 12.0
"""Maximum ratio of speckle to noise in the weights of a section's rows: with larger ones faint rows, and so a skewed
section, would dominate."""

CENTER_PHASE = 0.25
"""Position in its pixel at which a centre's variance is evaluated, midway between the best and the worst one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CenterErrors:
    """Errors of a stripe's centre that is measured in one column."""

    speckle_px: float
    """Standard deviation due to speckle, which neighbouring columns share."""
    independent_px: float
    """Standard deviation due to the sensor."""
    correlation_columns: float
    """Sum of the speckle's autocorrelation over all lags, in columns."""
    saturated: bool

    @property
    def sigma_px(self) -> float:
        """Standard deviation of a centre."""
        return hypot(self.speckle_px, self.independent_px)

    def line_sigma_px(self, columns: float) -> float:
        """Standard deviation of a line fitted to this number of columns, in its middle."""
        variance = self.speckle_px**2 * min(self.correlation_columns, columns) + self.independent_px**2
        return sqrt(variance / max(columns, 1.0))


def center_errors(stripe: Stripe, noise: ImageNoise) -> CenterErrors | None:
    """Errors of a stripe's centre that is fitted in one column.

    The fit has a Gaussian section, its offset, and a background with a slope; rows are weighted for independent noise
    and speckle. None if the stripe is too faint to be detected, or so bright that too few rows are not saturated.
    """
    sigma, section, peak_e = stripe.blurred(noise.blur_px)
    if peak_e < max(MIN_PEAK * noise.full_e, MIN_PEAK_SIGMAS * sqrt(noise.dark_e2)):
        return None
    reach = int(np.ceil(REACH_SIGMAS * section))
    y = np.arange(-reach, reach + 1) - CENTER_PHASE
    light = np.exp(-0.5 * (y / section) ** 2)
    background = noise.dark_e2 + noise.frames * stripe.background_e
    sensor = (background + light * peak_e) / peak_e**2 + (noise.response * light) ** 2  # variance by row
    grain = noise.contrast * noise.grain_px / noise.blurred_grain_px  # in one pixel of the image
    ratio = min(grain / sqrt(float(sensor.min())), MAX_SPECKLE)
    weight = 1.0 / (1.0 + (ratio * light) ** 2)
    shown = light * peak_e + stripe.background_e < noise.full_e
    if np.count_nonzero(shown) < MIN_ROWS:
        return None
    shapes = np.stack([np.ones_like(y), y / reach, light, light * y / section**2])
    weight *= shown
    influence = influence_on(3, (shapes * weight) @ shapes.T, shapes, weight)
    return CenterErrors(
        speckle_px=noise.contrast
        * sqrt(noise.grain_px / noise.blurred_grain_px * _speckle_sum(influence, y, sigma, section, noise)),
        independent_px=sqrt(float(influence**2 @ sensor)),
        correlation_columns=2.0 * sqrt(pi) * noise.blurred_grain_px,
        saturated=not bool(shown.all()),
    )


def _speckle_sum(
    influence: Float64[Array, "row"], y: Float64[Array, "row"], sigma: float, section: float, noise: ImageNoise
) -> float:
    """Variance of a weighted sum of a section's rows by speckle of unit contrast."""
    surface = np.arange(y[0] - 4, y[-1] + 5)
    light = section / sigma * np.exp(-0.5 * (surface / sigma) ** 2)  # the blurred section has peak 1
    seen = influence @ gauss(y[:, None] - surface, noise.blur_px) * light
    return float(seen @ speckle_correlation(surface, noise) @ seen)


# The line through the centres

MAX_CUT, COLUMNS_PER_CUT = 4, 12
"""Centres at either end of a piece that its line does not use: at most so many, one for so many columns.

An edge that crosses the stripe obliquely cuts its last sections off on one side, which would turn the line, and all
lines of a shot alike.
"""

FIT_DOF_CORRECTION, MIN_SEGMENT_COLUMNS = 5.0, 0.5
"""Degrees of freedom, in independent columns, that a line fit removes from a series, and the minimum that remains.

The line absorbs part of the correlated errors, which then show neither in the scatter nor in the autocorrelation:
without this correction, at 29 columns and a speckle of 4 px (30 mm at 1 m, wide lens), one line in ten was off by three
sigmas.
"""


def fitted_columns(columns: Float64[Array, "stripe"]) -> Float64[Array, "stripe"]:
    """How many of the columns of a stripe its line uses."""
    return columns - 2.0 * np.minimum(columns // COLUMNS_PER_CUT, MAX_CUT)


def tilt_sigma_px(
    middle_sigma_px: Float64[Array, "*#stripe"],
    offset_px: Float64[Array, "*#stripe"],
    fitted_px: Float64[Array, "*#stripe"],
) -> Float64[Array, "*stripe"]:
    """Standard deviation that the slope of a fitted line adds to its ordinate at an offset from its middle.

    `middle_sigma_px` is that of its middle, `fitted_px` the length of the part that was fitted, whose columns have the
    standard deviation fitted_px / sqrt(12).
    """
    return middle_sigma_px * np.abs(offset_px) * (sqrt(12) / fitted_px)


# The end of a stripe

INSIDE_COLUMNS = 24
"""Columns inside the edge from which the level on the face is estimated."""

OUTSIDE_COLUMNS = 12
"""Columns beyond the edge from which the level there is estimated."""

WIDTH_SPREAD = 0.1
"""Relative standard deviation of the blur between ends: depth of field, pixels."""

MIN_NOISE = 0.01
"""Minimum noise of a column relative to the stripe's level, in its weight: glare and the tails of the blur."""

LIKELY_WIDTHS = 0.35
"""Standard deviation of the logarithm of an edge's width before its measurement: it may be 0.3 to 1 section."""

PHASES = np.array([-0.375, -0.125, 0.125, 0.375])
"""Positions in its pixel over which an end's variance is averaged."""


def end_errors_px(
    stripe: Stripe, noise: ImageNoise, edge_per_row: Float64[Array, "end"], pooled: int
) -> Float64[Array, "end"]:
    """Standard deviations, along the stripe, of its ends.

    A column that shows the share s of the stripe has the variance N + S s + C^2 s^2: noise of the pixels, shot noise
    and speckle. Two levels, the position and the width of the error function are fitted by maximum likelihood. The
    width is an average over the `pooled` ends in the image. `edge_per_row`: displacement of the edge along the stripe,
    in columns, per row across it.
    """
    sigma, section, peak_e = stripe.blurred(noise.blur_px)
    template = sqrt(section**2 + noise.blur_px**2)
    rows = 1.0 / sqrt(template**-2 + sigma**-2)  # sigma of the rows that contribute to an amplitude
    surface_width = np.sqrt(PIXEL_VARIANCE + (edge_per_row * rows) ** 2)
    width = np.sqrt(surface_width**2 + noise.blur_px**2)[:, None, None]
    x = np.arange(1.0 - INSIDE_COLUMNS, OUTSIDE_COLUMNS)
    t = (PHASES[:, None] - x) / width
    inside = normal_cdf(t)
    bell = np.exp(-0.5 * t**2) / sqrt(2 * pi)

    gain = 1.0 / (section * sqrt(pi))  # variance of an amplitude over that of a pixel
    dark = gain * (noise.dark_e2 + noise.frames * stripe.background_e) / peak_e**2
    speckle = noise.contrast**2 * noise.grain_px / sqrt(noise.grain_px**2 + rows**2)
    independent = dark + gain * sqrt(2.0 / 3.0) / peak_e * inside + gain * (noise.response * inside) ** 2
    blurred = speckle * noise.grain_px / noise.blurred_grain_px
    weight = 1.0 / np.maximum(independent + blurred * inside**2, MIN_NOISE**2)

    # influence of each column on the position for a given width, and on the (logarithmic) width
    shapes = np.stack([inside, 1.0 - inside, bell / width, -bell * t], axis=-2)
    information = (shapes * weight[..., None, :]) @ shapes.swapaxes(-1, -2)
    of_position = influence_on(2, information[..., :3, :3], shapes[..., :3, :], weight)
    information[..., 3, 3] += LIKELY_WIDTHS**-2
    of_width = influence_on(3, information, shapes, weight)

    # before the blur, each column of the surface has its own speckle, of which the edge cuts off a share
    surface = np.arange(x[0] - 4, x[-1] + 5)
    shown = normal_cdf((PHASES[:, None] - surface) / surface_width[:, None, None])
    blur = gauss(x[:, None] - surface, noise.blur_px)

    def variance(influence: Float64[Array, "end phase column"]) -> Float64[Array, "end phase"]:
        seen = (influence @ blur) * shown
        grains = seen @ speckle_correlation(surface, noise)
        total: Float64[Array, "end phase"] = speckle * (grains * seen).sum(axis=-1)
        return np.asarray(total + (influence**2 * independent).sum(axis=-1))

    position_wrt_width = -(of_position * shapes[..., 3, :]).sum(axis=-1)
    own, common = _width_weights(variance(of_width), pooled)
    total = variance(of_position + (position_wrt_width * own)[..., None] * of_width)
    total += (position_wrt_width * common) ** 2
    return np.asarray(np.sqrt(total.mean(axis=-1)))


def _width_weights(
    variance: Float64[Array, "end phase"], pooled: int
) -> tuple[Float64[Array, "end phase"], Float64[Array, "end phase"]]:
    """Weight of an end's own width in the width that is used, and the standard deviation due to the other ends.

    That is the weighted mean of the end's own width and the mean of all `pooled` ends, whose true widths differ.
    """
    information = 1.0 / variance
    others = 1.0 / ((variance + WIDTH_SPREAD**2) / pooled + WIDTH_SPREAD**2)
    each = others / pooled / (information + others)
    own: Float64[Array, "end phase"] = information / (information + others) + each
    return own, each * np.sqrt((pooled - 1) * (variance + WIDTH_SPREAD**2))


def end_covariance_px2(
    along_sigma_px: Float64[Array, "*end"], across_sigma_px: Float64[Array, "*end"], slope: Float64[Array, "*end"]
) -> Float64[Array, "*end xy=2 xy=2"]:
    """Covariance of an end in the image: the edge's error along the stripe (in columns), the line's in its ordinate."""
    direction = np.stack([np.ones_like(slope), slope], axis=-1)
    covariance = along_sigma_px[..., None, None] ** 2 * direction[..., None] * direction[..., None, :]
    covariance[..., 1, 1] += across_sigma_px**2
    return covariance


# A visible edge of the ring: a step of brightness

CHANGE = 0.7
"""Standard deviation of the intensity beyond the edge, per pixel of distance, in sigmas of the surface's noise."""

STEP_SIGMAS = 5.0
"""Minimum height of a step in standard deviations: with several candidate positions, one of them fits noise well."""

STEP_DN = 2.0
"""Minimum height of a step in grey values: quantization shifts a smaller one."""

BLUR_SIGMA_PX = 0.03
"""Standard deviation of a step's position due to the assumed shape of its blur."""

POINT_SIGMA_PX = 0.5
"""Maximum standard deviation of a point of an edge."""

MINIMUM_POINTS = 12
"""Minimum number of points: fewer may be an accidental alignment."""

EDGE_COLUMNS = (7, 5)
"""Pixels inside and beyond an edge from which its position is estimated."""


def noise_across_edge(beyond_px: Float64[Array, "*shape"]) -> Float64[Array, "*shape"]:
    """Standard deviation of the intensity at a distance beyond the edge, in that of the surface's noise.

    The face has one intensity up to its edge; the light beyond is unknown, and varies the more the farther it is away.
    """
    return np.asarray(np.sqrt(1 + (CHANGE * np.maximum(beyond_px, 0.0)) ** 2))


@lru_cache(maxsize=4)
def edge_step_influence(blur_px: float) -> tuple[Float64[Array, "offset"], float]:
    """Sensitivity of a measured edge's position, for a step of brightness of height 1.

    First, by how many pixels light of 1 at the pixels 1, 2, ... px beyond the edge displaces the position; second, the
    standard deviation of the position if that of each pixel is 1.
    """
    width = hypot(blur_px, sqrt(PIXEL_VARIANCE))
    x = np.arange(-EDGE_COLUMNS[0], EDGE_COLUMNS[1] + 1.0)
    inside = normal_cdf(-x / width)
    bell = np.exp(-0.5 * (x / width) ** 2) / sqrt(2 * pi) / width
    shapes = np.stack([inside, 1.0 - inside, bell])
    weight = noise_across_edge(x) ** -2.0
    influence = influence_on(2, (shapes * weight) @ shapes.T, shapes, weight)
    return influence[x > 0], sqrt(float(influence @ influence))
