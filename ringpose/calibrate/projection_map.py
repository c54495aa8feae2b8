"""Two cameras compared over the image, and how far one may be from the truth there (ringpose-method(7), section 7).

Turning the camera frame moves all pixels alike, as a shift of the principal point does, and harms nothing that is
calibrated with the same camera. So the turn that makes the displacements in the middle of the image least is taken
away first: in the corners, where no board may have been, distortion that nobody knows would turn the frame instead.
"""

import cv2
import numpy as np

from ringpose.geometry.rays import project, rays
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.calibration import ImageMap
from ringpose.types.camera import Camera
from ringpose.types.options import DistortionModel

MAP_COLUMNS = 17
"""Points along a row of the map; enough for what distortion does between them."""

MIDDLE_SHARE = 0.7
"""Of width and height of the image, in which the turn is fitted."""

_TURNS = 3


def image_map(camera: Camera) -> ImageMap:
    """Points from edge to edge of the image, about as far apart down as across."""
    width, height = camera.image_width - 1.0, camera.image_height - 1.0
    rows = max(round((MAP_COLUMNS - 1) * height / max(width, 1.0)) + 1, 2)
    row, column = np.meshgrid(np.linspace(0, height, rows), np.linspace(0, width, MAP_COLUMNS), indexing="ij")
    return ImageMap(points_px=np.stack([column, row], axis=-1))


def displacement_px(one: Camera, other: Camera, where: ImageMap) -> Float64[Array, "map_row map_column"]:
    """How far from each pixel of the one camera the other sees what is seen there; NaN if it does not see it."""
    seen = rays(where.points_px, one).reshape(-1, 3)
    offset_px = _offset(seen, other, where)
    for _ in range(_TURNS):
        if not np.isfinite(offset_px).all():
            break
        _, by_turn = _derivatives(seen, other)
        step = _least_turn(by_turn, -offset_px[..., None], where)[:, 0]
        seen = seen @ np.asarray(cv2.Rodrigues(step)[0], dtype=np.float64).T
        offset_px = _offset(seen, other, where)
    length: Float64[Array, "map_row map_column"] = np.linalg.norm(offset_px, axis=-1).reshape(where.points_px.shape[:2])
    return length


def _offset(directions: Float64[Array, "n xyz=3"], camera: Camera, where: ImageMap) -> Float64[Array, "n xy=2"]:
    return project(directions, camera) - where.points_px.reshape(-1, 2)


def projection_sigma_px(camera: Camera, where: ImageMap) -> Float64[Array, "map_row map_column"]:
    """Rms length of the displacement from the true camera, from the covariance of the intrinsic parameters."""
    if camera.covariance is None:
        return np.full(where.points_px.shape[:2], np.nan)
    by_parameter, by_turn = _derivatives(rays(where.points_px, camera).reshape(-1, 3), camera)
    remaining = by_parameter - by_turn @ _least_turn(by_turn, by_parameter, where)
    variance = np.einsum("pci,ij,pcj->p", remaining, camera.covariance.data, remaining)
    sigma: Float64[Array, "map_row map_column"] = np.sqrt(np.maximum(variance, 0.0)).reshape(where.points_px.shape[:2])
    return sigma


def known_lens(
    camera: Camera, corners_px: Float64[Array, "corner xy=2"], where: ImageMap
) -> Bool[Array, "map_row map_column"]:
    """Where the covariance tells how far the projection is off.

    A quotient of polynomials that is known along a radius may be anything beyond it: there the rational model is known
    only as far from the principal point as the corners reach. Polynomials alone hold beyond.
    """
    if camera.distortion_model != DistortionModel.RATIONAL_POLYNOMIAL:
        return np.ones(where.points_px.shape[:2], dtype=bool)
    middle, focal = camera.camera_matrix[:2, 2], np.diag(camera.camera_matrix)[:2]
    radius, reached = (np.linalg.norm((points - middle) / focal, axis=-1) for points in (where.points_px, corners_px))
    known: Bool[Array, "map_row map_column"] = radius <= max(float(reached.max()), float(radius.min()))
    return known


def _least_turn(
    by_turn: Float64[Array, "n xy=2 turn=3"], offset_px: Float64[Array, "n xy=2 column"], where: ImageMap
) -> Float64[Array, "turn=3 column"]:
    """The turn that moves the middle of the image most nearly by the offsets, for each column of them."""
    rows, columns = where.points_px.shape[:2]
    row, column = (np.abs(np.linspace(-1, 1, count)) <= MIDDLE_SHARE for count in (rows, columns))
    used = np.outer(row, column).ravel()
    turn: Float64[Array, "turn=3 column"] = np.linalg.lstsq(
        by_turn[used].reshape(-1, 3), offset_px[used].reshape(-1, offset_px.shape[-1])
    )[0]
    return turn


def _derivatives(
    directions: Float64[Array, "n xyz=3"], camera: Camera
) -> tuple[Float64[Array, "n xy=2 parameter"], Float64[Array, "n xy=2 turn=3"]]:
    """Of the pixels, by the intrinsic parameters and by a small turn of the camera frame."""
    origin = np.zeros(3)
    jacobian = cv2.projectPoints(directions, origin, origin, camera.camera_matrix, camera.distortion_coefficients)[1]
    both = np.asarray(jacobian, dtype=np.float64).reshape(len(directions), 2, -1)
    return both[..., 6 : 10 + len(camera.distortion_coefficients)], both[..., :3]
