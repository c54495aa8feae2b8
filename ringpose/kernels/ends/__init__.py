"""Stripe endpoints: position, covariance and flags (ringpose-method(7), section 3).

The sources are profile.c (intensity along the stripe), end_noise.c (noise model), end_edges.c (edge fit), end_sigmas.c
(variance of the fitted edge) and ends.c (all of it, covariances and flags).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ringpose.kernels import _kernels
from ringpose.kernels.lines import Lens
from ringpose.types.arrays import Array, Float64, Int64, UInt


class EndParams(NamedTuple):
    """Parameters of the endpoint search. The face is the part of the stripe on the ring's rim."""

    saturation_dn: float
    beyond_columns: float
    """Columns beyond a track in which its end is searched."""
    inside_columns: float
    """Columns of the face from which the level inside the edge is estimated."""
    outside_columns: float
    """Columns beyond the edge from which the level outside is estimated."""
    flank_sigmas: float
    """Rows on both sides of the line that are evaluated, in sigmas of the cross-section."""
    flanks_share: float
    """Share of columns with a saturated pixel above which the amplitude is measured on the flanks only."""
    undimmed_level: float
    """The stripe continues while its level stays above this share of the face's level."""
    min_headroom: float
    """Smallest visible share by which the amplitude of a saturated column is divided."""
    min_noise: float
    """Lower bound of a column's noise, as a share of the stripe's level: glare, tails of the blur."""
    shape_sigma: float
    """Standard deviation, in columns, of the position due to the model of the blur."""
    texture_factor: float
    """Factor from the residual of a column's cross-section to the error of its amplitude."""
    facet_sigmas: float
    """Correlation length of the background texture, in sigmas of the cross-section."""
    near_columns: float
    """Columns beyond the edge in which the level is compared with the fitted one."""
    width_spread: float
    """Relative standard deviation of the widths of edges in one image."""
    blunt_gain: float
    """Gain in log likelihood, over the ends of an edge, by widths larger than the cross-section's, above which ends are
    blunt (rounded or chamfered)."""
    clipped_shape: float
    """Relative error of the shape of a saturated edge, in widths of its blur."""


class LitLines(NamedTuple):
    """Lines whose stripes an image shows."""

    lit: UInt[Array, "row column"]
    dark: UInt[Array, "row column"] | None
    """The same view with these lasers off."""
    lines: Float64[Array, "track column=5"]
    """middle_x, middle_y, slope, x_start, x_end, in undistorted pixels."""


def stripe_ends(images: Sequence[LitLines], lens: Lens, params: EndParams) -> Float64[Array, "track end=2 column=10"]:
    """Left and right end of the stripe on each line of the images in turn, to a fraction of a column.

    The amplitude of the Gaussian cross-section in each column is modelled as a level inside, a level outside and an
    error function between; position, width and levels are estimated by maximum likelihood. What the images of a shot
    have in common, noise, speckle and the width of the blur, is estimated from all ends. Columns of the result: x, y
    and slope of the line there (distorted pixels), sigma along x, the level outside as a share of that inside, the
    share of saturated columns at the end, the edge's width, the sigma of the cross-section, whether the edge is blunt,
    and the relative variance of the amplitudes due to the background; NaN where no edge fits.
    """
    columns = b"".join(
        _kernels.end_columns(
            np.ascontiguousarray(image.lit),
            None if image.dark is None else np.ascontiguousarray(image.dark),
            np.ascontiguousarray(image.lines),
            lens,
            params,
        )
        for image in images
    )
    return np.frombuffer(_kernels.ends(columns, params), dtype=np.float64).reshape(-1, 2, 10)


class MarkParams(NamedTuple):
    """Limits and values of the endpoint flags."""

    image_width: float
    border_px: float
    """An end closer than this to the image's left or right border is truncated."""
    saturated_share: float
    """Share of the last columns with a saturated pixel above which an end is flagged as saturated."""
    kink_level: float
    """An end is a kink (a bend of the surface) if the level outside exceeds this share of the level inside."""
    unclear_px: float
    """Ends with a larger sigma are flagged as unclear."""
    clipped_phase: float
    """Error of a saturated stripe's centre, in pixels, times the sigma of its cross-section."""
    facet_sigmas: float
    """Correlation length of the background texture, in sigmas of the cross-section."""
    fit_dof: float
    """Degrees of freedom that the line fit takes from the number of independent columns,"""
    min_columns: float
    """and the smallest number that is left."""
    saturated_flag: float
    kink_flag: float
    clipped_flag: float
    blunt_flag: float
    unclear_flag: float


class Ends(NamedTuple):
    """The ends of the stripes on the ring's rim, left, then right; NaN where none was found."""

    position_px: Float64[Array, "laser end=2 xy=2"]
    """In the distorted image."""
    covariance_px2: Float64[Array, "laser end=2 xy=2 xy=2"]
    flags: Int64[Array, "laser end=2"]
    straight_px: Float64[Array, "laser end=2 xy=2"]
    """The tracks' own ends, in the undistorted image."""
    straight_sigma_px: Float64[Array, "laser end=2"]
    """Of the ordinates of the tracks' lines there."""


def flagged_ends(
    tracks: Float64[Array, "track column=11"],
    found: Float64[Array, "track end=2 column=10"],
    track_lasers: tuple[int, ...],
    lasers: int,
    params: MarkParams,
) -> Ends:
    """The ends of tracks, each of a different laser, with covariances and flags.

    `tracks` and `found` are the results of `straight_segments` and `stripe_ends`. The error along the line is that
    of the edge; the error across is that of the line: the scatter of the track's centres, divided by the root of the
    number of independent columns, and errors that all its centres share (background, saturation). The scatter is pooled
    over the tracks.
    """
    both = (lasers, 2)
    position, covariance, flags = np.empty((*both, 2)), np.empty((*both, 2, 2)), np.empty(both, np.int64)
    straight, sigma = np.empty((*both, 2)), np.empty(both)
    _kernels.marks(
        np.ascontiguousarray(tracks),
        np.ascontiguousarray(found),
        np.array(track_lasers, dtype=np.int64),
        params,
        position,
        covariance,
        flags,
        straight,
        sigma,
    )
    return Ends(position, covariance, flags, straight, sigma)
