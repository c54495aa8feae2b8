"""Readable NumPy twin of `stripe_weights.c`: centres of speckled stripes, whose light scatters by a share of itself.

The weights are those of ringpose-method(7), section 3.
"""

import math
from typing import NamedTuple

import numpy as np

from ringpose.kernels.reference_stripe_columns import Columns, Measure
from ringpose.kernels.reference_stripe_patches import Pixels, sections
from ringpose.kernels.reference_stripe_sigmas import Scatter, scatter_at
from ringpose.types.arrays import Array, Bool, Float64, Int64

REACH_PER_WIDTH, MOST_REACH = 5.0, 40
"""Rows on either side, in widths of the stripe: the outer ones show what lies beneath it; and rows at most."""

MOST_SPECKLE, LEVELS = 12.0, 4
"""Speckle over noise that is believed at most; there are weights for that, and for a half, a quarter and an eighth."""

PHASES = 8
"""And weights for some places of the centre in its pixel."""

LONGEST_STEP, SHORT_STEP = 0.75, 0.125
"""No centre moves farther at once, in pixels; after a short first step a second one changes nothing."""

WHOLE_WIDTHS = 3.0
"""Rows from the upper or lower border from which on too little is missing to matter, in widths."""


class Weights(NamedTuple):
    """What weighs the rows about a centre: a stripe's brightness, and how far it lies off times that."""

    brightness: Float64[Array, "phase row"]
    offset: Float64[Array, "phase row"]

    @property
    def square(self) -> float:
        """Mean over the phases of the sum of the squares of the latter."""
        return float((self.offset**2).sum()) / PHASES


def weighed(pixels: Pixels, columns: Columns, of: Scatter, how: Measure) -> tuple[Columns, Scatter]:
    """Centres anew, from those that the filter found, where speckle scatters them so: by weights that suit each column.

    Without columns that show none near by. Also how they scatter, over what noise explains of the former.
    """
    reach = min(math.ceil(REACH_PER_WIDTH * how.width), MOST_REACH)
    level = _levels(columns, of, how)
    levels = [weights(how.width, MOST_SPECKLE / 2**i, reach) for i in range(LEVELS)]
    tables = np.array([[each.brightness, each.offset] for each in levels])
    y, step = _stepped(pixels, columns.x, columns.y, level, tables)
    again = abs(step) > SHORT_STEP
    y[again], step[again] = _stepped(pixels, columns.x[again], y[again], level[again], tables)
    whole = WHOLE_WIDTHS * how.width
    kept = (abs(step) < LONGEST_STEP) & (y >= whole) & (y <= len(pixels) - 1 - whole)
    per_variance = np.array([each.square for each in levels]) / (how.filter_.slope_norm * how.peak_per_response) ** 2
    turned = columns.variance * per_variance[level]
    left = scatter_at(y[kept], columns.variance[kept], of.lag)
    return Columns(x=columns.x[kept], y=y[kept], variance=turned[kept], peak=columns.peak[kept]), left


def weights(width: float, speckle: float, reach: int) -> Weights:
    """Those of least squares for a stripe of that width (sigma), its speckle so many times the noise at its crest.

    What lies beneath the stripe is fitted as well: a constant and a slope.
    """
    offset = (np.arange(PHASES) + 0.5) / PHASES - 0.5
    off = np.arange(-reach, reach + 1) - offset[:, None]
    light = np.exp(-0.5 * (off / width) ** 2)
    shapes = np.stack([np.ones_like(off), off / reach, light, light * off / width**2], axis=1)
    shaped = shapes / (1 + (speckle * light) ** 2)[:, None]
    solved = np.linalg.solve(shaped @ shapes.swapaxes(1, 2), shaped)
    return Weights(solved[:, 2], solved[:, 3])


def _levels(columns: Columns, of: Scatter, how: Measure) -> Int64[Array, "n"]:
    """Which weights suit each column.

    Of a Gaussian ridge's speckle the filter lets through a share of what it lets through of noise: that, times the
    square of speckle over noise, is the excess.
    """
    share = how.width**2 / (how.width**2 + how.filter_.sigma**2)
    precision = float(np.mean(1 / columns.variance))
    square = (of.excess() - 1) / share**1.5 / (precision * columns.variance)
    level: Int64[Array, "n"] = np.digitize(MOST_SPECKLE**2 / square, [2.0, 8.0, 32.0])
    return level


def _stepped(
    pixels: Pixels,
    x: Int64[Array, "n"],
    y: Float64[Array, "n"],
    level: Int64[Array, "n"],
    tables: Float64[Array, "weights sum=2 phase height"],
) -> tuple[Float64[Array, "n"], Float64[Array, "n"]]:
    """The centres that the rows about the nearest pixel show, and how far they lie from the middle of their phase."""
    row = np.floor(y + 0.5)
    phase = np.clip(((y - row + 0.5) * PHASES).astype(np.int64), 0, PHASES - 1)
    section = sections(pixels, row.astype(np.int64), x, tables.shape[-1] // 2).astype(np.float64)
    light, moment = ((section * table[level, phase]).sum(axis=-1) for table in tables.swapaxes(0, 1))
    stripe: Bool[Array, "n"] = light > 0
    step = np.where(stripe, moment / np.where(stripe, light, 1.0), LONGEST_STEP)
    step = np.clip(step, -LONGEST_STEP, LONGEST_STEP)
    return row + ((phase + 0.5) / PHASES - 0.5) + step, step
