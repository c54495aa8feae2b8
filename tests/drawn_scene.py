"""Stripes drawn from formulas: a flat ring before a flat body, lit by three light planes, seen through a lens."""

import functools
import math
from dataclasses import dataclass

import cv2
import numpy as np
from recorded_shots import make_shot
from ring_scenes import Ring, make_rig, pixels_of
from scipy.special import ndtr

from ringpose.types.image import Shot
from ringpose.types.rig import Rig

RADII_M = (0.567, 0.597)
BODY_BEHIND_M = 0.06


@dataclass(frozen=True)
class DrawnScene:
    """A ring and the parameters of its drawing."""

    center_m: tuple[float, float, float] = (0.58, 0.02, 0.5)
    normal: tuple[float, float, float] = (0.05, -0.08, -0.9955)
    peaks_dn: tuple[float, float, float] = (150.0, 170.0, 140.0)
    stripe_sigma_px: float = 1.6
    edge_sigma_px: float = 1.0
    noise_dn: float = 1.5
    speckle: float = 0.0
    ambient_dn: float = 10.0


def drawn_rig() -> Rig:
    """Three lasers at +-10 degrees about a camera with an 8 mm lens, as in the paper's physical set-up."""
    tilt = math.radians(10)
    normals = [[0.0, math.cos(tilt), -math.sin(tilt)], [0.0, 1.0, 0.0], [0.0, math.cos(tilt), math.sin(tilt)]]
    lens = [-0.1, 0.11, 0.0005, -0.0004, 0.0]
    return make_rig((1781.0, 1780.0), (803.0, 596.0), lens, normals, [-0.0394, -0.07, -0.0394])


def line_of(rig: Rig, laser: int, normal: np.ndarray, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """A point and the direction (towards +x) of the line in which a light plane meets a plane."""
    direction = np.cross(rig.lasers.normal[laser], normal)
    direction /= np.linalg.norm(direction) * np.sign(direction[0])
    system = np.stack([rig.lasers.normal[laser], normal, direction])
    return np.linalg.solve(system, np.array([rig.lasers.distance_m[laser], distance, 0.0])), direction


def true_break_points(scene: DrawnScene, rig: Rig) -> np.ndarray:
    """True break points (laser, edge, xy) in distorted pixels."""
    normal = np.array(scene.normal) / np.linalg.norm(scene.normal)
    ring = Ring(center_m=np.array(scene.center_m), normal=normal, radius_m=np.array(RADII_M))
    return pixels_of(ring.break_points_m(rig.lasers), rig.camera)


def _draw(image: np.ndarray, curve: np.ndarray, peak: np.ndarray, sigma: float) -> None:
    """Add a stripe whose centre runs along a curve (n, 2) and whose peak is given in each column."""
    y = np.interp(np.arange(image.shape[1]), curve[:, 0], curve[:, 1], left=np.nan, right=np.nan)
    column = np.flatnonzero(np.isfinite(y) & (peak > 0.01))
    row = y[column].astype(int) + np.arange(-12, 14)[:, None]
    stripe = peak[column] * np.exp(-0.5 * ((row - y[column]) / sigma) ** 2)
    inside = (row >= 0) & (row < image.shape[0])
    image[row[inside], np.broadcast_to(column, row.shape)[inside]] += stripe[inside]


def light(scene: DrawnScene, rig: Rig, laser: int) -> np.ndarray:
    """Grey values (row, column) that one laser adds: its stripe on the ring's face and on the body behind it."""
    image = np.zeros((rig.camera.image_height, rig.camera.image_width))
    normal = np.array(scene.normal) / np.linalg.norm(scene.normal)
    distance = float(normal @ np.array(scene.center_m))
    inner, outer = true_break_points(scene, rig)[laser, :, 0]
    x = np.arange(image.shape[1], dtype=float)
    for behind in (0.0, BODY_BEHIND_M):
        point, direction = line_of(rig, laser, normal, distance - behind)
        curve = pixels_of(point + np.linspace(-0.5, 0.5, 400)[:, None] * direction, rig.camera)
        face = ndtr((x - outer) / scene.edge_sigma_px) * ndtr((inner - x) / scene.edge_sigma_px)
        share = face if behind == 0.0 else np.where((x < outer - 12) | (x > inner + 12), 0.6, 0.0)
        _draw(image, curve, scene.peaks_dn[laser] * share, scene.stripe_sigma_px)
    return image


def draw_shot(scene: DrawnScene, rig: Rig, masks: list[int], rng: np.random.Generator) -> Shot:
    """A shot with a frame for each mask."""
    lights = [light(scene, rig, laser).astype(np.float32) for laser in range(len(rig.lasers.names))]
    if scene.speckle:
        lights = [each * speckle(each.shape, scene.speckle, rng) for each in lights]
    frames = []
    for mask in masks:
        image = np.float32(scene.noise_dn) * noise(lights[0].shape, rng)
        image += np.float32(scene.ambient_dn)
        for laser, each in enumerate(lights):
            if mask >> laser & 1:
                image += each
        frames.append(exposed(image))
    return make_shot(np.array(frames), masks, name="drawn", exposure_s=0.001)


def exposed(image: np.ndarray) -> np.ndarray:
    """The whole grey values of an image."""
    return cv2.convertScaleAbs(np.maximum(image, 0))  # rounds, and clips at 255


def noise(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Standard normal values: an excerpt, at a random place, of a series drawn once.

    To draw them for each picture would take longer than all the rest of it.
    """
    count = shape[0] * shape[1]
    start = int(rng.integers(_normal_values().size - count))
    return _normal_values()[start : start + count].reshape(shape)


@functools.cache
def _normal_values() -> np.ndarray:
    return np.random.default_rng(1).standard_normal(1 << 22, dtype=np.float32)


def speckle(shape: tuple[int, int], contrast: float, rng: np.random.Generator) -> np.ndarray:
    """Multiplicative noise of mean one with grains of about three pixels."""
    grains = cv2.GaussianBlur(noise(shape, rng), (0, 0), 1.0)
    return np.maximum(1 + contrast * grains / grains.std(), 0)
