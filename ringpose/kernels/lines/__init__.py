"""Arguments of the kernels for line segments through stripe centres (tracks) and for the ring's rim.

The sources are tracks.c (segmentation and line fits) and rim.c (which segments lie on the rim of one planar ring).
"""

import math
from typing import NamedTuple


class Lens(NamedTuple):
    """Pinhole camera and distortion coefficients, named as in OpenCV."""

    fx: float
    fy: float
    cx: float
    cy: float
    k1: float
    k2: float
    p1: float
    p2: float
    k3: float
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0


class TrackParams(NamedTuple):
    """Parameters of the segmentation of stripe centres into straight tracks."""

    kink_px: float
    """A piece is split where it deviates from its chord by more than this plus 1.5 sigmas of its centres."""
    joined_px: float
    """Tracks are joined if their lines differ by less than this, plus two of their sigmas, in the middle of the gap."""
    short_series: float
    """Bias correction: factor on the correlation of residuals, which a line fit reduces in short series."""
    on_line_px: float
    """A centre belongs to a line if it is closer to it than this."""
    border_px: float
    """A track that ends closer than this to the image's left or right border is clipped."""
    min_columns: float
    image_width: float
    max_lag: float
    """Largest lag, in columns, of the autocorrelation of residuals."""


TRACK_COLUMNS = (
    "laser", "centers", "x_start", "x_end", "middle_x", "middle_y",
    "slope", "scatter", "correlation", "clipped", "beyond_ends",
)  # fmt: skip
"""Columns of the result of `straight_segments`; `beyond_ends` counts the centres on the track's line that lie
between 2 px and the track's length (at most 100 px) + 40 px beyond its ends."""

LASER, CENTERS, X_START, X_END, MIDDLE_X, MIDDLE_Y, SLOPE, SCATTER, CORRELATION, CLIPPED, BEYOND_ENDS = range(
    len(TRACK_COLUMNS)
)

MAX_CUT, COLUMNS_PER_CUT = 4, 12
"""Centres at either end of a track that its line does not use (tracks.h): at most so many, one for so many columns."""


class UnionParams(NamedTuple):
    """Conditions under which tracks on a common line are also tried as one merged track."""

    min_beyond_ends: float
    """Fewest centres on a track's line beyond its ends; with fewer there is nothing to merge it with."""
    max_gap: float
    """Longest gap, as a share of the length of both tracks together."""
    separation_px: float
    """Largest distance of the two lines in the middle of the gap,"""
    separation_sigmas: float
    """to which this many of its sigmas are added."""
    max_separation_px: float
    """Limit of that distance, whatever the sigmas."""
    rounds: float
    """Number of merging rounds; each adds one more track."""
    fit_dof: float
    """Degrees of freedom that the line fit takes from the number of independent columns,"""
    min_columns: float
    """and the smallest number that is left."""


class CandidateParams(NamedTuple):
    """Which tracks are candidates for the rim, and how they are ranked for each laser."""

    min_depth_m: float
    max_depth_m: float
    """Depth range of the rim."""
    min_length_m: float
    max_length_m: float
    """Length range of a stripe on it."""
    typical_scatter_px: float
    """The merit of a track is 2 log(columns) - (scatter / typical_scatter)^2 / 2, less the penalties below."""
    max_counted_columns: float
    """Columns beyond this number do not increase the merit."""
    spill_penalty: float
    """Penalty if all centres on the line lie beyond the ends of the track, proportional to their share."""
    coincidence_penalty: float
    """Limit of that penalty if the centres may belong to another laser's stripe on the body behind the rim, at ..."""
    min_behind_m: float
    max_behind_m: float
    """... a distance in this range behind it."""
    clipped_penalty: float
    """Penalty of a track that is truncated by the image border."""
    union_penalty: float
    """Penalty of a merged track."""
    most: float
    """Largest number of candidates for each laser."""


class RingParams(NamedTuple):
    """Ring model that groups of tracks are tested against; costs and penalties are chi-square / 2."""

    focal_x: float
    focal_y: float
    principal_x: float
    principal_y: float
    image_height: float
    border_px: float
    """A stripe closer than this to the upper or lower border may be missed without penalty."""
    along_sigma_px: float
    """Sigma of the distance of a track's end from its circle."""
    across_sigma_px: float
    """Sigma of the distance of a track from the line in which the plane cuts the light plane."""
    plane_limit: float
    """Largest cost of a common plane, for each track."""
    circle_limit: float
    """Largest cost of two concentric circles, for each track."""
    dropped_end_penalty: float
    """Penalty of treating one of six ends as occluded."""
    unseen_penalty: float
    """Penalty of each laser whose stripe is missing where the plane predicts it."""
    max_tilt_rad: float
    min_radius_m: float
    min_band_m: float
    left_x: float = -math.inf
    """Ends to the left of this normalised x, ..."""
    right_x: float = math.inf
    """... to the right of this, ..."""
    top_y: float = -math.inf
    """... above this normalised y or ..."""
    bottom_y: float = math.inf
    """... below this are truncated by the image border and not used for the circles."""


class FaceParams(NamedTuple):
    """Parameters of the search for the rim."""

    unions: UnionParams
    candidates: CandidateParams
    ring: RingParams
