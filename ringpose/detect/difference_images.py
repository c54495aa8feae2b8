"""The frames of a shot by laser, their background, and where ambient light saturates.

Each laser has its own frame if they were switched one by one, else those that were on together share one. Stripes that
are themselves saturated are measured on their flanks and at the foot of their ends (`break_points`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringpose.optics.feature_errors import OUTSIDE_COLUMNS
from ringpose.types.arrays import Array, Bool, Float32, Float64, UInt
from ringpose.types.detection import UNLABELLED, BreakPointFlag, BreakPoints, NoBreakPoints, Stripes
from ringpose.types.image import Frame, Shot, searched_frames
from ringpose.types.rig import Rig

VISIBLE_SHARE = 8 / 255
"""Range of grey values, as a share of the saturation value, from which light shows what it falls on: below it an image
is reported as dark, and ambient light does not show the ring's edges."""

BAND_PX = 24
"""Margin about what is searched near a predicted place: a motion of 15 mm at 1 m between two frames."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaserImage:
    """A frame with lasers on, and the background image to subtract."""

    lit: UInt[Array, "row column"]
    dark: UInt[Array, "row column"] | None
    saturation_dn: int
    """Grey value at which a pixel saturates."""
    lasers: tuple[int, ...]
    """Lasers that its stripes may belong to."""
    stamp_s: float
    """Mid exposure."""
    threshold_scale_dn: int
    """Saturation value of a single exposure, to which thresholds are relative."""
    dark_stamp_s: float = math.nan
    """Mid exposure of the background; NaN without one."""
    label: int = UNLABELLED
    """The laser of its stripes if they can belong to a single one only."""
    left_out: Float32[Array, "row column"] | None = None
    """Light that the background was put in place of, since it may be the ghost of saturated light."""


def laser_images(shot: Shot, count: int, earlier: Frame | None = None) -> list[LaserImage]:
    """The searched frames of a shot, each with a background to subtract.

    The background is the suitable frame nearest in time, because the ambient light on a tumbling target changes.
    `earlier`: a frame without lasers for a shot that has none.
    """
    frames = searched_frames(shot.lasers.tolist(), count)
    return [_laser_image(shot, number, lasers, also_on, earlier) for number, lasers, also_on in frames]


def repeated_image(shot: Shot, images: Sequence[LaserImage]) -> LaserImage | None:
    """A frame with several lasers on that repeats the stripes of `images`, each of one laser; None if there is none."""
    lasers = {laser for image in images for laser in image.lasers}
    if any(image.label == UNLABELLED for image in images):
        return None
    for number, mask in enumerate(shot.lasers.tolist()):
        shown = tuple(laser for laser in sorted(lasers) if mask >> laser & 1)
        if len(shown) > 1:
            return _laser_image(shot, number, shown, 0, None)
    return None


def brightest_image(shot: Shot) -> UInt[Array, "row column"]:
    """The first of the images with the most lasers on."""
    on = [mask.bit_count() for mask in shot.lasers.tolist()]
    image: UInt[Array, "row column"] = shot.images[int(np.argmax(on))]
    return image


def _laser_image(shot: Shot, number: int, lasers: tuple[int, ...], also_on: int, earlier: Frame | None) -> LaserImage:
    """A frame with the background nearest in time in which exactly the lasers `also_on` are on, if there is one."""
    dark, dark_stamp_s = None, math.nan
    same = [each for each, mask in enumerate(shot.lasers.tolist()) if mask == also_on]
    if same:
        nearest = min(same, key=lambda each: abs(shot.stamp_s[each] - shot.stamp_s[number]))
        dark, dark_stamp_s = shot.images[nearest], shot.mid_exposure_s(nearest)
    elif earlier is not None and also_on == earlier.lasers:
        dark, dark_stamp_s = earlier.image, earlier.mid_exposure_s
    return LaserImage(
        lit=shot.images[number],
        dark=dark,
        saturation_dn=shot.saturation_dn,
        lasers=lasers,
        stamp_s=shot.mid_exposure_s(number),
        dark_stamp_s=dark_stamp_s,
        threshold_scale_dn=shot.usual_full_dn,
        label=lasers[0] if len(lasers) == 1 else UNLABELLED,
    )


# Saturation by ambient light, and the exposure that would avoid it

HIDING_COLUMNS, FLANK_ROWS = np.arange(2.0, 8.0), np.array([-7.0, -6.0, 6.0, 7.0])
"""Columns beyond an end in which ambient light may hide the stripe; rows about its line in which that shows without a
background frame."""


def hidden_by_saturation(points: BreakPoints, images: Sequence[LaserImage], saturation_dn: int) -> bool:
    """Whether the ambient light saturates most pixels beside most ends, so that stripes that go on would not be seen.

    Such ends may be borders of a shadow on a surface that goes on: the shadow of a ring on foil has the shape of a
    ring. Beside single ends of a ring there may be glints of foil.
    """
    hidden, middle_x = 0, (points.face_start_undistorted_px[:, 0] + points.face_end_undistorted_px[:, 0]) / 2
    for image in images:
        ambient, rows = _ambient(image)
        laser, edge = np.nonzero(points.seen[list(image.lasers)])
        laser = np.array(image.lasers)[laser]
        x, y = points.position_px[laser, edge].T[..., None]
        outward = np.where(x > middle_x[laser, None], 1.0, -1.0)
        column = np.rint(x + outward * HIDING_COLUMNS).astype(int)
        row = np.rint(y + rows).astype(int).clip(0, ambient.shape[0] - 1)
        inside = (column >= 0) & (column < ambient.shape[1])
        near = ambient[row[:, :, None], column.clip(0, ambient.shape[1] - 1)[:, None]] >= saturation_dn
        share = (near & inside[:, None]).mean(axis=(1, 2))
        hidden += int(np.count_nonzero(2.0 * share > 1.0))
    return hidden > 0 and 2 * hidden >= int(points.seen.sum())


def saturated_along_stripes(points: BreakPoints, images: Sequence[LaserImage], saturation_dn: int) -> bool:
    """Whether the ambient light saturates most of the pixels along most stripes.

    The visible parts of the stripes then lie in shadows, and the ring's face is saturated, since metal in sunlight is
    brighter than foil. Edges found there are those of the shadows.
    """
    saturated, stripes = 0, 0
    for image in images:
        ambient, rows = _ambient(image)
        start, end = (
            points.face_start_undistorted_px[list(image.lasers)],
            points.face_end_undistorted_px[list(image.lasers)],
        )
        known = np.isfinite(start + end).all(axis=1)
        start, end = start[known], end[known]
        column = np.arange(ambient.shape[1])
        slope = (end[:, 1:] - start[:, 1:]) / (end[:, :1] - start[:, :1])
        row = np.rint((start[:, 1:] + slope * (column - start[:, :1]))[:, None] + rows[:, None]).astype(int)
        inside = (row >= 0) & (row < ambient.shape[0])
        course = inside & (ambient[row.clip(0, ambient.shape[0] - 1), column] >= saturation_dn)
        saturated += int((2 * course.sum(axis=(1, 2)) > inside.sum(axis=(1, 2))).sum())
        stripes += len(start)
    return 2 * saturated > stripes


def _ambient(image: LaserImage) -> tuple[UInt[Array, "row column"], Float64[Array, "offset"]]:
    """The image that shows the ambient light, and the rows about a stripe's line in which to look at it."""
    return (image.lit, FLANK_ROWS) if image.dark is None else (image.dark, np.array([-1.0, 0.0, 1.0]))


def beside_left_out(
    position_px: Float64[Array, "laser edge=2 xy=2"],
    image: LaserImage,
    left_out: Float32[Array, "row column"],
    share: float,
) -> Bool[Array, "laser edge=2"]:
    """Which ends of stripes are near light that was `left_out` and so bright that the stripes may go on there.

    That is more than a `share` of the stripe's own light.
    """
    beside = np.zeros(position_px.shape[:2], dtype=bool)
    light = image.lit.astype(np.float32) - (0.0 if image.dark is None else image.dark)
    for laser in image.lasers:
        for edge in np.flatnonzero(np.isfinite(position_px[laser]).all(axis=1)):
            x, y = np.rint(position_px[laser, edge]).astype(int)
            rows, reach = slice(max(y - 3, 0), y + 4), OUTSIDE_COLUMNS
            near = slice(max(x - reach, 0), x + reach + 1)
            inside = slice(x, x + reach + 1) if position_px[laser, 1 - edge, 0] > x else slice(max(x - reach, 0), x + 1)
            own_dn = float(np.median(light[rows, inside].max(axis=0, initial=0.0)))
            beside[laser, edge] = left_out[rows, near].max(initial=0.0) > share * own_dn
    return beside


SATURATED_SHARE = 0.02
"""Share of saturated pixels above which a shot without break points is overexposed; stripes cover less."""

SHORTER = 2.0
"""Factor by which a shorter exposure is suggested if stripes are saturated, and twice if ambient light is."""


LASER_RATIO = 3.0
"""Ratio of the brightness of two stripes from which each laser has its own exposure. The fainter one has a third of the
light, and 1.7 times the shot noise (2.4 times with twice the ratio); with half of it, lasers of one kind differ as
much, and most shots would take the time of several exposures."""


BRIGHT_PERCENTILE = 90
"""Percentile of a stripe's columns that its brightness is: a stripe has glints, and parts that are hardly seen."""


def laser_advice(stripes: Stripes, rig: Rig) -> str:
    """The lasers of which one is so much brighter than another that each needs its own exposure, as a phrase, or empty.

    Only stripes count that frames with one laser show; where they are on the face, if on one at all, is not known.
    """
    of_stripes = stripes.laser[stripes.piece]
    bright_dn = {
        laser: float(np.percentile(stripes.peak_dn[of_stripes == laser], BRIGHT_PERCENTILE))
        for laser in np.unique(of_stripes[of_stripes != UNLABELLED]).tolist()
    }
    if len(bright_dn) <= 1:
        return ""
    faint, bright = min(bright_dn, key=bright_dn.__getitem__), max(bright_dn, key=bright_dn.__getitem__)
    ratio = bright_dn[bright] / bright_dn[faint]
    if ratio < LASER_RATIO:
        return ""
    names = rig.lasers.names
    return (
        f"the stripes of laser {names[bright]} are {ratio:.2g} times as bright as those of {names[faint]}: expose each "
        "laser for itself (capture --exposure auto)"
    )


def exposure_advice(points: BreakPoints | NoBreakPoints, shot: Shot, images: Sequence[LaserImage]) -> str:
    """The exposure that would help, as a phrase; empty if nothing that matters is saturated."""
    factor = overexposure(points, images)
    if factor == 1.0:
        return ""
    used_s = float(shot.exposure_s.max())
    better = f"expose for about {1e3 * used_s / factor:.2g} ms"
    faint = _faint_lasers(points, images) if isinstance(points, BreakPoints) else []
    if faint:
        numbers = ", ".join(str(laser + 1) for laser in faint)
        better = f"{better}, but laser {numbers} as now: each for itself (capture --exposure auto)"
    return f"saturated at an exposure of {1e3 * used_s:.3g} ms: {better}"


def _faint_lasers(points: BreakPoints, images: Sequence[LaserImage]) -> list[int]:
    """The lasers with a frame of their own whose stripe on the face is `LASER_RATIO` times fainter than saturation."""
    faint = []
    for image in images:
        ends = points.position_px[image.label]
        if image.label == UNLABELLED or not np.isfinite(ends).all():
            continue
        (left, first), (right, last) = ends[np.argsort(ends[:, 0])].tolist()
        column = np.arange(math.ceil(left), max(math.ceil(right), math.ceil(left) + 1))
        row = np.rint(np.interp(column, [left, right], [first, last])).astype(int) + np.arange(-2, 3)[:, None]
        bright_dn = np.median(image.lit[row.clip(0, len(image.lit) - 1), column].max(axis=0))
        if bright_dn < image.saturation_dn / LASER_RATIO:
            faint.append(image.label)
    return faint


def overexposure(points: BreakPoints | NoBreakPoints, images: Sequence[LaserImage]) -> float:
    """Factor by which the exposure should be shorter; 1 if nothing that matters is saturated."""
    if isinstance(points, BreakPoints):
        return SHORTER if np.any(points.flags & int(BreakPointFlag.SATURATED)) else 1.0
    if not images:
        return 1.0
    saturation_dn = images[0].saturation_dn
    ambient = [image.lit if image.dark is None else image.dark for image in images]
    if max(float((each[::4, ::4] >= saturation_dn).mean()) for each in ambient) > SATURATED_SHARE:
        return SHORTER**2
    lit = max(float((image.lit[::4, ::4] >= saturation_dn).mean()) for image in images)
    return SHORTER if lit > SATURATED_SHARE / 4 else 1.0
