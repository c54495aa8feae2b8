"""Camera and lasers -> shots, in lock step: light, trigger, next."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from ringpose.capture.cameras.driver import CameraDriver
from ringpose.capture.lasers.driver import LaserDriver
from ringpose.types.frame import Frame, Shot
from ringpose.types.sequence import Step


def captured_shots(
    camera: CameraDriver,
    lasers: LaserDriver,
    steps: Sequence[Step],
    names: Iterable[str],
    exposure_s: float | None = None,
) -> Iterator[Shot]:
    """One shot a name, of one frame a step; every laser is off whenever a shot is handed on."""
    masks = [step.mask(lasers.count) for step in steps]
    for name in names:
        camera.arm(exposure_s)
        frames, read_masks = [], []
        for mask in masks:
            lasers.set_mask(mask)
            frames.append(camera.trigger(mask))
            read_masks.append(lasers.read_mask())
        lasers.set_mask(0)
        yield _shot(name, frames, read_masks, camera.describe().saturation_dn)


def _shot(name: str, frames: Sequence[Frame], read_masks: Sequence[int | None], saturation_dn: int) -> Shot:
    reported = [mask for mask in read_masks if mask is not None]
    return Shot(
        name=name,
        images=np.stack([frame.image for frame in frames]),
        lasers=np.array([frame.lasers for frame in frames], dtype=np.uint8),
        stamp_s=np.array([frame.stamp_s for frame in frames], dtype=np.float64),
        exposure_s=np.array([frame.exposure_s for frame in frames], dtype=np.float64),
        read_lasers=np.array(reported, dtype=np.uint8) if len(reported) == len(frames) else None,
        meta={"saturation_dn": saturation_dn},
    )
