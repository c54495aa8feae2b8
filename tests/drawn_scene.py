"""Stripes drawn from formulas: a flat ring before a flat body, lit by three light planes, seen through a lens."""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from ringpose.types.image import Shot
from ringpose.types.rig import Camera, LaserPlanes, Rig

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
    normals = np.array([[0.0, math.cos(tilt), -math.sin(tilt)], [0.0, 1.0, 0.0], [0.0, math.cos(tilt), math.sin(tilt)]])
    camera = Camera(
        camera_name="drawn",
        image_width=1600,
        image_height=1200,
        camera_matrix=np.array([[1781.0, 0.0, 803.0], [0.0, 1780.0, 596.0], [0.0, 0.0, 1.0]]),
        distortion_model="plumb_bob",
        distortion_coefficients=np.array([-0.1, 0.11, 0.0005, -0.0004, 0.0]),
    )
    lasers = LaserPlanes(
        names=("left", "middle", "right"),
        normal=normals,
        distance_m=np.array([-0.0394, -0.07, -0.0394]),
        projector_m=np.full((3, 3), np.nan),
    )
    return Rig(camera=camera, lasers=lasers)


def line_of(rig: Rig, laser: int, normal: np.ndarray, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """A point and the direction (towards +x) of the line in which a light plane meets a plane."""
    direction = np.cross(rig.lasers.normal[laser], normal)
    direction /= np.linalg.norm(direction) * np.sign(direction[0])
    system = np.stack([rig.lasers.normal[laser], normal, direction])
    return np.linalg.solve(system, np.array([rig.lasers.distance_m[laser], distance, 0.0])), direction


def crossings(scene: DrawnScene, rig: Rig, laser: int) -> np.ndarray:
    """Intersections of the light plane with the inner and outer edge, left of the centre, in the camera frame."""
    normal = np.array(scene.normal) / np.linalg.norm(scene.normal)
    center = np.array(scene.center_m)
    point, direction = line_of(rig, laser, normal, float(normal @ center))
    offset = point - center
    b = direction @ offset
    steps = [-b - math.sqrt(b * b - offset @ offset + radius**2) for radius in RADII_M]
    return np.array([point + step * direction for step in steps])


def pixels(points: np.ndarray, rig: Rig) -> np.ndarray:
    """Pixels of points in the camera frame, by cv2.projectPoints."""
    origin = np.zeros(3)
    flat, _ = cv2.projectPoints(points, origin, origin, rig.camera.camera_matrix, rig.camera.distortion_coefficients)
    return flat.reshape(-1, 2)


def true_break_points(scene: DrawnScene, rig: Rig) -> np.ndarray:
    """True break points (laser, edge, xy) in distorted pixels."""
    return np.array([pixels(crossings(scene, rig, laser), rig) for laser in range(len(rig.lasers.names))])


def _normal_cdf(values: np.ndarray) -> np.ndarray:
    return np.array([0.5 * (1 + math.erf(value / math.sqrt(2))) for value in values])


def _draw(image: np.ndarray, curve: np.ndarray, peak: np.ndarray, sigma: float) -> None:
    """Add a stripe whose centre runs along a curve (n, 2) and whose peak is given in each column."""
    x = np.arange(image.shape[1])
    y = np.interp(x, curve[:, 0], curve[:, 1], left=np.nan, right=np.nan)
    for column in np.flatnonzero(np.isfinite(y) & (peak > 0.01)):
        first, last = max(int(y[column]) - 12, 0), min(int(y[column]) + 14, image.shape[0])
        rows = np.arange(first, last)
        if len(rows):
            image[first:last, column] += peak[column] * np.exp(-0.5 * ((rows - y[column]) / sigma) ** 2)


def light(scene: DrawnScene, rig: Rig, laser: int) -> np.ndarray:
    """Grey values (row, column) that one laser adds: its stripe on the ring's face and on the body behind it."""
    image = np.zeros((rig.camera.image_height, rig.camera.image_width))
    normal = np.array(scene.normal) / np.linalg.norm(scene.normal)
    distance = float(normal @ np.array(scene.center_m))
    inner, outer = true_break_points(scene, rig)[laser, :, 0]
    x = np.arange(image.shape[1], dtype=float)
    for behind in (0.0, BODY_BEHIND_M):
        point, direction = line_of(rig, laser, normal, distance - behind)
        curve = pixels(point + np.linspace(-0.5, 0.5, 400)[:, None] * direction, rig)
        face = _normal_cdf((x - outer) / scene.edge_sigma_px) * _normal_cdf((inner - x) / scene.edge_sigma_px)
        share = face if behind == 0.0 else np.where((x < outer - 12) | (x > inner + 12), 0.6, 0.0)
        _draw(image, curve, scene.peaks_dn[laser] * share, scene.stripe_sigma_px)
    return image


def draw_shot(scene: DrawnScene, rig: Rig, masks: list[int], rng: np.random.Generator) -> Shot:
    """A shot with a frame for each mask."""
    lights = [light(scene, rig, laser) for laser in range(len(rig.lasers.names))]
    if scene.speckle:
        lights = [each * speckle(each.shape, scene.speckle, rng) for each in lights]
    frames = []
    for mask in masks:
        clean = scene.ambient_dn + sum(each for laser, each in enumerate(lights) if mask >> laser & 1)
        noisy = clean + rng.normal(0, scene.noise_dn, (rig.camera.image_height, rig.camera.image_width))
        frames.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    return Shot(
        name="drawn",
        images=np.array(frames),
        lasers=np.array(masks, dtype=np.uint8),
        stamp_s=np.arange(len(masks), dtype=np.float64),
        exposure_s=np.full(len(masks), 0.001),
    )


def speckle(shape: tuple[int, int], contrast: float, rng: np.random.Generator) -> np.ndarray:
    """Multiplicative noise of mean one with grains of about three pixels."""
    grains = cv2.GaussianBlur(rng.normal(0, 1, shape), (0, 0), 1.0)
    return np.maximum(1 + contrast * grains / grains.std(), 0)
