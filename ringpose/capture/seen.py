"""Which lasers the images of a shot show, as opposed to what was commanded and to what the board reports.

Every laser's own frame, less the darkest frame without lasers, shows where its light falls. A laser is seen in
another frame if most of those places are bright there too; motion of the target or ambient light do not do that.
"""

from dataclasses import dataclass

import numpy as np

from ringpose.types.arrays import Array, Float32, Int64, UInt8
from ringpose.types.frame import Shot

LEAST_SHARE_OF_FULL = 0.02
"""A place is lit if it is brighter by this share of the full grey value,"""

LEAST_SIGMAS = 8.0
"""and by so many sigmas of the noise."""

LEAST_PIXELS = 25
"""Fewer lit places are glints or noise."""

AS_BRIGHT = 0.5
"""A place is lit by the same laser again if it has this share of its contrast,"""

MOST_PLACES = 0.7
"""and the laser is seen if this share of its places is."""

SAMPLED = 7
"""Every so many-th pixel tells the noise."""

Image = Float32[Array, "row column"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LitPlaces:
    """Where a laser's light falls, and how bright: flat pixel numbers and grey values above the dark frame."""

    pixel: Int64[Array, "n"]
    contrast_dn: Float32[Array, "n"]
    dark_dn: Float32[Array, "n"]

    def are_lit_in(self, image: Image) -> bool:
        """Whether the same laser lights another image."""
        bright = image.ravel()[self.pixel] - self.dark_dn > AS_BRIGHT * self.contrast_dn
        return bool(bright.mean() > MOST_PLACES)


def seen_lasers(shot: Shot) -> tuple[UInt8[Array, "frame"] | None, dict[int, LitPlaces]]:
    """The mask seen in each frame, and the places of each laser that has a frame of its own and was seen there.

    None without a frame that was to be dark. Lasers without a frame of their own count as seen if anything is.
    """
    dark_frames = np.flatnonzero(shot.lasers == 0)
    if not len(dark_frames):
        return None, {}
    images = [image.astype(np.float32) for image in shot.images]
    dark = np.minimum.reduce([images[frame] for frame in dark_frames])
    bright = np.maximum.reduce([images[frame] for frame in dark_frames])
    lit = [lit_places(image, dark, bright, shot.saturation_dn) for image in images]
    alone = {int(mask).bit_length() - 1: frame for frame, mask in enumerate(shot.lasers) if int(mask).bit_count() == 1}
    places = {laser: found for laser, frame in alone.items() if (found := lit[frame]) is not None}
    own = sum(1 << laser for laser in alone)
    seen = [
        sum(1 << laser for laser, found in places.items() if found.are_lit_in(image))
        | (int(mask) & ~own if lit[frame] is not None else 0)
        for frame, (image, mask) in enumerate(zip(images, shot.lasers, strict=True))
    ]
    return np.array(seen, dtype=np.uint8), places


def lit_places(image: Image, dark: Image, bright: Image, saturation_dn: int) -> LitPlaces | None:
    """Places brighter than every frame without lasers; None if there are too few."""
    above = image - bright
    sample = np.abs(above.ravel()[::SAMPLED])
    sigma_dn = 1.4826 * float(np.median(sample))
    pixel = np.flatnonzero(above.ravel() > max(LEAST_SHARE_OF_FULL * saturation_dn, LEAST_SIGMAS * sigma_dn))
    if len(pixel) < LEAST_PIXELS:
        return None
    dark_dn = dark.ravel()[pixel]
    return LitPlaces(pixel=pixel, contrast_dn=image.ravel()[pixel] - dark_dn, dark_dn=dark_dn)
