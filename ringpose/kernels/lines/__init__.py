"""Arguments of the kernels for line segments through stripe centres and for the ring's rim.

The sources are stripe_segments.c (segmentation and line fits), rim.c (which segments lie on the rim of one planar ring)
and arcs.c (two concentric arcs).
"""

import math
from dataclasses import dataclass

from ringpose.kernels import column_names, kernel_record
from ringpose.optics.feature_errors import AGREEMENT, FIT_DOF_CORRECTION, MIN_COLUMNS, MIN_SEGMENT_COLUMNS


@kernel_record
@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
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
    k4: float
    k5: float
    k6: float


@kernel_record
@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentParams:
    """Parameters of the segmentation of stripe centres into straight segments."""

    image_width: int
    border_px: float
    """A segment that ends closer than this to the image's left or right border is clipped."""
    kink_px: float = 0.6
    """A piece is split where it deviates from its chord by more than this plus 1.5 sigmas of its centres."""
    joined_px: float = 0.5
    """Segments are joined if their lines differ by less than this plus two of their sigmas in the middle of the gap."""
    short_series: float = 1.25
    """Bias correction of the autocorrelations: fitting a line removes a part of those of a short series."""
    on_line_px: float = 2.5
    """A centre belongs to a line if it is closer than this; the nearest body behind a ring is 4 px away at 1 m."""
    min_columns: int = MIN_COLUMNS


SEGMENT_COLUMNS = column_names("Segment")
"""Columns of the result of `straight_segments` (stripe_segments.h); `before_start` and `after_end` count the
centres on the segment's line from 2 px to the segment's length (at most 100 px) + 40 px beyond either end."""

LASER, CENTERS, X_START, X_END = map(SEGMENT_COLUMNS.index, ("laser", "centers", "x_start", "x_end"))
MIDDLE_X, MIDDLE_Y, SLOPE = map(SEGMENT_COLUMNS.index, ("middle_x", "middle_y", "slope"))
SCATTER, CORRELATION = map(SEGMENT_COLUMNS.index, ("scatter", "correlation"))
CLIPPED = SEGMENT_COLUMNS.index("clipped")
BEFORE_START, AFTER_END = map(SEGMENT_COLUMNS.index, ("before_start", "after_end"))


@kernel_record
@dataclass(frozen=True, slots=True, kw_only=True)
class UnionParams:
    """Conditions under which segments on a common line are also tried as one merged segment."""

    min_beyond_ends: int = 5
    """Fewest centres on a segment's line beyond its ends; with fewer there is nothing to merge it with."""
    max_gap: float = 1.0
    """Longest gap, as a share of the length of both segments together."""
    separation_px: float = 1.0
    """Largest distance of the two lines in the middle of the gap, for facets,"""
    separation_sigmas: float
    """to which this many of its sigmas are added."""
    max_separation_px: float = 6.0
    """Limit of that distance, whatever the sigmas."""
    rounds: int = 2
    """Number of rounds of pairwise merging: up to four segments become one."""
    fit_dof: float = FIT_DOF_CORRECTION
    min_columns: float = MIN_SEGMENT_COLUMNS


NEAREST_M, FARTHEST_M = 0.05, 3.0
"""Range of the depth of a ring; wider at both ends than the working range of 0.2 to 1 m."""


@kernel_record
@dataclass(frozen=True, slots=True, kw_only=True)
class CandidateParams:
    """Which segments are candidates for the rim, and how they are ranked for each laser."""

    min_depth_m: float = NEAREST_M
    max_depth_m: float = FARTHEST_M
    typical_scatter_px: float = 0.3
    """Scatter of a stripe's centres about its line, on metal. The merit of a segment is 2 log(columns) -
    (scatter / typical_scatter)^2 / 2, less the penalty below, and `AGREEMENT` for each end that is cut off or covered
    and for a merged segment: merging also favours the body's stripes, which shadows and glints break."""
    max_counted_columns: int = 120
    """Columns beyond this number do not increase the merit: the longest segments are on the body."""
    spill_penalty: float = 15.0
    """Penalty if all centres on the line lie beyond the ends of the segment, where the face should end; proportional to
    their share."""
    adjacent_px: float = 8.0
    """Distance from an end within which another piece of the stripe belongs to it."""
    max_candidates: int = 20
    """Largest number of candidates for each laser."""


@kernel_record
@dataclass(frozen=True, slots=True, kw_only=True)
class RingParams:
    """Ring model that groups of segments are tested against; costs and penalties are chi-square / 2."""

    focal_x: float
    focal_y: float
    principal_x: float
    principal_y: float
    along_sigma_px: float = 2.0
    """Sigma of the distance of a segment's end from its circle, before refinement."""
    oblique_sigma_px: float = 6.0
    """The same where one stripe does not show at which angle it crosses the edges: one that is 2.5 px wide ends over 6
    px at 25 degrees."""
    across_sigma_px: float = 0.4
    """Sigma of the distance of a segment from the line in which the plane cuts the light plane: noise, calibration."""
    max_tilt_rad: float = math.radians(75)
    """Maximum tilt: beyond, a face is too oblique to show a stripe of usable length."""
    min_chord_ends: int = 7
    """Fewest own ends of stripes that cross both arcs of a ring: two circles about one centre have four unknowns, and a
    group on one arc has two ends more. With one less, a bracket beside an arc may be taken for the other arc."""
    agreement: float = AGREEMENT
    left_x: float = -math.inf
    """Ends to the left of this normalised x, ..."""
    right_x: float = math.inf
    """... to the right of this, ..."""
    top_y: float = -math.inf
    """... above this normalised y or ..."""
    bottom_y: float = math.inf
    """... below this are truncated by the image border and not used for the circles."""
