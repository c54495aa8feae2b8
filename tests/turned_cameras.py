"""Rigs and shots of the same camera mounted turned by 90 degrees, and of its mirror image."""

from dataclasses import replace

import numpy as np

from ringpose.types.image import Shot
from ringpose.types.rig import Rig

TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""(x, y, z) becomes (-y, x, z): the camera is turned by 90 degrees, images clockwise."""

SWAP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""x and y exchanged: transposed images, of a mirrored world."""


def turned_rig(rig: Rig) -> Rig:
    """The rig with the turned camera; its stripes run along the columns."""
    return _changed(rig, TURN)


def transposed_rig(rig: Rig) -> Rig:
    """The mirrored rig of transposed images."""
    return _changed(rig, SWAP)


def turned_shot(shot: Shot) -> Shot:
    """What the turned camera takes: the pixel (x, y) moves to (height - 1 - y, x)."""
    return replace(shot, images=np.ascontiguousarray(np.rot90(shot.images, -1, axes=(1, 2))))


def transposed_shot(shot: Shot) -> Shot:
    """The shot with transposed images."""
    return replace(shot, images=np.ascontiguousarray(shot.images.transpose(0, 2, 1)))


def turned_px(position_px, rig: Rig):
    """Where the turned camera sees what `rig` sees at a pixel."""
    x, y = position_px[..., 0], position_px[..., 1]
    return np.stack([rig.camera.image_height - 1 - y, x], axis=-1)


def _changed(rig: Rig, change) -> Rig:
    (fx, _, cx), (_, fy, cy), _ = rig.camera.camera_matrix.tolist()
    k1, k2, p1, p2, *more = rig.camera.distortion_coefficients.tolist()
    if change is TURN:
        cx, cy, p1, p2 = rig.camera.image_height - 1 - cy, cx, p2, -p1
    else:
        cx, cy, p1, p2 = cy, cx, p2, p1
    camera = replace(
        rig.camera,
        image_width=rig.camera.image_height,
        image_height=rig.camera.image_width,
        camera_matrix=np.array([[fy, 0.0, cx], [0.0, fx, cy], [0.0, 0.0, 1.0]]),
        distortion_coefficients=np.array([k1, k2, p1, p2, *more]),
    )
    lasers = replace(rig.lasers, normal=rig.lasers.normal @ change.T, projector_m=rig.lasers.projector_m @ change.T)
    return replace(rig, camera=camera, lasers=lasers, covariance=None)
