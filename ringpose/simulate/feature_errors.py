"""Errors of stripes and break points that optics, speckle and sensor cause, without an image.

A stripe is a Gaussian section of light, multiplied by speckle, blurred by the lens, and sampled by pixels with the
noise of EMVA 1288 (`ringpose.simulate.renderer`, `ringpose.simulate.sensor`). Positions are estimated from it by
weighted least squares; an estimate's variance is u^T C u, with the estimator's influence u and the covariance C of the
noise that the scene really has (ringpose-method(7), section 3). Lengths are in pixels, light is relative to the
stripe's peak.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import erfc, hypot, pi, sqrt

import numpy as np

from ringpose.detect.edge_search import CHANGE
from ringpose.kernels.ends import INSIDE_COLUMNS, OUTSIDE_COLUMNS
from ringpose.simulate.sensor import saturation_dn
from ringpose.types.arrays import Array, Float64
from ringpose.types.scene import Scene

PIXEL_VARIANCE = 1.0 / 12.0
"""Variance of a uniform distribution over one pixel."""

REACH_SIGMAS = 5.0
"""Half height, in sigmas of a stripe, of the rows from which its centre is estimated."""

MIN_PEAK, MIN_PEAK_SIGMAS = 3.0 / 255.0, 4.0
"""Minimum peak of a stripe that is detected, as a share of the saturation value and in standard deviations of a pixel.
"""

MIN_ROWS = 6
"""Minimum number of rows that are not saturated."""

CENTER_PHASE = 0.25
"""Position in its pixel at which a centre's variance is evaluated, midway between the best and the worst one."""

PHASES = np.array([-0.375, -0.125, 0.125, 0.375])
"""Positions in its pixel over which an end's variance is averaged."""

EDGE_COLUMNS = (7, 5)
"""Pixels inside and beyond a visible edge from which its position is estimated."""

PIXEL_GRAIN = 0.5 / sqrt(pi)
"""Correlation length at which the speckle of each pixel is independent."""

WIDTH_SPREAD = 0.1
"""Relative standard deviation of the widths of edges, as the detector assumes."""

LIKELY_WIDTHS = 0.35
"""Standard deviation of the logarithm of an edge's width before its measurement: it may be 0.3 to 1 section."""

MIN_NOISE = 0.01
"""Minimum noise of a column, relative to the stripe's level, in the weights."""

MAX_SPECKLE = 12.0
"""Maximum ratio of speckle to noise in the weights of a section's rows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stripe:
    """The image of one laser's stripe on the ring's face, before the blur by the lens."""

    sigma_px: float
    """Sigma of the stripe's section along an image column."""
    peak_e: float
    """Expected electrons at its peak, if the lens did not blur."""
    background_e: float = 0.0
    """Electrons of other light."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageNoise:
    """Blur and noise of one scene's images."""

    blur_px: float
    contrast: float
    grain_px: float
    """Correlation length (sigma) of the speckle in the sense exp(-distance^2 / (4 grain^2))."""
    dark_e2: float
    """Variance of a pixel without light, in square electrons, that of the subtracted frame included."""
    frames: int
    """Number of frames whose background light contributes shot noise: 2 if one is subtracted."""
    response: float
    """Relative standard deviation of the pixels' response."""
    full_e: float
    """Electrons at which a pixel saturates."""

    @property
    def blurred_grain_px(self) -> float:
        """Correlation length of the speckle behind the lens."""
        return sqrt(self.grain_px**2 + self.blur_px**2)


def image_noise(scene: Scene, *, subtracted: bool) -> ImageNoise:
    """The noise of a scene's frames; `subtracted` if a frame without the lasers is subtracted."""
    sensor, frames = scene.sensor, 2 if subtracted else 1
    gain = sensor.overall_system_gain_dn_per_e
    full_dn = (saturation_dn(sensor) - sensor.black_level_dn) / gain
    return ImageNoise(
        blur_px=scene.lens.blur_px,
        contrast=scene.speckle.contrast,
        grain_px=max(scene.speckle.grain_px, 1.0) * PIXEL_GRAIN,
        dark_e2=frames * (sensor.temporal_dark_noise_e**2 + PIXEL_VARIANCE / gain**2),
        frames=frames,
        response=sensor.photo_response_non_uniformity,
        full_e=min(full_dn, sensor.saturation_capacity_e),
    )


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
        """Standard deviation of a line fitted to this number of columns, in its middle; twice as large at its ends."""
        variance = self.speckle_px**2 * min(self.correlation_columns, columns) + self.independent_px**2
        return sqrt(variance / max(columns, 1.0))


def center_errors(stripe: Stripe, noise: ImageNoise) -> CenterErrors | None:
    """Errors of a stripe's centre that is fitted in one column.

    The fit has a Gaussian section, its offset, and a background with a slope. As in the detector, rows are weighted for
    independent noise and speckle. None if the stripe is too faint for the detector, or so bright that too few rows are
    not saturated.
    """
    sigma, section, peak_e = _blurred_section(stripe, noise)
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
    influence = _weighted_fit((shapes * weight) @ shapes.T, shapes, weight, 3)
    return CenterErrors(
        speckle_px=noise.contrast
        * sqrt(noise.grain_px / noise.blurred_grain_px * _speckle_sum(influence, y, sigma, section, noise)),
        independent_px=sqrt(float(influence**2 @ sensor)),
        correlation_columns=2.0 * sqrt(pi) * noise.blurred_grain_px,
        saturated=not bool(shown.all()),
    )


def end_errors_px(
    stripe: Stripe, noise: ImageNoise, edge_per_row: Float64[Array, "end"], pooled: int
) -> Float64[Array, "end"]:
    """Standard deviations, along the stripe, of its ends.

    As in the detector: maximum likelihood of an error function between a level inside and one outside, in the
    amplitudes of the columns. The width of the error function is an average over the `pooled` ends in the image.
    `edge_per_row`: displacement of the edge along the stripe, in columns, per row across it.
    """
    sigma, section, peak_e = _blurred_section(stripe, noise)
    template = sqrt(section**2 + noise.blur_px**2)
    rows = 1.0 / sqrt(template**-2 + sigma**-2)  # sigma of the rows that contribute to an amplitude
    surface_width = np.sqrt(PIXEL_VARIANCE + (edge_per_row * rows) ** 2)
    width = np.sqrt(surface_width**2 + noise.blur_px**2)[:, None, None]
    x = np.arange(1.0 - INSIDE_COLUMNS, OUTSIDE_COLUMNS)
    t = (PHASES[:, None] - x) / width
    inside = _normal_cdf(t)
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
    of_position = _weighted_fit(information[..., :3, :3], shapes[..., :3, :], weight, 2)
    information[..., 3, 3] += LIKELY_WIDTHS**-2
    of_width = _weighted_fit(information, shapes, weight, 3)

    # before the blur, each column of the surface has its own speckle, of which the edge cuts off a share
    surface = np.arange(x[0] - 4, x[-1] + 5)
    shown = _normal_cdf((PHASES[:, None] - surface) / surface_width[:, None, None])
    blur = _gauss(x[:, None] - surface, noise.blur_px)

    def variance(influence: Float64[Array, "end phase column"]) -> Float64[Array, "end phase"]:
        seen = (influence @ blur) * shown
        grains = seen @ _speckle_correlation(surface, noise)
        total: Float64[Array, "end phase"] = speckle * (grains * seen).sum(axis=-1)
        return np.asarray(total + (influence**2 * independent).sum(axis=-1))

    position_wrt_width = -(of_position * shapes[..., 3, :]).sum(axis=-1)
    own, common = _width_weights(variance(of_width), pooled)
    total = variance(of_position + (position_wrt_width * own)[..., None] * of_width)
    total += (position_wrt_width * common) ** 2
    return np.asarray(np.sqrt(total.mean(axis=-1)))


@lru_cache(maxsize=4)
def edge_step_influence(blur_px: float) -> tuple[Float64[Array, "offset"], float]:
    """Sensitivity of a measured edge's position, for a step of brightness of height 1.

    First, by how many pixels light of 1 at the pixels 1, 2, ... px beyond the edge displaces the position; second, the
    standard deviation of the position if that of each pixel is 1. As in the detector, light beyond the edge is expected
    to vary, the more the farther it is from the edge.
    """
    width = hypot(blur_px, sqrt(PIXEL_VARIANCE))
    x = np.arange(-EDGE_COLUMNS[0], EDGE_COLUMNS[1] + 1.0)
    inside = _normal_cdf(-x / width)
    bell = np.exp(-0.5 * (x / width) ** 2) / sqrt(2 * pi) / width
    shapes = np.stack([inside, 1.0 - inside, bell])
    weight = 1.0 / (1.0 + (CHANGE * np.maximum(x, 0.0)) ** 2)
    influence = _weighted_fit((shapes * weight) @ shapes.T, shapes, weight, 2)
    return influence[x > 0], sqrt(float(influence @ influence))


def _width_weights(
    variance: Float64[Array, "end phase"], pooled: int
) -> tuple[Float64[Array, "end phase"], Float64[Array, "end phase"]]:
    """Weight of an end's own width in the width that is used, and the standard deviation due to the other ends.

    The detector uses the weighted mean of the end's own width and the mean of all `pooled` ends, whose true widths
    differ.
    """
    information = 1.0 / variance
    others = 1.0 / ((variance + WIDTH_SPREAD**2) / pooled + WIDTH_SPREAD**2)
    each = others / pooled / (information + others)
    own: Float64[Array, "end phase"] = information / (information + others) + each
    return own, each * np.sqrt((pooled - 1) * (variance + WIDTH_SPREAD**2))


def _weighted_fit(
    information: Float64[Array, "*shape unknown unknown"],
    shapes: Float64[Array, "*shape unknown n"],
    weight: Float64[Array, "*shape n"],
    unknown: int,
) -> Float64[Array, "*shape n"]:
    """Influence of each value on one unknown of a weighted linear fit."""
    unit = np.zeros((information.shape[-1], 1))
    unit[unknown] = 1.0
    row = np.linalg.solve(information, np.broadcast_to(unit, (*information.shape[:-1], 1)))
    influence: Float64[Array, "*shape n"] = (row * shapes).sum(axis=-2) * weight
    return influence


def _blurred_section(stripe: Stripe, noise: ImageNoise) -> tuple[float, float, float]:
    """Sigma of a section sampled by pixels, before and after the blur by the lens, and its peak (electrons) after."""
    sigma = sqrt(stripe.sigma_px**2 + PIXEL_VARIANCE)
    section = sqrt(sigma**2 + noise.blur_px**2)
    return sigma, section, stripe.peak_e * stripe.sigma_px / section


def _speckle_sum(
    influence: Float64[Array, "row"], y: Float64[Array, "row"], sigma: float, section: float, noise: ImageNoise
) -> float:
    """Variance of a weighted sum of a section's rows by speckle of unit contrast."""
    surface = np.arange(y[0] - 4, y[-1] + 5)
    light = section / sigma * np.exp(-0.5 * (surface / sigma) ** 2)  # the blurred section has peak 1
    seen = influence @ _gauss(y[:, None] - surface, noise.blur_px) * light
    return float(seen @ _speckle_correlation(surface, noise) @ seen)


def _speckle_correlation(at: Float64[Array, "n"], noise: ImageNoise) -> Float64[Array, "n n"]:
    """Correlation of the speckle of neighbouring pixels before the blur; independent up to a grain of one pixel."""
    lag = at[:, None] - at
    if noise.grain_px <= PIXEL_GRAIN:
        return np.eye(len(at))
    return np.exp(-(lag**2) / (4 * noise.grain_px**2))


def _gauss(offset: Float64[Array, "*shape"], sigma: float) -> Float64[Array, "*shape"]:
    """Sampled Gaussian of unit sum; the identity for sigma 0."""
    if sigma == 0.0:
        return (np.abs(offset) < 0.5).astype(np.float64)
    return np.asarray(np.exp(-0.5 * (offset / sigma) ** 2) / (sqrt(2 * pi) * sigma))


def _normal_cdf(x: Float64[Array, "*shape"]) -> Float64[Array, "*shape"]:
    return np.asarray(np.interp(x, _CDF_AT, _CDF))


_CDF_AT = np.linspace(-6.0, 6.0, 2401)
_CDF = np.array([0.5 * erfc(-each / sqrt(2.0)) for each in _CDF_AT.tolist()])
