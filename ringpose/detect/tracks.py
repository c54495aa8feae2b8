"""Straight tracks: the stripes' pieces in the undistorted image, cut at kinks and joined across gaps.

A light plane draws a straight line on every planar surface, so the stripe on the ring's face is one track;
a wall or a foil behind it adds tracks of other directions or places.
"""

from functools import lru_cache

from ringpose.kernels import lines as kernels
from ringpose.kernels.lines import Lens, TrackRules
from ringpose.types.arrays import Array, Float64
from ringpose.types.camera import Camera
from ringpose.types.detection import Stripes

MINIMUM_COLUMNS = 10
"""A shorter track says nothing about direction; 20 mm of ring at 1 m are twice as many."""

BORDER_PX = 3.0
"""A centre so close to the image's left or right border is the last that could be seen."""

KINK_PX = 0.6
"""A piece that leaves its chord by more than this (and by its own scatter) is cut there."""

JOINED_PX = 0.5
"""Tracks whose lines meet this closely across a gap are one surface."""

ON_LINE_PX = 2.5
"""Centres so close to a track's line are on its surface; the nearest body behind a ring jumps by 4 px at 1 m."""

SHORT_SERIES = 1.25
"""A line fitted to a short series takes part of its likeness away: what is found is so much too small."""

TAKEN_BY_THE_FIT, LEAST_COLUMNS = 5.0, 0.5
"""Independent columns that a fit takes from a series, and the least that are left to it.

The line takes up part of what neighbours err alike, which then shows neither in the scatter nor in the likeness: at 29
columns and grains of 4 px, as 30 mm at 1 m before a wide lens, one line in ten was off by three sigmas.
"""

LONGEST_CORRELATION = 40
"""Columns over which errors of neighbouring centres are looked at for likeness: a facet of crinkled foil."""


def straight_tracks(stripes: Stripes, camera: Camera) -> Float64[Array, "track column=11"]:
    """The straight tracks among the stripes, in undistorted pixels; columns as in `TRACK_COLUMNS`."""
    optics, rules = lens(camera), _rules(camera.image_width)
    return kernels.straight_tracks(stripes.position_px, stripes.sigma_px, stripes.piece, stripes.laser, optics, rules)


@lru_cache(maxsize=4)
def _rules(image_width: int) -> TrackRules:
    return TrackRules(
        kink_px=KINK_PX,
        joined_px=JOINED_PX,
        short_series=SHORT_SERIES,
        on_line_px=ON_LINE_PX,
        border_px=BORDER_PX,
        minimum_columns=MINIMUM_COLUMNS,
        image_width=image_width,
        longest_lag=LONGEST_CORRELATION,
    )


@lru_cache(maxsize=4)
def lens(camera: Camera) -> Lens:
    """The camera's parameters as the kernels take them."""
    matrix = camera.camera_matrix
    focal_and_principal = (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])
    return Lens(*(float(each) for each in (*focal_and_principal, *camera.distortion_coefficients)))
