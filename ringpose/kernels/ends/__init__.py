"""Stripe endpoints: position and standard deviation (ringpose-method(7), section 3).

The sources are profile.c (intensity along the stripe), end_noise.c (noise model), end_edges.c (edge fit), end_sigmas.c
(variance of the fitted edge) and ends.c (all of it).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ringpose.kernels import _kernels, column_names, kernel_record
from ringpose.kernels.lines import Lens
from ringpose.optics.feature_errors import INSIDE_COLUMNS, MIN_NOISE, OUTSIDE_COLUMNS, WIDTH_SPREAD
from ringpose.types.arrays import Array, Float64, UInt

FACET_SIGMAS = 6.0
"""Correlation length of the surface texture along a stripe, in sigmas of its cross-section: finer texture averages out
across the stripe."""


@kernel_record
@dataclass(frozen=True, slots=True, kw_only=True)
class EndParams:
    """Parameters of the endpoint search. The face is the part of the stripe on the ring's rim."""

    saturation_dn: int
    beyond_columns: int = 40
    """Columns beyond a track in which its end is searched."""
    inside_columns: int = INSIDE_COLUMNS
    outside_columns: int = OUTSIDE_COLUMNS
    flank_sigmas: float = 3.0
    """Half height of the evaluated window about the line, in sigmas of the cross-section."""
    flanks_share: float = 0.6
    """Share of columns with a saturated pixel above which the amplitude is measured on the flanks only."""
    undimmed_level: float = 0.6
    """A stripe continues while its level stays above this share of the face's: on a wall beyond a kink it is lower."""
    min_headroom: float = 0.05
    """Smallest visible share by which the amplitude of a saturated column is divided."""
    min_noise: float = MIN_NOISE
    shape_sigma: float = 0.005
    """Standard deviation, in columns, of the position due to the model of the blur; added to that by noise."""
    texture_factor: float = 1.5
    """Factor from the residual of a column's cross-section to the error of its amplitude, on crinkled foil: 1.4 to
    1.75."""
    facet_sigmas: float = FACET_SIGMAS
    near_columns: float = 9.0
    """Columns beyond the edge in which the fitted level is required; farther out a stripe on the body may begin."""
    width_spread: float = WIDTH_SPREAD
    blunt_gain: float = 3.0
    """Gain in log likelihood, over all ends of an edge, by widths larger than the cross-section's, above which ends are
    blunt: optics do not blur more along a stripe than across it, so that the edge is chamfered or worn."""
    clipped_shape: float = 0.45
    """Relative error of the shape of a saturated edge: its visible foot is not that of a Gaussian blur, since speckle
    is clipped, too, and light on a wall or glare adds to it."""


END_COLUMNS, LINE_COLUMNS = column_names("StripeEnd"), column_names("StripeLine")
"""Columns of an end (ends.c), and of a line whose ends are searched (profile.h)."""


class LitLines(NamedTuple):
    """Lines whose stripes an image shows."""

    lit: UInt[Array, "row column"]
    dark: UInt[Array, "row column"] | None
    """The view with these lasers off."""
    lines: Float64[Array, "track column=5"]
    """`LINE_COLUMNS`, in undistorted pixels."""


def stripe_ends(images: Sequence[LitLines], lens: Lens, params: EndParams) -> Float64[Array, "track end=2 column=10"]:
    """Left and right end of the stripe on each line of the images in turn, to a fraction of a column.

    The amplitude of the Gaussian cross-section in each column is modelled as a level inside, a level outside and an
    error function between; position, width and levels are estimated by maximum likelihood. What the images of a shot
    have in common, noise, speckle and the width of the blur, is estimated from all ends. Columns of the result
    (`END_COLUMNS`): x, y and slope of the line there (distorted pixels), sigma along x, the level outside as a share of
    that inside, the share of saturated columns at the end, the edge's width, the sigma of the cross-section, whether
    the edge is blunt, and the relative variance of the amplitudes due to the background; NaN where no edge fits.
    """
    arrays = tuple(
        (
            np.ascontiguousarray(image.lit),
            None if image.dark is None else np.ascontiguousarray(image.dark),
            np.ascontiguousarray(image.lines),
        )
        for image in images
    )
    return np.frombuffer(_kernels.ends(arrays, lens, params)).reshape(-1, 2, len(END_COLUMNS))
