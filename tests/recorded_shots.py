"""Shots of given frames, and of a few pixels as written by `ringpose capture`."""

from pathlib import Path

import numpy as np

from ringpose.files.images.shots import write_shot
from ringpose.types.image import Shot


def make_shot(images, masks, name="a", start_s=0.0, period_s=1.0, exposure_s=0.01, **more) -> Shot:
    """A shot of these frames; one exposure, or one for each frame."""
    return Shot(
        name=name,
        images=images,
        lasers=np.array(masks, dtype=np.uint8),
        stamp_s=start_s + period_s * np.arange(len(masks)),
        exposure_s=np.full(len(masks), exposure_s, dtype=np.float64),
        **more,
    )


def counted(masks, **more) -> Shot:
    """A shot whose frame k has the grey value k everywhere."""
    values = np.arange(len(masks), dtype=np.uint8)
    return make_shot(np.broadcast_to(values[:, None, None], (len(masks), 4, 6)), masks, **more)


def recorded(folder: Path, name: str, masks: tuple[int, ...] = (0, 1, 2, 4, 7)) -> Path:
    """The file of a shot whose frame k has the grey value k everywhere."""
    folder.mkdir(exist_ok=True)
    write_shot(folder / f"{name}.npz", counted(masks, name=name, start_s=100.0))
    return folder / f"{name}.npz"
