"""Which lasers the images of a shot show, as opposed to what was commanded and to what the board reports.

Every laser's own frame, less the frames without lasers, shows where its light falls. A laser is seen in another frame
if most of those places are bright there too; motion of the target or ambient light do not do that.
"""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ringpose.detect.stripes import find_stripes
from ringpose.types.arrays import Array, Bool, Float32, Int64, UInt, UInt8
from ringpose.types.image import Shot

MIN_SHARE_OF_FULL = 0.02
"""A place is lit if it is brighter by this share of the full grey value,"""

MIN_SIGMAS = 8.0
"""and by so many sigmas of the noise."""

MIN_PIXELS = 25
"""Fewer lit places are glints or noise."""

MAX_SHARE_OF_IMAGE = 0.2
"""More of them are no stripe: the ambient light has changed."""

AS_BRIGHT = 0.5
"""A place is lit by the same laser again if it has this share of its contrast,"""

MAX_PLACES = 0.7
"""and the laser is seen if this share of its places is."""

MAX_LINE_WIDTH = 25
"""Part of an image's width that no line of light is as wide as."""

MIN_STRIPE = 0.1
"""Share of the columns of an image in which a laser's stripe shows at least, if it shines on anything at all."""

STRIPE_IN_THE_DARK = "cut the power; a line that stays then is no laser's"
"""What to do about a stripe that shows while all lasers are off."""

SAMPLED = 7
"""Every so many-th row and column tell the noise."""

Image = UInt[Array, "row column"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LitPlaces:
    """Where a laser's light falls, and how bright: flat pixel numbers and grey values above the dark frame."""

    pixel: Int64[Array, "n"]
    contrast_dn: Float32[Array, "n"]
    dark_dn: Float32[Array, "n"]

    def are_lit_in(self, image: Image) -> bool:
        """Whether the same laser lights another image."""
        grey = image.ravel()[self.pixel].astype(np.float32)
        bright = grey - self.dark_dn > AS_BRIGHT * self.contrast_dn
        return bool(bright.mean() > MAX_PLACES)

    def stand_out_in(self, image: Image) -> bool:
        """Whether the same laser lights another image that may be lit otherwise, too: the places, but not what is near.

        Brighter ambient light lifts what is near as well; a laser's line is narrow.
        """
        return bool((self._line_dn(image) > AS_BRIGHT * self.contrast_dn).mean() > MAX_PLACES)

    def share_of_line(self, image: Image) -> float:
        """Of the light that another image has at these places more than the dark frame, the share that is a line's."""
        rise_dn = (image.ravel()[self.pixel].astype(np.float32) - self.dark_dn).clip(0, None)
        return float(self._line_dn(image).clip(0, rise_dn).sum() / max(rise_dn.sum(), 1.0))

    def _line_dn(self, image: Image) -> Float32[Array, "n"]:
        """How much brighter the places are than their surroundings, which edges, texture and noise are not.

        The less of two differences: from the narrowest surface around, which an edge has not, and from the mean
        around, which texture and noise exceed in no more than half of the places.
        """
        size = max(image.shape[1] // MAX_LINE_WIDTH, 15)
        lines = cv2.morphologyEx(image, cv2.MORPH_TOPHAT, np.ones((size, size), dtype=np.uint8))
        detail = image - cv2.blur(image.astype(np.float32), (2 * size + 1, 2 * size + 1))
        line_dn: Float32[Array, "n"] = np.minimum(lines.ravel()[self.pixel], detail.ravel()[self.pixel])
        return line_dn

    def share_of_light(self, image: Image) -> float:
        """How bright the places are in another image, 1 as in the one they were found in."""
        grey = image.ravel()[self.pixel].astype(np.float32)
        return float((grey - self.dark_dn).sum() / self.contrast_dn.sum())


def seen_lasers(shot: Shot) -> tuple[UInt8[Array, "frame"] | None, dict[int, LitPlaces]]:
    """The mask seen in each frame, and the places of each laser that has a frame of its own and was seen there.

    None without a frame that was to be dark. Lasers without a frame of their own count as seen if anything is.
    """
    dark_frames = np.flatnonzero(shot.lasers == 0)
    if not len(dark_frames):
        return None, {}
    images = list(shot.images)
    without = [images[frame] for frame in dark_frames]
    lit = [
        places_lit(image, without, shot.saturation_dn) if mask else None
        for image, mask in zip(images, shot.lasers, strict=True)
    ]
    alone = {int(mask).bit_length() - 1: frame for frame, mask in enumerate(shot.lasers) if int(mask).bit_count() == 1}
    places = {laser: found for laser, frame in alone.items() if (found := lit[frame]) is not None}
    own = sum(1 << laser for laser in alone)
    seen = [
        sum(1 << laser for laser, found in places.items() if found.are_lit_in(image))
        | (int(mask) & ~own if lit[frame] is not None else 0)
        for frame, (image, mask) in enumerate(zip(images, shot.lasers, strict=True))
    ]
    return np.array(seen, dtype=np.uint8), places


def places_lit(image: Image, without: Sequence[Image], saturation_dn: int) -> LitPlaces | None:
    """Places brighter than in all frames without lasers; or than in one of them, if another has the same light."""
    darkest, brightest = functools.reduce(cv2.min, without), functools.reduce(cv2.max, without)
    certain = _brighter_places(image, brightest, darkest, saturation_dn)
    if certain is not None or len(without) == 1:
        return certain
    doubtful = _brighter_places(image, darkest, darkest, saturation_dn)
    stays = doubtful is not None and any(doubtful.are_lit_in(other) for other in without)
    return doubtful if stays else None


def broad_light_dn(shot: Shot, seen: UInt8[Array, "frame"], places: Mapping[int, LitPlaces]) -> float:
    """Grey value of light that only seems to be that of lasers in frames of others; 0 if a line of any of them shows.

    A lamp that lights a part of the image in a laser's own frame and in others gives the laser places that are lit in
    those, too.
    """
    rises_dn = []
    for image, extra in zip(shot.images, (seen & ~shot.lasers).tolist(), strict=True):
        for laser in (laser for laser in places if extra >> laser & 1):
            if places[laser].share_of_line(image) > AS_BRIGHT:
                return 0.0
            rises_dn.append(places[laser].share_of_light(image) * float(places[laser].contrast_dn.mean()))
    return max(rises_dn, default=0.0)


def lasers_out_of_turn(
    shot: Shot, known: Mapping[int, LitPlaces], same_light: Bool[Array, "frame frame"]
) -> tuple[dict[int, LitPlaces], dict[int, LitPlaces]]:
    """The places of the lasers of a shot whose ambient light changes, and those that may shine in frames of others.

    A laser's own frame is compared only with frames of the same ambient light, so that nothing else has places; one
    that has none in this shot keeps those that are known from earlier shots.
    """
    places = dict(known)
    for frame in np.flatnonzero([int(mask).bit_count() == 1 for mask in shot.lasers]):
        others = np.flatnonzero(same_light[frame] & ((shot.lasers & shot.lasers[frame]) == 0))
        without = [shot.images[other] for other in others]
        found = places_lit(shot.images[frame], without, shot.saturation_dn) if without else None
        if found is not None:
            places[int(shot.lasers[frame]).bit_length() - 1] = found
    frames = list(zip(shot.images, shot.lasers.tolist(), strict=True))
    suspects = {
        laser: found
        for laser, found in places.items()
        if any(found.stand_out_in(image) for image, mask in frames if not mask >> laser & 1)
    }
    return places, suspects


def shows_stripe(image: Image) -> bool:
    """Whether a picture without lasers shows something like a stripe: a bright line across a good part of it."""
    stripes = find_stripes(image)
    columns = np.unique(np.rint(stripes.position_px[:, 0]))
    return bool(len(columns) >= MIN_STRIPE * image.shape[1])


def _brighter_places(image: Image, than: Image, dark: Image, saturation_dn: int) -> LitPlaces | None:
    sample = image[::SAMPLED, ::SAMPLED].astype(np.float32) - than[::SAMPLED, ::SAMPLED]
    sigma_dn = 1.4826 * float(np.median(np.abs(sample)))
    least = max(MIN_SHARE_OF_FULL * saturation_dn, MIN_SIGMAS * sigma_dn)
    pixel = np.flatnonzero(cv2.subtract(image, than) > least)
    if not MIN_PIXELS <= len(pixel) <= MAX_SHARE_OF_IMAGE * image.size:
        return None
    dark_dn = dark.ravel()[pixel].astype(np.float32)
    return LitPlaces(pixel=pixel, contrast_dn=image.ravel()[pixel] - dark_dn, dark_dn=dark_dn)
