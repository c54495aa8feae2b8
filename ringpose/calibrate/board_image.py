"""The one image of a shot in which a board's corners are looked for."""

import numpy as np

from ringpose.types.arrays import Array, UInt
from ringpose.types.frame import Shot


def board_image(shot: Shot) -> UInt[Array, "row column"]:
    """The frame with the lasers off; without one, the least of all frames, in which switched stripes vanish."""
    dark = dark_image(shot)
    return np.min(shot.images, axis=0) if dark is None else dark


def dark_image(shot: Shot) -> UInt[Array, "row column"] | None:
    """The first frame with the lasers off, if there is one."""
    off = np.flatnonzero(shot.lasers == 0)
    image: UInt[Array, "row column"] | None = shot.images[off[0]] if len(off) else None
    return image
