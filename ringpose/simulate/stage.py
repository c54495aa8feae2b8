"""One view of a scene, cast once and ready to be lit and exposed as often as wanted."""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from ringpose.simulate.lighting import Stand
from ringpose.simulate.pixel_rays import pixel_rays
from ringpose.simulate.render import layers
from ringpose.simulate.sensor import digitised, electrons_per_radiance
from ringpose.simulate.speckle import speckle_pattern
from ringpose.types.arrays import Array, Float32
from ringpose.types.frame import Frame
from ringpose.types.scene import Beacon, Light, Scene, Sensor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stage:
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


def staged(scene: Scene, stand: Stand, seed: tuple[int, ...]) -> Stage:
    """A target in its place, seen through the scene's lens; the seed fixes speckle and noise."""
    generator = np.random.default_rng(seed)
    radiance = layers(stand, pixel_rays(scene.rig.camera))
    scale = np.float32(electrons_per_radiance(scene.sensor, scene.lens))
    beacon = stand.light.beacon
    return Stage(
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
