"""A ring's face between two surfaces, drawn from formulas, and the distance of detected edges from the true ones."""

import functools
from dataclasses import dataclass, replace

import cv2
import numpy as np
from drawn_scene import RADII_M, DrawnScene, exposed, line_of, noise, true_break_points
from ring_scenes import break_points_of, with_lines

from ringpose.detect.edge_search import EdgeImage
from ringpose.types.detection import BreakPoints, RingEdgePoints
from ringpose.types.rig import Rig

END_SIGMA_PX = 0.3
LINE_SIGMA_PX = 0.03


@dataclass(frozen=True)
class Surroundings:
    """Grey values of the surfaces on both sides of the ring's face."""

    face_dn: float = 60.0
    inside_dn: float = 30.0
    outside_dn: float = 100.0
    clutter_dn: float = 0.0
    noise_dn: float = 1.0
    blur_px: float = 0.8


def narrow(rig: Rig) -> Rig:
    """The same with the lasers a degree and a half apart, as in the paper's virtual rig."""
    tilt = np.deg2rad([1.5, 0.0, -1.5])
    normal = np.stack([np.zeros(3), np.cos(tilt), np.sin(tilt)], axis=-1)
    return replace(rig, lasers=replace(rig.lasers, normal=normal, distance_m=np.full(3, -0.1)))


def radius_m(scene: DrawnScene, rig: Rig, x_px: np.ndarray, y_px: np.ndarray) -> np.ndarray:
    """Distance from the ring's centre at which the ray of a pixel meets its plane."""
    matrix = rig.camera.camera_matrix
    x, y = (x_px - matrix[0, 2]) / matrix[0, 0], (y_px - matrix[1, 2]) / matrix[1, 1]
    normal = np.array(scene.normal) / np.linalg.norm(scene.normal)
    depth = float(normal @ np.array(scene.center_m)) / (normal[0] * x + normal[1] * y + normal[2])
    offsets = [depth * x - scene.center_m[0], depth * y - scene.center_m[1], depth - scene.center_m[2]]
    return np.sqrt(sum(each**2 for each in offsets))


def all_radii_m(scene: DrawnScene, rig: Rig) -> np.ndarray:
    return radius_m(scene, rig, np.arange(1600.0), np.arange(1200.0)[:, None])


def picture(scene: DrawnScene, rig: Rig, around: Surroundings, rng: np.random.Generator) -> np.ndarray:
    """The face between two surfaces of even or uneven brightness, its edges covering pixels in part."""
    inside, outside = _beside_face(scene, rig)
    image = np.full_like(inside, around.face_dn)
    image += inside * np.float32(around.inside_dn - around.face_dn)
    image += outside * np.float32(around.outside_dn - around.face_dn)
    if around.clutter_dn:
        uneven = cv2.GaussianBlur(noise(image.shape, rng), (0, 0), 3.0)
        image += (inside + outside) * uneven * (around.clutter_dn / uneven.std())
    image = cv2.GaussianBlur(image, (0, 0), around.blur_px)
    image += np.float32(around.noise_dn) * noise(image.shape, rng)
    return exposed(image)


@functools.lru_cache(maxsize=4)
def _beside_face(scene: DrawnScene, rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """The shares of each pixel that lie inside of the face and outside of it."""
    radius = all_radii_m(scene, rig)
    width = np.hypot(*np.gradient(radius))
    shares = (RADII_M[0] - radius) / width + 0.5, (radius - RADII_M[1]) / width + 0.5
    inside, outside = (np.clip(share, 0, 1).astype(np.float32) for share in shares)
    return inside, outside


def lit(image: np.ndarray) -> EdgeImage:
    return EdgeImage(image=image, saturation_dn=255)


def measured(scene: DrawnScene, rig: Rig, rng: np.random.Generator) -> BreakPoints:
    """Break points with errors of one sigma, between exact lines."""
    truth = true_break_points(scene, rig)
    count = len(truth)
    normal = np.array(scene.normal) / np.linalg.norm(scene.normal)
    distance = float(normal @ np.array(scene.center_m))
    slopes = []
    for laser in range(count):
        point, direction = line_of(rig, laser, normal, distance)
        ends = np.stack([point, point + 1e-3 * direction]) @ rig.camera.camera_matrix.T
        run = np.diff(ends[:, :2] / ends[:, 2:], axis=0)[0]
        slopes.append(run[1] / run[0])
    shift = rng.normal(0, END_SIGMA_PX, (count, 2))
    position = truth + np.stack([shift, shift * np.array(slopes)[:, None]], axis=-1)
    covariance = np.broadcast_to(np.diag([END_SIGMA_PX**2, 0.1 * END_SIGMA_PX**2]), (count, 2, 2, 2)).copy()
    return replace(with_lines(break_points_of(position), truth[:, ::-1], LINE_SIGMA_PX), covariance_px2=covariance)


def off_edge_px(points: RingEdgePoints, scene: DrawnScene, rig: Rig) -> np.ndarray:
    """Signed distance of the points from the true edge along their normals: radius error over its derivative."""
    here, before, behind = (
        radius_m(scene, rig, *(points.position_px + step * points.normal).T) for step in (0.0, -0.5, 0.5)
    )
    return (here - np.array(RADII_M)[points.edge]) / (behind - before)
