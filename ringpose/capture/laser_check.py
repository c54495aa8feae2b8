"""Which lasers are seen in the images of a shot, as opposed to those commanded and those reported by the board.

The difference between a laser's own frame and the dark frames gives the pixels that the laser lights. It is seen in
another frame if most of these pixels are bright there, too; neither motion of the target nor ambient light causes that.
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
"""Minimum contrast of a lit pixel to the dark frames, as a share of the full grey value."""

MIN_SIGMAS = 8.0
"""Minimum contrast of a lit pixel to the dark frames, in standard deviations of the noise."""

MIN_PIXELS = 25
"""Minimum number of lit pixels; fewer are glints or noise."""

MAX_SHARE_OF_IMAGE = 0.2
"""Maximum share of lit pixels in an image; more are not a stripe but a change of ambient light."""

MIN_CONTRAST_SHARE = 0.5
"""A pixel counts as lit in another image from this share of its contrast on."""

MIN_LIT_SHARE = 0.7
"""A laser is seen in another image if more than this share of its pixels is lit there."""

MAX_WIDTHS_PER_IMAGE = 25
"""A laser line is narrower than the width of the image divided by this."""

MIN_STRIPE = 0.1
"""Minimum share of the columns of an image that a stripe crosses if its laser hits anything."""

SAMPLED = 7
"""The noise is estimated from every SAMPLED-th row and column."""

Image = UInt[Array, "row column"]


@dataclass(frozen=True, kw_only=True, eq=False)
class LitPixels:
    """The pixels that a laser lights, found by the difference of two images."""

    pixel: Int64[Array, "n"]
    """Indices into the flattened image."""
    lit: Image
    """The image with the laser."""
    dark: Image
    """The image without it."""

    @functools.cached_property
    def dark_dn(self) -> Float32[Array, "n"]:
        """Grey values in the dark image."""
        return self.dark.ravel()[self.pixel].astype(np.float32)

    @functools.cached_property
    def contrast_dn(self) -> Float32[Array, "n"]:
        """Grey values of the lit image above those of the dark one."""
        return self.lit.ravel()[self.pixel] - self.dark_dn

    def are_lit_in(self, image: Image) -> bool:
        """Whether the pixels are about as bright in another image in the same ambient light as with the laser."""
        rise_dn = image.ravel()[self.pixel].astype(np.float32) - self.dark_dn
        return bool((rise_dn > MIN_CONTRAST_SHARE * self.contrast_dn).mean() > MIN_LIT_SHARE)

    def are_on_in(self, image: Image, *, by_lamp: bool = True) -> bool:
        """Whether the laser that lit these pixels is on in an image, whose ambient light may differ.

        Brighter ambient light raises the surroundings of the pixels as well; a laser line is narrow. `by_lamp`: whether
        a lamp may have lit the pixels instead; if not, light that is not a line is recognised by its grey values.
        """
        if by_lamp or self._stand_out_in(self.lit):
            return self._stand_out_in(image)
        return self.are_lit_in(image)

    def _stand_out_in(self, image: Image) -> bool:
        """Whether the pixels are brighter than their surroundings, by more than they are in the dark image."""
        rise_dn = self._line_dn(image) - self._line_dn(self.dark)
        return bool((rise_dn > MIN_CONTRAST_SHARE * self.contrast_dn).mean() > MIN_LIT_SHARE)

    def share_of_line(self, image: Image) -> float:
        """Share of the pixels' rise above the dark frame, in another image, that is as narrow as a laser line."""
        rise_dn = (image.ravel()[self.pixel].astype(np.float32) - self.dark_dn).clip(0, None)
        return float(self._line_dn(image).clip(0, rise_dn).sum() / max(rise_dn.sum(), 1.0))

    def _line_dn(self, image: Image) -> Float32[Array, "n"]:
        """How much brighter the pixels are than their surroundings; about 0 for edges, texture and noise.

        It is the smaller of two values: the morphological top-hat, which is 0 beside an edge, and the difference to the
        local mean, which texture and noise exceed in at most half of the pixels.
        """
        size = max(image.shape[1] // MAX_WIDTHS_PER_IMAGE, 15)
        lines = cv2.morphologyEx(image, cv2.MORPH_TOPHAT, np.ones((size, size), dtype=np.uint8))
        detail = image - cv2.blur(image.astype(np.float32), (2 * size + 1, 2 * size + 1))
        return np.minimum(lines.ravel()[self.pixel], detail.ravel()[self.pixel])

    def share_of_light(self, image: Image) -> float:
        """Contrast of the pixels in another image, relative to the one in which they were found."""
        grey = image.ravel()[self.pixel].astype(np.float32)
        return float((grey - self.dark_dn).sum() / self.contrast_dn.sum())


def seen_lasers(shot: Shot) -> tuple[UInt8[Array, "frame"] | None, dict[int, LitPixels]]:
    """The mask seen in each frame (None without a dark frame), and the pixels of each laser seen in its own frame.

    A laser without a frame of its own counts as seen in a frame if any pixels are lit there.
    """
    dark_frames = np.flatnonzero(shot.lasers == 0)
    if not len(dark_frames):
        return None, {}
    images = list(shot.images)
    without = [images[frame] for frame in dark_frames]
    by_frame = [
        lit_pixels(image, without, shot.saturation_dn) if mask else None
        for image, mask in zip(images, shot.lasers, strict=True)
    ]
    alone = {int(mask).bit_length() - 1: frame for frame, mask in enumerate(shot.lasers) if int(mask).bit_count() == 1}
    pixels = {laser: lit for laser, frame in alone.items() if (lit := by_frame[frame]) is not None}
    own = sum(1 << laser for laser in alone)
    seen = [
        sum(1 << laser for laser, lit in pixels.items() if lit.are_lit_in(image))
        | (int(mask) & ~own if by_frame[frame] is not None else 0)
        for frame, (image, mask) in enumerate(zip(images, shot.lasers, strict=True))
    ]
    return np.array(seen, dtype=np.uint8), pixels


def lit_pixels(image: Image, without: Sequence[Image], saturation_dn: int) -> LitPixels | None:
    """Pixels brighter than in all dark frames; else those brighter than in the darkest, if they are lit in another one.

    The second case is a laser that stays on in one of the dark frames: the image is not brighter than that frame.
    """
    darkest, brightest = functools.reduce(cv2.min, without), functools.reduce(cv2.max, without)
    above_all = _brighter_pixels(image, brightest, darkest, saturation_dn)
    if above_all is not None or len(without) == 1:
        return above_all
    above_one = _brighter_pixels(image, darkest, darkest, saturation_dn)
    stays_on = above_one is not None and any(above_one.are_lit_in(other) for other in without)
    return above_one if stays_on else None


def diffuse_light_dn(shot: Shot, seen: UInt8[Array, "frame"], pixels: Mapping[int, LitPixels]) -> float:
    """Rise in grey value due to diffuse light that was taken for the line of a laser.

    0 if there is none, or if a laser line shows in a frame in which its laser should be off.

    A lamp that lights part of the image both in a laser's own frame and in other frames makes that laser appear to be
    on in the others, too.
    """
    rises_dn = []
    for image, extra in zip(shot.images, (seen & ~shot.lasers).tolist(), strict=True):
        for laser in (laser for laser in pixels if extra >> laser & 1):
            if pixels[laser].share_of_line(image) > MIN_CONTRAST_SHARE:
                return 0.0
            rises_dn.append(pixels[laser].share_of_light(image) * float(pixels[laser].contrast_dn.mean()))
    return max(rises_dn, default=0.0)


def lasers_out_of_sequence(
    shot: Shot, known: Mapping[int, LitPixels], same_light: Bool[Array, "frame frame"]
) -> tuple[dict[int, LitPixels], dict[int, LitPixels]]:
    """The pixels of each laser in a shot whose ambient light changes, and those of lasers that may be on out of turn.

    A laser's own frame is compared only with frames in the same ambient light (`same_light`), so that lamps do not
    count. A laser that has no pixels in this shot keeps those of an earlier one (`known`).
    """
    pixels = dict(known)
    for frame in np.flatnonzero([int(mask).bit_count() == 1 for mask in shot.lasers]):
        others = np.flatnonzero(same_light[frame] & ((shot.lasers & shot.lasers[frame]) == 0))
        without = [shot.images[other] for other in others]
        lit = lit_pixels(shot.images[frame], without, shot.saturation_dn) if without else None
        if lit is not None:
            pixels[int(shot.lasers[frame]).bit_length() - 1] = lit
    frames = list(zip(shot.images, shot.lasers.tolist(), strict=True))
    suspects = {
        laser: lit
        for laser, lit in pixels.items()
        if any(lit.are_on_in(image) for image, mask in frames if not mask >> laser & 1)
    }
    return pixels, suspects


def shows_stripe(image: Image) -> bool:
    """Whether an image without lasers shows something like a stripe: a bright line across many of its columns."""
    stripes = find_stripes(image)
    columns = np.unique(np.rint(stripes.position_px[:, 0]))
    return bool(len(columns) >= MIN_STRIPE * image.shape[1])


def _brighter_pixels(image: Image, than: Image, dark: Image, saturation_dn: int) -> LitPixels | None:
    """Pixels significantly brighter than in `than`, with their contrast to `dark`; None if too few or too many."""
    sample = image[::SAMPLED, ::SAMPLED].astype(np.float32) - than[::SAMPLED, ::SAMPLED]
    sigma_dn = 1.4826 * float(np.median(np.abs(sample)))
    min_contrast_dn = max(MIN_SHARE_OF_FULL * saturation_dn, MIN_SIGMAS * sigma_dn)
    pixel = np.flatnonzero(cv2.subtract(image, than) > min_contrast_dn)
    if not MIN_PIXELS <= len(pixel) <= MAX_SHARE_OF_IMAGE * image.size:
        return None
    return LitPixels(pixel=pixel, lit=image, dark=dark)
