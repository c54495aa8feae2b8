"""Stripe endpoints: position and standard deviation (ringpose-method(7), section 3).

The sources are profile.c (intensity along the stripe), end_noise.c (noise model), end_edges.c (edge fit), end_sigmas.c
(variance of the fitted edge) and ends.c (all of it).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ringpose.kernels import _kernels
from ringpose.kernels.lines import Lens
from ringpose.types.arrays import Array, Float64, UInt


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
