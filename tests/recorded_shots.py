"""Shots of a few pixels, as written by `ringpose capture`."""

from pathlib import Path

import numpy as np

from ringpose.files.images.shots import write_shot
from ringpose.types.image import Shot


def recorded(folder: Path, name: str, masks: tuple[int, ...] = (0, 1, 2, 4, 7)) -> Path:
    """A shot whose frame k has the grey value k everywhere."""
    folder.mkdir(exist_ok=True)
    frames = np.arange(len(masks))
    shot = Shot(
        name=name,
        images=np.broadcast_to(frames.astype(np.uint8)[:, None, None], (len(masks), 4, 6)),
        lasers=np.array(masks, dtype=np.uint8),
        stamp_s=100.0 + frames,
        exposure_s=np.full(len(masks), 0.01),
    )
    write_shot(folder / f"{name}.npz", shot)
    return folder / f"{name}.npz"
