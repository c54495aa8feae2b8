"""Shots with a ghost: a fainter copy of the laser light, moved by some rows."""

from dataclasses import replace

import numpy as np

from ringpose.types.image import Shot


def moved(image: np.ndarray, rows: float) -> np.ndarray:
    """The image moved down by a number of rows, by linear interpolation."""
    at = np.arange(len(image)) - rows
    first = np.floor(at).astype(int)
    share = (at - first)[:, None]
    padded = np.pad(image, ((100, 100), (0, 0)))
    return (1 - share) * padded[first + 100] + share * padded[first + 101]


def with_ghost(shot: Shot, ratio: float, rows: float, light: float = 1.0) -> Shot:
    """The shot with a copy of the laser light in each frame with lasers on, of all light without a background.

    The laser light is first made brighter by the factor `light`; then everything is clipped.
    """
    dark = shot.images[0].astype(np.float64) if shot.lasers[0] == 0 else np.zeros(shot.images.shape[1:])
    frames = []
    for image, mask in zip(shot.images, shot.lasers.tolist(), strict=True):
        seen = light * (image - dark)
        lit = np.clip(np.rint(dark + seen + ratio * moved(seen, rows)), 0, 255).astype(np.uint8)
        frames.append(image if mask == 0 else lit)
    return replace(shot, images=np.stack(frames))
