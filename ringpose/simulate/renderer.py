"""Rendering of a view: a layer of light for each source, which frames with any lasers on are composed of.

Light is additive, so that one cast gives a layer for the ambient light and one for each laser; each frame is a sum of
layers. One ray is cast per pixel; 16 on a thin stripe and, with ambient light, at edges of shadows; 32 beside edges of
surfaces; 256 where these cross a stripe. Of a target that moves during the exposure, each sample is cast at its own
time. Each laser layer is multiplied by a speckle pattern.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from ringpose.geometry.rays import project, undistort
from ringpose.kernels import render
from ringpose.kernels.render import THIN
from ringpose.optics.sensor import digitised, electrons_per_radiance
from ringpose.simulate.light import IlluminatedTarget, caster_view
from ringpose.types.arrays import Array, Float32, Float64, Int16, UInt8
from ringpose.types.image import Frame
from ringpose.types.rig import Camera
from ringpose.types.scene import Beacon, Ghost, Light, Scene, Sensor, Speckle


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
        """One exposure in which the lasers of the mask are on."""
        image = digitised(self.electrons(lasers, exposure_s, stamp_s), self.sensor, self.generator)
        return Frame(image=image, lasers=lasers, stamp_s=stamp_s, exposure_s=exposure_s)

    def frames(self, sequence: Sequence[int], exposure_s: float, stamps_s: Float64[Array, "frame"]) -> list[Frame]:
        """The exposures of a shot; in each, the lasers of its mask are on."""
        return [self.frame(mask, exposure_s, float(stamp)) for mask, stamp in zip(sequence, stamps_s, strict=True)]

    def electrons(self, lasers: int, exposure_s: float, began_s: float = 0.0) -> Float32[Array, "row column"]:
        """Expected electrons of one exposure in which the lasers of the mask are on."""
        return self.electrons_with([lasers >> number & 1 for number in range(len(self.laser))], exposure_s, began_s)

    def electrons_with(
        self, laser_shares: Sequence[int | float], exposure_s: float, began_s: float
    ) -> Float32[Array, "row column"]:
        """Expected electrons of one exposure in which each laser is on for a share of the time."""
        rate = self.ambient_during(began_s, exposure_s)
        for share, stripe in zip(laser_shares, self.laser, strict=True):
            if share:
                rate += stripe if share == 1 else np.float32(share) * stripe
        rate *= np.float32(exposure_s)
        return rate

    def ambient_during(self, began_s: float, exposure_s: float) -> Float32[Array, "row column"]:
        """Mean electron rate during an exposure due to all light except the lasers."""
        rate = self.ambient.copy()
        if self.beacon is not None and self.beacon_light is not None:
            rate += np.float32(self.beacon.share_on(began_s, exposure_s)) * self.beacon_light
        return rate


def render_view(
    scene: Scene, illuminated: IlluminatedTarget, seed: tuple[int, ...], samples: int | None = None
) -> RenderedView:
    """The image of a target through the lens of the scene; the seed determines speckle and noise.

    `samples` is the number of samples of every pixel, as in `layers`; by default each pixel has as many as it needs.
    """
    generator = np.random.default_rng(seed)
    camera = scene.rig.camera
    motion_px = blur_px(illuminated, camera) if len(illuminated.during) > 1 else 0.0
    if motion_px <= BLURRED_PX:
        illuminated = replace(illuminated, during=(illuminated.placement,))
    radiance = layers(illuminated, pixel_rays(camera), blur_px=motion_px, samples=samples)
    scale = np.float32(electrons_per_radiance(scene.sensor, scene.lens))
    ambient = radiance.ambient
    ambient *= scale
    for layer in radiance.laser:
        _make_stripe(scene, layer, scale, generator)
    beacon, beacon_light = illuminated.light.beacon, None
    if beacon is not None:
        light = Light(name="beacon", ambient_w_m2=beacon.ambient_w_m2)
        lamp = replace(illuminated, light=light, lasers=())
        beacon_radiance = layers(lamp, pixel_rays(camera), blur_px=motion_px, samples=samples).ambient
        beacon_light = scale * _blurred(beacon_radiance, scene.lens.blur_px)
    return RenderedView(
        sensor=scene.sensor,
        ambient=_blurred(ambient, scene.lens.blur_px),
        laser=radiance.laser,
        generator=generator,
        beacon=beacon,
        beacon_light=beacon_light,
    )


def _make_stripe(
    scene: Scene, layer: Float32[Array, "row column"], scale: np.float32, generator: np.random.Generator
) -> None:
    """Turn the radiance due to a laser into electron rates, with speckle, blurred by the lens, and with its ghost."""
    rows = np.flatnonzero(layer.any(axis=1))
    if len(rows) == 0:
        return
    first, last = int(rows[0]), int(rows[-1]) + 1
    layer[first:last] *= scale * speckle_pattern(scene.speckle, last - first, layer.shape[1], generator)
    reach_px = int(np.ceil(5 * scene.lens.blur_px))
    near = slice(max(first - reach_px, 0), last + reach_px)
    layer[near] = _blurred(layer[near], scene.lens.blur_px)
    if scene.lasers.ghost is not None:
        layer += ghost_of(layer, scene.lasers.ghost)


def ghost_of(layer: Float32[Array, "row column"], ghost: Ghost) -> Float32[Array, "row column"]:
    """The ghost of a laser's light: fainter, and displaced; linear between rows."""
    matrix = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, ghost.rows_px]])
    moved = cv2.warpAffine(layer, matrix, layer.shape[::-1], flags=cv2.INTER_LINEAR)
    return np.asarray(np.float32(ghost.ratio) * moved, dtype=np.float32)


def _blurred(layer: Float32[Array, "row column"], sigma_px: float) -> Float32[Array, "row column"]:
    if sigma_px == 0.0 or not layer.any():
        return layer
    return np.asarray(cv2.GaussianBlur(layer, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE), dtype=np.float32)


SAMPLES = 16
"""Samples of a pixel on a thin stripe, beside an edge, or at the edge of a shadow of the sun."""

SOFT_SAMPLES = 64
"""Samples of a pixel at the edge of a shadow where the Earth, 17 degrees wide, gives light too: with 16 the penumbra of
the apogee engine at 1 m had errors of 20 % rms."""

EDGE_SAMPLES = 32
"""Samples of a pixel beside an edge of a surface: over 12 rows an edge differs by 0.0036 px rms from one with 1024
samples, with 16 samples by 0.0067 px, with 48 by 0.0032 px."""

FINE_SAMPLES = 256
"""Samples of a pixel in which an edge crosses a stripe: with 16 the end of a stripe was off by up to 0.06 px."""

BLURRED_PX = 0.1
"""Motion of the image during an exposure from which on every sample is cast at its own time."""

WIDE_BLUR_PX = 4.0
"""Motion from which on stripes are refined everywhere; where a surface is smooth they hardly move in the image."""

TIMES = 17
"""Placements of a moving target during an exposure; an odd number, so that one is in the middle."""


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
    angle_per_px: float
    height: int
    width: int


def layers(
    illuminated: IlluminatedTarget, rays: PixelRays, *, blur_px: float = 0.0, samples: int | None = None
) -> Layers:
    """Radiance in each pixel due to each light source; with a number of samples, the same in every pixel.

    One sample gives a preview. `blur_px` is the motion of the image during the exposure.
    """
    view = caster_view(illuminated, rays.angle_per_px, rays.direction, rays.per_px, rays.width)
    image = view.blank_image()
    if samples is not None:
        render.render(view, image, samples=samples)
    else:
        render.render(view, image)
        shape = (rays.height, rays.width)
        has_earthshine = illuminated.light.earth is not None and illuminated.light.sun_w_m2 > 0
        of_shadow = SOFT_SAMPLES if has_earthshine else SAMPLES
        if not illuminated.has_ambient_light:
            of_shadow = 1
        needed = _samples_needed(image.code.reshape(shape), image.stripe.reshape(shape), blur_px, of_shadow).ravel()
        refined = np.flatnonzero(needed > 1)
        tile = refined // rays.width // _TILE_PX * (rays.width // _TILE_PX + 1) + refined % rays.width // _TILE_PX
        refined = refined[np.argsort(tile, kind="stable")]
        for count in (SAMPLES, SOFT_SAMPLES, EDGE_SAMPLES, FINE_SAMPLES):
            render.render(view, image, refined[needed[refined] == count], count, 4 if count == EDGE_SAMPLES else 1)
    radiance = image.radiance.reshape(-1, rays.height, rays.width)
    return Layers(ambient=radiance[0], laser=radiance[1:])


_TILE_PX = 16
"""Side of the squares of pixels that are cast together: rays of neighbouring pixels pass the same few parts."""


def _samples_needed(
    code: Array, stripe: UInt8[Array, "row column"], blur_px: float, of_shadow: int
) -> Int16[Array, "row column"]:
    """Samples of each pixel; 1 where one is enough. `of_shadow` are those at edges of shadows, 1 without ambient light.

    With ambient light edges are refined everywhere; otherwise only thin stripes, and edges of surfaces and of lasers'
    shadows where they cross a stripe, because these pixels determine the break points. A blur of up to 1.25 px adds
    less than 0.002 px rms beyond the pixels on both sides of an edge, and does not displace a stripe; what a wider one
    adds has fewer samples.
    """
    reach_px = max(round(np.ceil((blur_px - 1.25) / 2)), 0)
    around, nearest = np.ones((3 + 2 * reach_px,) * 2, np.uint8), np.ones((3, 3), np.uint8)
    edge = render.code_edges(code)
    of_surface = (edge == 2).astype(np.uint8)
    at_stripe = cv2.dilate(stripe, around) > 0
    needed = np.ones(code.shape, np.int16)
    needed[cv2.dilate(stripe if blur_px > WIDE_BLUR_PX else stripe & np.uint8(THIN), nearest) > 0] = SAMPLES
    if of_shadow > 1:
        needed[(cv2.dilate(edge, around) if reach_px else edge) > 0] = of_shadow
        needed[edge == 2] = max(EDGE_SAMPLES, of_shadow)
    if reach_px:
        needed[(cv2.dilate(of_surface, around) > 0) & at_stripe] = max(EDGE_SAMPLES, of_shadow)
    needed[(edge == 2) & at_stripe] = FINE_SAMPLES
    return needed


def blur_px(illuminated: IlluminatedTarget, camera: Camera) -> float:
    """Largest motion of the image of the target from the first to the last placement, at points of a coarse grid."""
    first, last = illuminated.during[0], illuminated.during[-1]
    grid_px = np.stack(
        np.meshgrid(np.linspace(0, camera.image_width - 1, 12), np.linspace(0, camera.image_height - 1, 9)), axis=-1
    ).reshape(-1, 2)
    direction = np.column_stack([undistort(grid_px, camera), np.ones(len(grid_px))])
    hits = render.first_hits(illuminated.target, first.eye_m[:, None], first.vectors_target(direction.T))
    point_m = hits.point_m[:, hits.surface >= 0].T
    moved_px = project(last.points_camera(point_m), camera) - project(first.points_camera(point_m), camera)
    return float(np.nanmax(np.linalg.norm(moved_px, axis=1), initial=0.0))


_KNOTS = 100
"""Knots per axis of the spline of the undistortion, whose error is 1e-6 px for an 8 mm lens."""


@functools.lru_cache(maxsize=2)
def pixel_rays(camera: Camera) -> PixelRays:
    """The rays of a camera, undistorted by a spline, which takes 30 ms for two million pixels."""
    from scipy.interpolate import RectBivariateSpline

    height, width = camera.image_height, camera.image_width
    knots_x, knots_y = (np.linspace(-1.0, float(length), _KNOTS) for length in (width, height))
    knots_px = np.stack(np.meshgrid(knots_x, knots_y), axis=-1)
    splines = [RectBivariateSpline(knots_y, knots_x, part) for part in np.moveaxis(undistort(knots_px, camera), -1, 0)]
    rows, columns = np.arange(height, dtype=np.float64), np.arange(width, dtype=np.float64)
    direction, along_row, along_column = (
        np.stack([spline(rows, columns, dx=of_row, dy=of_column).ravel() for spline in splines])
        for of_row, of_column in ((0, 0), (0, 1), (1, 0))
    )
    return PixelRays(
        direction=direction,
        per_px=np.stack([along_row, along_column]),
        angle_per_px=angle_per_px(camera),
        height=height,
        width=width,
    )


def angle_per_px(camera: Camera) -> float:
    """Width of a pixel at depth 1, in the image centre, by central differences."""
    middle_px = np.array([camera.image_width // 2, camera.image_height // 2], dtype=np.float64)
    steps_px = np.array([[0.5, 0.0], [0.0, 0.5]])
    return float(np.abs(undistort(middle_px + steps_px, camera) - undistort(middle_px - steps_px, camera)).max())


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
