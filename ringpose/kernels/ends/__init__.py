"""Where stripes end, and how well that is known."""

from typing import NamedTuple

import numpy as np

from ringpose.kernels import _kernels
from ringpose.kernels.lines import Lens
from ringpose.types.arrays import Array, Float64, Int64, UInt


class EndParams(NamedTuple):
    """What finds the end of a stripe."""

    saturation_dn: float
    beyond_columns: float
    """Columns beyond a track in which its end is looked for."""
    inside_columns: float
    """Columns of the face that set its level before the edge."""
    outside_columns: float
    """Columns beyond the edge that set the level there."""
    flank_sigmas: float
    """Rows on both sides of the line that are looked at, in sigmas of the stripe."""
    flanks_share: float
    """Share of columns with a saturated pixel above which a stripe is read by its flanks."""
    undimmed_level: float
    """Share of the face's level above which the stripe still goes on."""
    min_headroom: float
    """Columns that saturation leaves less of than this say nothing about the stripe's level."""
    min_noise: float
    """No column weighs as if it had less noise than this share of the stripe's level: glare, the blur's tails."""
    shape_sigma: float
    """Columns by which an edge's position depends on how its blur is modelled."""
    texture_factor: float
    """What a column's section leaves unexplained, times this, is what it errs by."""
    facet_sigmas: float
    """Columns over which what lies beneath a stripe is alike, in sigmas of its section."""
    near_columns: float
    """Columns beyond the edge in which the level there must be the one that was fitted."""
    width_spread: float
    """Relative standard deviation of an edge's width about that of all edges."""
    blunt_gain: float
    """Gain in log likelihood by widths beyond that of the stripe's section, of all ends, above which ends are blunt."""


def stripe_ends(
    lit: UInt[Array, "row column"],
    dark: UInt[Array, "row column"] | None,
    lines: Float64[Array, "track column=5"],
    lens: Lens,
    rules: EndParams,
) -> Float64[Array, "track end=2 column=10"]:
    """Left and right end of the stripe on each line, to a fraction of a column.

    Lines are middle_x, middle_y, slope, x_start, x_end in undistorted pixels. The stripe's brightness along its line
    (the Gaussian section that fits each column best) is compared with a level inside, a level outside, and an error
    function between; the most likely position, width and levels win, widths near that which suits all ends best.
    Columns of the result: x, y and slope of the line there (distorted pixels), sigma along x, the level outside as a
    share of that inside, the share of saturated columns at the end, the edge's width, the sigma of the stripe's
    section, whether the edge is blunt, and the relative variance of the peaks by what lies beneath the stripe; NaN
    where no edge fits.
    """
    black = None if dark is None else np.ascontiguousarray(dark)
    found = _kernels.ends(np.ascontiguousarray(lit), black, np.ascontiguousarray(lines), lens, rules)
    return np.frombuffer(found, dtype=np.float64).reshape(-1, 2, 10)


class MarkParams(NamedTuple):
    """What an end is held against, and the flags for it."""

    image_width: float
    border_px: float
    """An end so close to the image's left or right border is none."""
    saturated_share: float
    """Share of the last columns with a saturated pixel above which an end is saturated."""
    kink_level: float
    """A level beyond the edge of this share of the face's is a kink."""
    unclear_px: float
    """Ends with a greater sigma are unclear."""
    clipped_phase: float
    """Error of a saturated stripe's centre, times the sigma of its section in pixels."""
    facet_sigmas: float
    """Columns over which what lies beneath a stripe is alike, in sigmas of its section."""
    taken_by_fit: float
    """Independent columns that a line's fit takes,"""
    min_columns: float
    """and the least that are left."""
    saturated_flag: float
    kink_flag: float
    clipped_flag: float
    blunt_flag: float
    unclear_flag: float


class Ends(NamedTuple):
    """The ends of stripes on the ring's face, left then right; NaN where none was seen."""

    position_px: Float64[Array, "laser end=2 xy=2"]
    """Distorted."""
    covariance_px2: Float64[Array, "laser end=2 xy=2 xy=2"]
    flags: Int64[Array, "laser end=2"]
    straight_px: Float64[Array, "laser end=2 xy=2"]
    """The tracks' own ends, undistorted."""
    straight_sigma_px: Float64[Array, "laser end=2"]
    """Of the tracks' ordinates there."""


def marked_ends(
    tracks: Float64[Array, "track column=11"],
    found: Float64[Array, "track end=2 column=10"],
    track_lasers: tuple[int, ...],
    lasers: int,
    rules: MarkParams,
) -> Ends:
    """The ends of tracks, each of another one of so many lasers, with covariances and flags.

    `tracks` and `found` are the results of `stripe_line_segments` and `stripe_ends`. An end errs along its line by its
    own sigma, and with the line across: by the scatter of the track's centres, columns that err alike counted once,
    and by what these share and do not show.
    """
    both = (lasers, 2)
    position, covariance, flags = np.empty((*both, 2)), np.empty((*both, 2, 2)), np.empty(both, np.int64)
    straight, sigma = np.empty((*both, 2)), np.empty(both)
    _kernels.marks(
        np.ascontiguousarray(tracks),
        np.ascontiguousarray(found),
        np.array(track_lasers, dtype=np.int64),
        rules,
        position,
        covariance,
        flags,
        straight,
        sigma,
    )
    return Ends(position, covariance, flags, straight, sigma)
