"""Saturation: stripes whose ends it hides, and the exposure that would avoid it.

Stripes that are themselves saturated are measured on their flanks and at the foot of their ends (`break_points`).
"""

from collections.abc import Sequence

import numpy as np

from ringpose.detect.difference_images import LaserImage
from ringpose.types.arrays import Array, Float64, UInt
from ringpose.types.detection import BreakPointFlag, BreakPoints, NoBreakPoints
from ringpose.types.image import Shot

HIDING_COLUMNS, FLANK_ROWS, HIDDEN_SHARE = np.arange(2.0, 8.0), np.array([-7.0, -6.0, 6.0, 7.0]), 0.5
"""Columns beyond an end in which ambient light may hide the stripe; rows about its line in which that shows without a
background frame; share of saturated pixels there above which it does."""

HIDDEN_COURSE, COURSE_STEP = 0.5, 8
"""Share of a stripe's course across the image in which ambient light saturates, above which the stripe may be brightest
where it cannot be seen; step in columns by which it is sampled."""


def hidden_by_saturation(points: BreakPoints, images: Sequence[LaserImage], saturation_dn: int) -> bool:
    """Whether the ambient light saturates beside most of the ends, so that stripes that go on would not be seen.

    Such ends may be borders of a shadow on a surface that goes on: the shadow of a ring on foil has the shape of a
    ring. Beside single ends of a ring there may be glints of foil.
    """
    hidden, middle_x = 0, (points.face_start_px[:, 0] + points.face_end_px[:, 0]) / 2
    for image in images:
        ambient, rows = _ambient(image)
        for laser in image.lasers:
            for x, y in points.position_px[laser, points.seen[laser]].tolist():
                column = np.rint(x + HIDING_COLUMNS * (1 if x > middle_x[laser] else -1)).astype(int)
                row = np.clip(np.rint(y + rows).astype(int), 0, ambient.shape[0] - 1)
                near = ambient[row][:, column[(column >= 0) & (column < ambient.shape[1])]]
                hidden += int((near >= saturation_dn).sum() > HIDDEN_SHARE * rows.size * HIDING_COLUMNS.size)
    return 2 * hidden >= int(points.seen.sum())


def saturated_along_stripes(points: BreakPoints, images: Sequence[LaserImage], saturation_dn: int) -> bool:
    """Whether the ambient light saturates most of the pixels along most stripes.

    The visible parts of the stripes then lie in shadows, and the ring's face is saturated, since metal in sunlight is
    brighter than foil. Edges found there are those of the shadows.
    """
    saturated, stripes = 0, 0
    for image in images:
        ambient, rows = _ambient(image)
        start, end = points.face_start_px[list(image.lasers)], points.face_end_px[list(image.lasers)]
        known = np.isfinite(start + end).all(axis=1)
        start, end = start[known], end[known]
        column = np.arange(0, ambient.shape[1], COURSE_STEP)
        slope = (end[:, 1:] - start[:, 1:]) / (end[:, :1] - start[:, :1])
        row = np.rint((start[:, 1:] + slope * (column - start[:, :1]))[:, None] + rows[:, None]).astype(int)
        inside = (row >= 0) & (row < ambient.shape[0])
        course = inside & (ambient[row.clip(0, ambient.shape[0] - 1), column] >= saturation_dn)
        saturated += int((course.sum(axis=(1, 2)) > HIDDEN_COURSE * inside.sum(axis=(1, 2))).sum())
        stripes += len(start)
    return 2 * saturated > stripes


def _ambient(image: LaserImage) -> tuple[UInt[Array, "row column"], Float64[Array, "offset"]]:
    """The image that shows the ambient light, and the rows about a stripe's line in which to look at it."""
    return (image.lit, FLANK_ROWS) if image.dark is None else (image.dark, np.array([-1.0, 0.0, 1.0]))


SATURATED_SHARE = 0.02
"""Share of saturated pixels above which a shot without break points is overexposed; stripes cover less."""

SHORTER, MUCH_SHORTER = 2.0, 4.0
"""Factors by which a shorter exposure is suggested: if stripes are saturated, and if ambient light is."""


def exposure_advice(found: BreakPoints | NoBreakPoints, shot: Shot, images: Sequence[LaserImage]) -> str:
    """The exposure that would help, as a phrase; empty if nothing that matters is saturated."""
    factor = overexposure(found, images)
    if factor == 1.0:
        return ""
    used_s = float(shot.exposure_s.max())
    return f"saturated at an exposure of {1e3 * used_s:.3g} ms: expose for about {1e3 * used_s / factor:.2g} ms"


def overexposure(found: BreakPoints | NoBreakPoints, images: Sequence[LaserImage]) -> float:
    """By which factor the exposure should be shorter; 1 if nothing that matters is saturated."""
    if isinstance(found, BreakPoints):
        return SHORTER if np.any(found.flags & int(BreakPointFlag.SATURATED)) else 1.0
    if not images:
        return 1.0
    saturation_dn = images[0].saturation_dn
    ambient = [image.lit if image.dark is None else image.dark for image in images]
    if max(float((each[::4, ::4] >= saturation_dn).mean()) for each in ambient) > SATURATED_SHARE:
        return MUCH_SHORTER
    lit = max(float((image.lit[::4, ::4] >= saturation_dn).mean()) for image in images)
    return SHORTER if lit > SATURATED_SHARE / 4 else 1.0
