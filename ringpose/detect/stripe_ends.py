"""Where stripes on the face end: an edge blurred by the optics, fitted to the stripe's brightness along itself.

Along the stripe the brightness falls from the face's level to what lies beyond (nothing, the weak continuation
on a wall, a leak of the stripe on the body behind) as an error function; speckle multiplies it (ringpose-method(7),
section 3).
"""

from functools import lru_cache

from ringpose.detect.frames import LaserImage
from ringpose.detect.tracks import lens
from ringpose.kernels import ends as kernels
from ringpose.kernels.ends import EndRules
from ringpose.kernels.lines import MIDDLE_X, MIDDLE_Y, SLOPE, X_END, X_START
from ringpose.types.arrays import Array, Float64
from ringpose.types.camera import Camera

BEYOND_COLUMNS = 40
"""Columns beyond a track in which its end is looked for."""

INSIDE_COLUMNS = 24
"""Columns of the face that set its level before the edge."""

OUTSIDE_COLUMNS = 12
"""Columns beyond the edge that set the level there."""

FLANK_SIGMAS = 3.0
"""Rows on both sides of the line that are looked at, in sigmas of the stripe."""

FLANKS_SHARE = 0.6
"""Share of columns with a saturated pixel above which a stripe is read by its flanks; they see less light."""

UNDIMMED_LEVEL = 0.6
"""Share of the face's level above which a stripe still goes on; a wall beyond a kink has less."""

LEAST_HEADROOM = 0.05
"""Columns that saturation leaves less of than this say nothing about the stripe's level."""

LEAST_NOISE = 0.01
"""No column weighs as if it had less noise than this share of the stripe's level: glare and the tails of the blur."""

SHAPE_SIGMA = 0.005
"""Columns by which a real edge's position depends on how its blur is modelled; adds to what noise explains."""

SATURATED_SHARE = 0.2
"""Share of the last columns with a saturated pixel above which an end is flagged."""

TEXTURE_FACTOR = 1.5
"""Error of a column's peak over what its section leaves unexplained, where crinkled foil lies beneath: 1.4 to 1.75."""

FACET_SIGMAS = 6.0
"""Columns over which what lies beneath a stripe is alike, in sigmas of its section: what is finer than the section is
wide averages out across it."""

NEAR_COLUMNS = 9.0
"""Columns beyond the edge in which the level should be the fitted one; farther out the body's stripe may begin."""

WIDTH_SPREAD = 0.1
"""How far the blur of one end may be from that of the others: depth of field, pixels."""

BLUNT_GAIN = 3.0
"""Falls wider than the stripe is thick must explain all ends of an image by so much better, in log likelihood, to be
believed: no lens blurs more along the stripe than across it, so that an edge has a chamfer or is worn round."""


LINE = [MIDDLE_X, MIDDLE_Y, SLOPE, X_START, X_END]


def stripe_ends(
    tracks: Float64[Array, "track column=11"], image: LaserImage, camera: Camera, saturation_dn: int
) -> Float64[Array, "track end=2 column=10"]:
    """The left and right end of each track in the image that shows its stripe, as the kernel tells them."""
    return kernels.stripe_ends(image.lit, image.dark, tracks[:, LINE], lens(camera), _rules(saturation_dn))


@lru_cache(maxsize=4)
def _rules(saturation_dn: int) -> EndRules:
    return EndRules(
        saturation_dn=saturation_dn,
        beyond_columns=BEYOND_COLUMNS,
        inside_columns=INSIDE_COLUMNS,
        outside_columns=OUTSIDE_COLUMNS,
        flank_sigmas=FLANK_SIGMAS,
        flanks_share=FLANKS_SHARE,
        undimmed_level=UNDIMMED_LEVEL,
        least_headroom=LEAST_HEADROOM,
        least_noise=LEAST_NOISE,
        shape_sigma=SHAPE_SIGMA,
        texture_factor=TEXTURE_FACTOR,
        facet_sigmas=FACET_SIGMAS,
        near_columns=NEAR_COLUMNS,
        width_spread=WIDTH_SPREAD,
        blunt_gain=BLUNT_GAIN,
    )
