"""Ray casting of a view: a layer of light for each source, which frames with any lasers on are composed of.

Light is additive, so that one cast gives a layer for the ambient light and one for each laser; each frame is a sum of
layers. One ray is cast per pixel; 16 on a thin stripe, and with ambient light also along visible edges; 256 where an
edge crosses a stripe. Each laser layer is multiplied by a speckle pattern.
"""

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from ringpose.geometry.rays import undistort
from ringpose.simulate.laser_planes import half_thickness_m, in_sheet
from ringpose.simulate.lighting import (
    IlluminatedTarget,
    Intersections,
    ambient_radiance,
    hits_on_relief,
    laser_radiance,
)
from ringpose.simulate.sensor import digitised, electrons_per_radiance
from ringpose.simulate.target import EMPTY
from ringpose.types.arrays import Array, Float32, Float64, Int64, UInt8, UInt16
from ringpose.types.camera import Camera
from ringpose.types.image import Frame
from ringpose.types.scene import Beacon, Light, Scene, Sensor, Speckle


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RenderedView:
    """Electron rates of each pixel for each light source (1/s), and the sensor."""

    sensor: Sensor
    ambient: Float32[Array, "row column"]
    laser: Float32[Array, "laser row column"]
    generator: np.random.Generator = field(repr=False)
    """Random generator of the noise of each exposure."""
    beacon: Beacon | None = None
    beacon_light: Float32[Array, "row column"] | None = None
    """Electron rate due to the beacon while it is on."""

    def frame(self, lasers: int, exposure_s: float, stamp_s: float) -> Frame:
        """One exposure with the lasers of the mask on."""
        image = digitised(self.electrons(lasers, exposure_s, stamp_s), self.sensor, self.generator)
        return Frame(image=image, lasers=lasers, stamp_s=stamp_s, exposure_s=exposure_s)

    def electrons(self, lasers: int, exposure_s: float, began_s: float = 0.0) -> Float32[Array, "row column"]:
        """Expected electrons of one exposure with the lasers of the mask on."""
        return self.electrons_with([lasers >> number & 1 for number in range(len(self.laser))], exposure_s, began_s)

    def electrons_with(
        self, laser_shares: Sequence[int | float], exposure_s: float, began_s: float
    ) -> Float32[Array, "row column"]:
        """Expected electrons of one exposure in which each laser is on for a share of the time."""
        rate = self.ambient_during(began_s, exposure_s)
        for share, stripe in zip(laser_shares, self.laser, strict=True):
            if share:
                rate += stripe if share == 1 else np.float32(share) * stripe
        return rate * np.float32(exposure_s)

    def ambient_during(self, began_s: float, exposure_s: float) -> Float32[Array, "row column"]:
        """Mean electron rate during an exposure due to all light except the lasers."""
        rate = self.ambient.copy()
        if self.beacon is not None and self.beacon_light is not None:
            rate += np.float32(self.beacon.share_on(began_s, exposure_s)) * self.beacon_light
        return rate


def render_view(scene: Scene, illuminated: IlluminatedTarget, seed: tuple[int, ...]) -> RenderedView:
    """The image of a target through the lens of the scene; the seed determines speckle and noise."""
    generator = np.random.default_rng(seed)
    radiance = layers(illuminated, pixel_rays(scene.rig.camera))
    scale = np.float32(electrons_per_radiance(scene.sensor, scene.lens))
    beacon, beacon_light = illuminated.light.beacon, None
    if beacon is not None:
        light = Light(name="beacon", ambient_w_m2=beacon.ambient_w_m2)
        beacon_radiance = layers(replace(illuminated, light=light, lasers=()), pixel_rays(scene.rig.camera)).ambient
        beacon_light = scale * _blurred(beacon_radiance, scene.lens.blur_px)
    return RenderedView(
        sensor=scene.sensor,
        ambient=_blurred(scale * radiance.ambient, scene.lens.blur_px),
        laser=np.stack([_stripe(scene, scale * layer, generator) for layer in radiance.laser]),
        generator=generator,
        beacon=beacon,
        beacon_light=beacon_light,
    )


def _stripe(
    scene: Scene, layer: Float32[Array, "row column"], generator: np.random.Generator
) -> Float32[Array, "row column"]:
    """The layer of a laser with speckle, blurred by the lens; only rows with light are processed."""
    rows = np.flatnonzero(layer.any(axis=1))
    stripe = layer.copy()
    if len(rows):
        first, last = int(rows[0]), int(rows[-1]) + 1
        stripe[first:last] *= speckle_pattern(scene.speckle, last - first, layer.shape[1], generator)
    return _blurred(stripe, scene.lens.blur_px)


def _blurred(layer: Float32[Array, "row column"], sigma_px: float) -> Float32[Array, "row column"]:
    if sigma_px == 0.0 or not layer.any():
        return layer
    return np.asarray(cv2.GaussianBlur(layer, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE), dtype=np.float32)


_BLOCK = 1 << 15
"""Rays per block, so that a block fits into the processor cache."""

_MAX_PIXEL_SIGMAS = 1.25
"""A stripe is thin where a pixel covers more sigmas than this; one ray per pixel shifts a wider one by < 1e-5 px."""

_WIDE, _THIN = np.uint8(1), np.uint8(2)
"""Masks of pixels near a stripe."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layers:
    """Radiance in W/(m2 sr), averaged over each pixel."""

    ambient: Float32[Array, "row column"]
    laser: Float32[Array, "laser row column"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelRays:
    """Rays (x, y, 1) through the pixels' centres, and their derivatives with respect to the pixel."""

    direction: Float64[Array, "xy=2 pixel"]
    per_px: Float64[Array, "axis=2 xy=2 pixel"]
    """Derivative of (x, y) along the row, and along the column."""
    height: int
    width: int

    @property
    def angle_per_px(self) -> float:
        """Width of a pixel at depth 1, in the image centre."""
        return float(np.abs(self.per_px[:, :, self.direction.shape[1] // 2 + self.width // 2]).max())


def layers(illuminated: IlluminatedTarget, rays: PixelRays) -> Layers:
    """Radiance in each pixel due to each light source."""
    radiance, coarse, fine = _one_ray_per_pixel(illuminated, rays)
    for refined, samples in ((coarse, SAMPLES), (fine, FINE_SAMPLES)):
        for block in _blocks(len(refined), _BLOCK // samples):
            radiance[:, refined[block]] = _sampled(illuminated, rays, refined[block], samples)
    ambient, *laser = radiance.reshape(-1, rays.height, rays.width)
    return Layers(ambient=ambient, laser=np.stack(laser))


def _one_ray_per_pixel(
    illuminated: IlluminatedTarget, rays: PixelRays
) -> tuple[Float32[Array, "source pixel"], Int64[Array, "coarse"], Int64[Array, "fine"]]:
    """Radiance from one ray per pixel, ambient light first, and the pixels that need more rays."""
    pixels, lasers = rays.height * rays.width, len(illuminated.sheets.distance_m)
    radiance, stripe = np.zeros((1 + lasers, pixels), np.float32), np.zeros(pixels, np.uint8)
    code = np.zeros(pixels, np.uint16)
    for block in _blocks(pixels, _BLOCK):
        direction = illuminated.placement.vectors_target(centre_directions(rays, block))
        hit, hits, footprint_m = _cast(illuminated, direction, rays.angle_per_px)
        radiance[0, block][hit], shadowed = ambient_radiance(illuminated, hits)
        code[block][hit] = ((hits.surface.astype(np.uint16) + 1) << (lasers + 1)) | shadowed
        for laser in illuminated.lasers:
            near = np.flatnonzero(in_sheet(illuminated.sheets, laser, hits.point, footprint_m))
            radiance[1 + laser, block][hit[near]], shadowed = laser_radiance(illuminated, hits.at(near), laser)
            code[block][hit[near]] |= shadowed.astype(np.uint16) << (laser + 1)
            sigma_m = half_thickness_m(illuminated.sheets.light, footprint_m[near] / rays.angle_per_px)
            stripe[block][hit[near]] |= np.where(footprint_m[near] > _MAX_PIXEL_SIGMAS * sigma_m, _THIN, _WIDE)
    return radiance, *_to_refine(code, stripe, rays, everywhere=illuminated.has_ambient_light)


def _to_refine(
    code: UInt16[Array, "pixel"], stripe: UInt8[Array, "pixel"], rays: PixelRays, *, everywhere: bool
) -> tuple[Int64[Array, "coarse"], Int64[Array, "fine"]]:
    """Pixels that need 16 rays, and those that need 256.

    16: on a thin stripe, and, with ambient light, on edges, where neighbours show another surface or side of a shadow.
    256: where an edge crosses a stripe, because these pixels determine the break points.
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
    illuminated: IlluminatedTarget, direction: Float64[Array, "xyz=3 ray"], angle_per_px: float
) -> tuple[Int64[Array, "hit"], Intersections, Float64[Array, "hit"]]:
    """Indices of the rays that hit a surface, the intersections, and the width of a pixel there.

    Without ambient light only intersections within four pixels of a light sheet are returned.
    """
    eye = illuminated.placement.eye_m
    parameter, surface = illuminated.target.first_hits(eye, direction)
    hit = np.flatnonzero(surface != EMPTY)
    if not illuminated.has_ambient_light:
        flat = eye[:, None] + parameter[hit] * direction[:, hit]
        slack_m = illuminated.target.relief_m + 4.0 * angle_per_px * parameter[hit]
        near = [in_sheet(illuminated.sheets, laser, flat, slack_m) for laser in illuminated.lasers]
        hit = hit[np.any(near, axis=0)] if near else hit[:0]
    hits = hits_on_relief(illuminated, direction[:, hit], parameter[hit], surface[hit])
    return hit, hits, angle_per_px * parameter[hit]


def _sampled(
    illuminated: IlluminatedTarget, rays: PixelRays, pixels: Int64[Array, "n"], samples: int
) -> Float64[Array, "source n"]:
    """Mean over the samples of each pixel: ambient light, then each laser."""
    direction = illuminated.placement.vectors_target(sample_directions(rays, pixels, samples))
    hit, hits, _ = _cast(illuminated, direction, rays.angle_per_px)
    of_sources = [(0, ambient_radiance(illuminated, hits)[0])]
    of_sources += [(1 + laser, laser_radiance(illuminated, hits, laser)[0]) for laser in illuminated.lasers]
    means = np.zeros((1 + len(illuminated.sheets.distance_m), len(pixels)))
    for source, radiance in of_sources:
        of_rays = np.zeros(samples * len(pixels))
        of_rays[hit] = radiance
        means[source] = of_rays.reshape(samples, -1).mean(axis=0)
    return means


def _blocks(length: int, block: int) -> Iterator[slice]:
    for start in range(0, length, block):
        yield slice(start, min(start + block, length))


SAMPLES = 16
"""Samples of a refined pixel: an edge differs by 0.003 px rms from one with 256 samples."""

FINE_SAMPLES = 256
"""Samples of a pixel in which an edge crosses a stripe: with 16 the end of a stripe was off by up to 0.06 px."""

_KNOTS = 100
"""Knots per axis of the spline of the undistortion, whose error is 1e-6 px for an 8 mm lens."""


@functools.lru_cache(maxsize=2)
def pixel_rays(camera: Camera) -> PixelRays:
    """The rays of a camera, undistorted by a spline, which takes 30 ms for two million pixels."""
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
    """Rays through the centres of consecutive pixels."""
    x, y = rays.direction[:, pixels]
    return np.stack([x, y, np.ones_like(x)])


def sample_directions(
    rays: PixelRays, pixels: Int64[Array, "n"], samples: int = SAMPLES
) -> Float64[Array, "xyz=3 ray"]:
    """Rays through the samples of n pixels; ray s * n + k is sample s of pixel k."""
    shift_x, shift_y = _shifts_px(pixels, rays.width, samples)
    along_row, along_column = rays.per_px[:, :, None, pixels]
    x, y = rays.direction[:, None, pixels] + shift_x * along_row + shift_y * along_column
    return np.stack([x.ravel(), y.ravel(), np.ones(x.size)])


def _shifts_px(
    pixels: Int64[Array, "n"], width: int, samples: int
) -> tuple[Float64[Array, "sample n"], Float64[Array, "sample #n"]]:
    """Offsets of the samples in a pixel: a Hammersley set, whose size is a power of two.

    The rows are the same in all pixels, so that the profile of a stripe is integrated by the midpoint rule;
    the columns are shifted cyclically from pixel to pixel, so that vertical edges show no banding.
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
    """A factor with mean 1 and the given contrast for each pixel.

    Log-normal, which at contrast 0.3 differs little from the gamma distribution of a sum of several speckle patterns,
    and whose mean and contrast do not depend on the grain size. The correlation width of a Gaussian filter with
    standard deviation s is 2 sqrt(pi) s.
    """
    pattern = generator.standard_normal((height, width), dtype=np.float32)
    if speckle.grain_px > 1.0:
        sigma_px = speckle.grain_px / (2 * np.sqrt(np.pi))
        pattern = np.asarray(cv2.GaussianBlur(pattern, (0, 0), sigma_px), dtype=np.float32)
        pattern /= max(float(pattern.std()), 1e-6)
    variance = np.log1p(speckle.contrast**2)
    factor: Float32[Array, "row column"] = np.exp(np.float32(np.sqrt(variance)) * pattern - np.float32(variance / 2))
    return factor
