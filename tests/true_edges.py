"""Distance of points from the ring's true edges, by OpenCV's projection of densely spaced points on the circles."""

import cv2
import numpy as np

from ringpose.types.detection import RingEdgePoints
from ringpose.types.rig import Rig


def circle_px(truth: dict, radius: float, rig: Rig) -> np.ndarray:
    """Densely spaced points of a true edge, by OpenCV's projection."""
    normal = np.array(truth["normal"])
    across = np.cross(normal, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    angle = np.linspace(0, 2 * np.pi, 40000)[:, None]
    points = np.array(truth["center_m"]) + radius * (np.cos(angle) * across + np.sin(angle) * np.cross(normal, across))
    points = points[points[:, 2] > 0.02]
    matrix, distortion = rig.camera.camera_matrix, rig.camera.distortion_coefficients
    return cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, distortion)[0].reshape(-1, 2)


def edge_errors_px(points: RingEdgePoints, truth: dict, rig: Rig) -> np.ndarray:
    """Distance of edge points from the true edges along their normals."""
    error_px = np.empty(len(points.edge))
    for edge, radius in enumerate((truth["radius_inner_m"], truth["radius_outer_m"])):
        circle = circle_px(truth, radius, rig)
        for which in np.flatnonzero(points.edge == edge):
            offset = points.position_px[which] - circle
            nearest = offset[np.argmin(np.sum(offset**2, axis=-1))]
            error_px[which] = nearest @ points.normal[which]
    return error_px
