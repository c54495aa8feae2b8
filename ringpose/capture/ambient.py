"""Ambient light that changes between the frames of one shot.

The image is divided into blocks much wider than a laser line, and the median of the difference between two frames is
taken in each. Laser lines, displaced edges and noise do not change this median. A lamp that goes on or off changes it
in many blocks, with the same sign in all of them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from ringpose.types.arrays import Array, Bool, Float32, UInt
from ringpose.types.image import Shot

BLOCKS = 8
"""Blocks along each side of an image."""

MIN_BLOCK_PX = 12
"""Minimum side of a block: in a smaller one, a line may cover half of the pixels."""

SAMPLES = 24
"""Target for the number of pixels sampled along each side of a block."""

MIN_SHARE_OF_IMAGE = 0.1
"""Minimum share of the blocks that a change of ambient light affects."""

MIN_SHARE_OF_FULL = 0.02
"""Minimum size of a change as a share of the full grey value (the same as for a pixel lit by a laser)."""

LOST_SHARE_OF_FULL = 0.05
"""Size of a change, as a share of the full grey value, above which a shot is lost.

A shot whose lasers are not seen as commanded is lost if there is any change.
"""

MIN_SIGMAS = 6.0
"""Minimum size of a change in standard deviations of the median of a block."""

MAX_OPPOSITE = 0.5
"""Maximum ratio of a change of opposite sign in other blocks to the change: motion causes both signs, a lamp one."""

MEDIAN_SIGMA = 1.2533 * 1.4826
"""sqrt(pi / 2) * 1.4826: sd of the median of n normal samples, times sqrt(n), divided by their MAD."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AmbientChange:
    """The largest change of ambient light in a shot, against its first frame without lasers."""

    size_dn: float
    """Change of the grey value in at least a tenth of the image; negative if it became darker."""
    share_of_full: float
    """The change `size_dn` as a share of the full grey value."""
    only_with_lasers: bool = False
    """Whether only frames with lasers show it, so that it may also be stray light of the lasers."""


def ambient_change(shot: Shot) -> AmbientChange | None:
    """The largest significant change of ambient light within a shot; None if there is none.

    It can be found only in a shot with a frame without lasers, and in images of at least 96 x 96 pixels.
    """
    dark_frames = np.flatnonzero(shot.lasers == 0)
    if not len(dark_frames) or not _is_large_enough(shot.images):
        return None
    blocks, full_dn = _sampled_blocks(shot.images), shot.usual_full_dn
    sizes_dn = np.array([_broad_change_dn(frame - blocks[dark_frames[0]], full_dn) for frame in blocks])
    in_dark = np.abs(sizes_dn[dark_frames])
    largest = int(dark_frames[np.argmax(in_dark)]) if in_dark.any() else int(np.argmax(np.abs(sizes_dn)))
    if sizes_dn[largest] == 0.0:
        return None
    return AmbientChange(
        size_dn=float(sizes_dn[largest]),
        share_of_full=float(abs(sizes_dn[largest])) / full_dn,
        only_with_lasers=not in_dark.any(),
    )


def same_ambient_light(images: UInt[Array, "frame row column"], full_dn: int) -> Bool[Array, "frame frame"]:
    """Which pairs of images were taken in the same ambient light; all if the images are too small to compare."""
    same = np.ones((len(images), len(images)), dtype=np.bool_)
    if _is_large_enough(images):
        blocks = _sampled_blocks(images)
        for one, other in combinations(range(len(images)), 2):
            same[one, other] = same[other, one] = _broad_change_dn(blocks[one] - blocks[other], full_dn) == 0.0
    return same


def lost_shot(shot: Shot, change: AmbientChange) -> Shot:
    """The shot, whose `meta` states that it is lost to this change."""
    return replace(shot, meta={**shot.meta, "ambient_change_dn": change.size_dn, "lost": True})


def lost_attempts_dn(meta: Mapping[str, Any]) -> list[float]:
    """The changes in grey value of the attempts at a shot that were lost to changing ambient light."""
    return list(meta.get("attempts_lost", {}).get("ambient_changed", ()))


def _is_large_enough(images: UInt[Array, "frame row column"]) -> bool:
    return bool(min(images.shape[1:]) >= BLOCKS * MIN_BLOCK_PX)


def _sampled_blocks(images: UInt[Array, "frame row column"]) -> Float32[Array, "frame block pixel"]:
    """A regular sample of the pixels of each block."""
    height, width = (side // BLOCKS for side in images.shape[1:])
    step_y, step_x = max(1, height // SAMPLES), max(1, width // SAMPLES)
    cropped = images[:, : BLOCKS * height, : BLOCKS * width]
    parts = cropped.reshape(-1, BLOCKS, height, BLOCKS, width)[:, :, ::step_y, :, ::step_x]
    blocks: Float32[Array, "frame block pixel"] = parts.swapaxes(2, 3).reshape(len(cropped), BLOCKS**2, -1)
    return blocks.astype(np.float32)


def _broad_change_dn(difference_dn: Float32[Array, "block pixel"], full_dn: int) -> float:
    """The change that at least a tenth of the blocks has.

    0 within noise, or if similarly many blocks change in the other direction.
    """
    level_dn = np.median(difference_dn, axis=1)
    deviation_dn = np.median(np.abs(difference_dn - level_dn[:, None]), axis=1)
    sigma_dn = MEDIAN_SIGMA * float(np.quantile(deviation_dn, 1 - MIN_SHARE_OF_IMAGE)) / difference_dn.shape[1] ** 0.5
    darker_dn, brighter_dn = np.quantile(level_dn, [MIN_SHARE_OF_IMAGE, 1 - MIN_SHARE_OF_IMAGE]).tolist()
    size_dn, opposite_dn = (brighter_dn, -darker_dn) if brighter_dn >= -darker_dn else (darker_dn, brighter_dn)
    limit_dn = max(MIN_SHARE_OF_FULL * full_dn, MIN_SIGMAS * sigma_dn)
    return float(size_dn) if abs(size_dn) > limit_dn and opposite_dn < MAX_OPPOSITE * abs(size_dn) else 0.0
