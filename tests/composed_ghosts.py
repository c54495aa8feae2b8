"""Shots with a ghost: a fainter copy of the laser light, moved by some rows."""

from dataclasses import replace

import numpy as np
from drawn_scene import exposed

from ringpose.types.image import Shot


def moved(image: np.ndarray, rows: float) -> np.ndarray:
    """The image moved down by a number of rows, by linear interpolation."""
    whole = int(np.ceil(rows))
    share = np.float32(whole - rows)
    padded = np.pad(image, ((100, 100), (0, 0)))
    first = padded[100 - whole : 100 - whole + len(image)]
    return first + share * (padded[101 - whole : 101 - whole + len(image)] - first)


def with_ghost(shot: Shot, ratio: float, rows: float, light: float = 1.0) -> Shot:
    """The shot with a copy of the laser light in each frame with lasers on, of all light without a background.

    The laser light is first made brighter by the factor `light`; then everything is clipped.
    """
    images = shot.images.astype(np.float32)
    dark = images[0] if shot.lasers[0] == 0 else np.zeros_like(images[0])
    frames = []
    for image, mask in zip(images, shot.lasers.tolist(), strict=True):
        seen = np.float32(light) * (image - dark)
        frames.append(
            shot.images[len(frames)] if mask == 0 else exposed(dark + seen + np.float32(ratio) * moved(seen, rows))
        )
    return replace(shot, images=np.stack(frames))
