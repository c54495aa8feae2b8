"""One view of a scene, cast once and ready to be lit and exposed as often as wanted.

Light in the camera's pixels, source by source: cast once, light as often as needed.

Light adds up, so one cast gives a layer for the ambient light and one for each laser; every frame of a shot is
a sum of layers. A pixel takes one ray; on a thin stripe, and with ambient light also along visible edges, sixteen;
where an edge cuts a stripe, 256.

One ray for every pixel, through the lens, and sixteen where one is not enough.

Laser speckle: the granularity that limits every stripe centre.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from ringpose.geometry.rays import undistort
from ringpose.simulate.laser_planes import half_thickness_m, in_sheet
from ringpose.simulate.lighting import Intersections, Stand, ambient_radiance, laser_radiance, settled_hits
from ringpose.simulate.sensor import digitised, electrons_per_radiance
from ringpose.simulate.target import EMPTY
from ringpose.types.arrays import Array, Float32, Float64, Int64, UInt8, UInt16
from ringpose.types.camera import Camera
from ringpose.types.image import Frame
from ringpose.types.scene import Beacon, Light, Scene, Sensor, Speckle


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RenderedView:
    """Electrons a second in each pixel by each source of light, and the sensor that collects them."""

    sensor: Sensor
    ambient: Float32[Array, "row column"]
    laser: Float32[Array, "laser row column"]
    generator: np.random.Generator = field(repr=False)
    """Draws each exposure's noise anew."""
    beacon: Beacon | None = None
    beacon_light: Float32[Array, "row column"] | None = None
    """By the beacon, while it is on."""

    def frame(self, lasers: int, exposure_s: float, stamp_s: float) -> Frame:
        """One exposure while the lasers of the mask are on."""
        image = digitised(self.electrons(lasers, exposure_s, stamp_s), self.sensor, self.generator)
        return Frame(image=image, lasers=lasers, stamp_s=stamp_s, exposure_s=exposure_s)

    def electrons(self, lasers: int, exposure_s: float, began_s: float = 0.0) -> Float32[Array, "row column"]:
        """Electrons expected in one exposure."""
        rate = self.ambient_during(began_s, exposure_s)
        for number, stripe in enumerate(self.laser):
            if lasers >> number & 1:
                rate += stripe
        return rate * np.float32(exposure_s)

    def ambient_during(self, began_s: float, exposure_s: float) -> Float32[Array, "row column"]:
        """Electrons a second by all light but the lasers', the mean over an exposure."""
        rate = self.ambient.copy()
        if self.beacon is not None and self.beacon_light is not None:
            rate += np.float32(self.beacon.share_on(began_s, exposure_s)) * self.beacon_light
        return rate


def staged(scene: Scene, stand: Stand, seed: tuple[int, ...]) -> RenderedView:
    """A target in its place, seen through the scene's lens; the seed fixes speckle and noise."""
    generator = np.random.default_rng(seed)
    radiance = layers(stand, pixel_rays(scene.rig.camera))
    scale = np.float32(electrons_per_radiance(scene.sensor, scene.lens))
    beacon = stand.light.beacon
    return RenderedView(
        sensor=scene.sensor,
        ambient=_blurred(scale * radiance.ambient, scene.lens.blur_px),
        laser=np.stack([_stripe(scene, scale * layer, generator) for layer in radiance.laser]),
        generator=generator,
        beacon=beacon,
        beacon_light=None if beacon is None else scale * _beacon_layer(scene, stand, beacon),
    )


def _beacon_layer(scene: Scene, stand: Stand, beacon: Beacon) -> Float32[Array, "row column"]:
    """Radiance by the beacon alone, while it is on, seen through the lens."""
    alone = replace(stand, light=Light(name="beacon", ambient_w_m2=beacon.ambient_w_m2), lasers=())
    return _blurred(layers(alone, pixel_rays(scene.rig.camera)).ambient, scene.lens.blur_px)


def _stripe(
    scene: Scene, layer: Float32[Array, "row column"], generator: np.random.Generator
) -> Float32[Array, "row column"]:
    """A laser's layer with its speckle, seen through the lens; only rows that have light are worked on."""
    lit = np.flatnonzero(layer.any(axis=1))
    stripe = layer.copy()
    if len(lit):
        first, last = int(lit[0]), int(lit[-1]) + 1
        stripe[first:last] *= speckle_pattern(scene.speckle, last - first, layer.shape[1], generator)
    return _blurred(stripe, scene.lens.blur_px)


def _blurred(layer: Float32[Array, "row column"], sigma_px: float) -> Float32[Array, "row column"]:
    if sigma_px == 0.0 or not layer.any():
        return layer
    return np.asarray(cv2.GaussianBlur(layer, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE), dtype=np.float32)


_BLOCK = 1 << 15
"""Rays worked on at a time, so that they stay in the processor's cache."""

_COARSEST_SIGMA = 1.25
"""A stripe is thin where a pixel covers more sigmas than this; the alias of one ray shifts a wider one by < 1e-5 px."""

_WIDE, _THIN = np.uint8(1), np.uint8(2)
"""Marks of pixels near a stripe."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layers:
    """Radiance in W/(m2 sr), averaged over each pixel."""

    ambient: Float32[Array, "row column"]
    laser: Float32[Array, "laser row column"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelRays:
    """Rays (x, y, 1) through the pixels' centres, and how they turn within a pixel."""

    direction: Float64[Array, "xy=2 pixel"]
    per_px: Float64[Array, "axis=2 xy=2 pixel"]
    """Change of (x, y) for one pixel along the row, and for one along the column."""
    height: int
    width: int

    @property
    def angle_per_px(self) -> float:
        """What one pixel covers at depth 1, in the middle of the picture."""
        return float(np.abs(self.per_px[:, :, self.direction.shape[1] // 2 + self.width // 2]).max())


def layers(stand: Stand, rays: PixelRays) -> Layers:
    """What each source of light sends into each pixel."""
    radiance, coarse, fine = _one_ray_a_pixel(stand, rays)
    for refined, samples in ((coarse, SAMPLES), (fine, FINE_SAMPLES)):
        for block in _blocks(len(refined), _BLOCK // samples):
            radiance[:, refined[block]] = _sampled(stand, rays, refined[block], samples)
    ambient, *laser = radiance.reshape(-1, rays.height, rays.width)
    return Layers(ambient=ambient, laser=np.stack(laser))


def _one_ray_a_pixel(
    stand: Stand, rays: PixelRays
) -> tuple[Float32[Array, "source pixel"], Int64[Array, "coarse"], Int64[Array, "fine"]]:
    """Radiance by one ray a pixel, ambient light first, and the pixels that need more rays."""
    pixels, lasers = rays.height * rays.width, len(stand.sheets.distance_m)
    radiance, stripe = np.zeros((1 + lasers, pixels), np.float32), np.zeros(pixels, np.uint8)
    code = np.zeros(pixels, np.uint16)
    for block in _blocks(pixels, _BLOCK):
        direction = stand.placement.vectors_target(centre_directions(rays, block))
        hit, hits, footprint_m = _cast(stand, direction, rays.angle_per_px)
        radiance[0, block][hit], shadowed = ambient_radiance(stand, hits)
        code[block][hit] = ((hits.surface.astype(np.uint16) + 1) << (lasers + 1)) | shadowed
        for laser in stand.lasers:
            near = np.flatnonzero(in_sheet(stand.sheets, laser, hits.point, footprint_m))
            radiance[1 + laser, block][hit[near]], shadowed = laser_radiance(stand, hits.at(near), laser)
            code[block][hit[near]] |= shadowed.astype(np.uint16) << (laser + 1)
            sigma_m = half_thickness_m(stand.sheets.light, footprint_m[near] / rays.angle_per_px)
            stripe[block][hit[near]] |= np.where(footprint_m[near] > _COARSEST_SIGMA * sigma_m, _THIN, _WIDE)
    return radiance, *_to_refine(code, stripe, rays, everywhere=stand.is_lit)


def _to_refine(
    code: UInt16[Array, "pixel"], stripe: UInt8[Array, "pixel"], rays: PixelRays, *, everywhere: bool
) -> tuple[Int64[Array, "coarse"], Int64[Array, "fine"]]:
    """Pixels for some rays and for many.

    Some: on a thin stripe, and, if ambient light shows them, on edges, where neighbours show another surface or
    another side of a shadow. Many: where an edge cuts a stripe, which is what break points are measured from.
    """
    around, shape = np.ones((3, 3), np.uint8), (rays.height, rays.width)
    picture = code.reshape(shape)
    edge = cv2.dilate(picture, around) != cv2.erode(picture, around)
    fine = edge & (cv2.dilate(stripe.reshape(shape), around) > 0)
    coarse = cv2.dilate(stripe.reshape(shape) & _THIN, around) > 0
    if everywhere:
        coarse |= edge
    return np.flatnonzero(coarse & ~fine), np.flatnonzero(fine)


def _cast(
    stand: Stand, direction: Float64[Array, "xyz=3 ray"], angle_per_px: float
) -> tuple[Int64[Array, "hit"], Intersections, Float64[Array, "hit"]]:
    """The rays that meet something, where, and what a pixel covers there.

    If only lasers shine, only what is near a sheet counts: four pixels, so that the neighbours of a stripe are known.
    """
    eye = stand.placement.eye_m
    parameter, surface = stand.target.first_hits(eye, direction)
    hit = np.flatnonzero(surface != EMPTY)
    if not stand.is_lit:
        flat = eye[:, None] + parameter[hit] * direction[:, hit]
        slack_m = stand.target.relief_m + 4.0 * angle_per_px * parameter[hit]
        near = [in_sheet(stand.sheets, laser, flat, slack_m) for laser in stand.lasers]
        hit = hit[np.any(near, axis=0)] if near else hit[:0]
    hits = settled_hits(stand, direction[:, hit], parameter[hit], surface[hit])
    return hit, hits, angle_per_px * parameter[hit]


def _sampled(stand: Stand, rays: PixelRays, pixels: Int64[Array, "n"], samples: int) -> Float64[Array, "source n"]:
    """Mean over each pixel's samples: ambient light, then laser by laser."""
    direction = stand.placement.vectors_target(sample_directions(rays, pixels, samples))
    hit, hits, _ = _cast(stand, direction, rays.angle_per_px)
    of_sources = [(0, ambient_radiance(stand, hits)[0])]
    of_sources += [(1 + laser, laser_radiance(stand, hits, laser)[0]) for laser in stand.lasers]
    means = np.zeros((1 + len(stand.sheets.distance_m), len(pixels)))
    for source, radiance in of_sources:
        of_rays = np.zeros(samples * len(pixels))
        of_rays[hit] = radiance
        means[source] = of_rays.reshape(samples, -1).mean(axis=0)
    return means


def _blocks(length: int, block: int) -> Iterator[slice]:
    for start in range(0, length, block):
        yield slice(start, min(start + block, length))


SAMPLES = 16
"""Samples of a refined pixel: an edge moves by 0.003 px rms against 256 of them."""

FINE_SAMPLES = 256
"""Samples of a pixel in which an edge cuts a stripe: sixteen moved a stripe's end by up to 0.06 px."""

_KNOTS = 100
"""Knots each way between which the lens is interpolated: 1e-6 px off for an 8 mm lens."""


@functools.lru_cache(maxsize=2)
def pixel_rays(camera: Camera) -> PixelRays:
    """The rays of a camera; a spline between knots undistorts two million pixels in 30 ms."""
    from scipy.interpolate import RectBivariateSpline

    height, width = camera.image_height, camera.image_width
    knots_x, knots_y = _knots(width), _knots(height)
    knots_px = np.stack(np.meshgrid(knots_x, knots_y), axis=-1)
    splines = [RectBivariateSpline(knots_y, knots_x, part) for part in np.moveaxis(undistort(knots_px, camera), -1, 0)]
    rows, columns = np.arange(height, dtype=np.float64), np.arange(width, dtype=np.float64)
    direction, along_row, along_column = (
        np.stack([spline(rows, columns, dx=of_row, dy=of_column).ravel() for spline in splines])
        for of_row, of_column in ((0, 0), (0, 1), (1, 0))
    )
    return PixelRays(direction=direction, per_px=np.stack([along_row, along_column]), height=height, width=width)


def centre_directions(rays: PixelRays, pixels: slice) -> Float64[Array, "xyz=3 ray"]:
    """Rays through the centres of a run of pixels."""
    x, y = rays.direction[:, pixels]
    return np.stack([x, y, np.ones_like(x)])


def sample_directions(
    rays: PixelRays, pixels: Int64[Array, "n"], samples: int = SAMPLES
) -> Float64[Array, "xyz=3 ray"]:
    """Rays of the samples of some pixels, sample by sample: ray s * n + k is sample s of pixel k."""
    shift_x, shift_y = _shifts_px(pixels, rays.width, samples)
    along_row, along_column = rays.per_px[:, :, None, pixels]
    x, y = rays.direction[:, None, pixels] + shift_x * along_row + shift_y * along_column
    return np.stack([x.ravel(), y.ravel(), np.ones(x.size)])


def _shifts_px(
    pixels: Int64[Array, "n"], width: int, samples: int
) -> tuple[Float64[Array, "sample n"], Float64[Array, "sample #n"]]:
    """As many rows and columns as samples, each taken once (Hammersley's set; a power of two).

    The rows are the same in all pixels, so that a stripe's profile is integrated by the midpoint rule;
    the columns are shifted around from pixel to pixel, so that upright edges show no bands.
    """
    bits, order = samples.bit_length() - 1, np.arange(samples)
    reversed_bits = sum(((order >> bit) & 1) << (bits - 1 - bit) for bit in range(bits))
    turn = np.modf(0.7548776662 * (pixels % width) + 0.5698402910 * (pixels // width))[0]
    across = np.modf(order[:, None] / samples + turn)[0] - 0.5
    return across, ((np.asarray(reversed_bits) + 0.5) / samples - 0.5)[:, None]


def _knots(length: int) -> Float64[Array, "knot"]:
    return np.linspace(-1.0, float(length), _KNOTS)


def speckle_pattern(
    speckle: Speckle, height: int, width: int, generator: np.random.Generator
) -> Float32[Array, "row column"]:
    """A factor of mean 1 and the given contrast for each pixel.

    Log-normal, which at contrast 0.3 differs little from the gamma law of several speckle patterns added up,
    and which keeps mean and contrast exactly whatever the grain. A Gaussian of sigma s correlates over
    2 sqrt(pi) s.
    """
    pattern = generator.standard_normal((height, width), dtype=np.float32)
    if speckle.grain_px > 1.0:
        sigma_px = speckle.grain_px / (2 * np.sqrt(np.pi))
        pattern = np.asarray(cv2.GaussianBlur(pattern, (0, 0), sigma_px), dtype=np.float32)
        pattern /= max(float(pattern.std()), 1e-6)
    variance = np.log1p(speckle.contrast**2)
    factor: Float32[Array, "row column"] = np.exp(np.float32(np.sqrt(variance)) * pattern - np.float32(variance / 2))
    return factor
