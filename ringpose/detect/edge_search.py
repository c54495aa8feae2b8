"""The steps of brightness beside predicted places of the ring's edges, as evidence for the ring."""

from dataclasses import dataclass

import cv2
import numpy as np

from ringpose.detect.edge_steps import EdgeSteps, edge_profiles, edge_steps
from ringpose.detect.edge_trace import EdgeTrace, chosen, sights_at
from ringpose.kernels.edges import Sights
from ringpose.types.arrays import Array, Bool, Float64, UInt, UInt8

BLUR_PX = 0.9
"""Blur (sigma) of edges that is assumed as long as nothing better is known."""

STEP_SIGMA_PX = 0.5
"""A step that is known worse than this is none."""

STEP_SIGMAS = 5.0
"""Nor is one whose height is less than this many of its standard deviations: one of many places fits noise well."""

STEP_DN = 2.0
"""Nor is one of fewer grey values: rounding to whole ones moves it."""

CLUTTER = 2.5
"""Steps are trusted as if their sigmas were so many times larger: what lies beyond the edge is no even ground."""

LEAST_SIGMA_PX = 0.1
"""No single step is trusted more than this."""

CELL_PX, CELLS = 4, 2
"""Places up to so many cells of an image's grid from a stripe's centre are left out: 8 to 12 px."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeImage:
    """A frame in which the ring's edges are looked for."""

    image: UInt[Array, "row column"]
    saturation_dn: int
    lit: UInt8[Array, "cell_row cell_column"] | None = None
    """Not 0 in the cells of its grid that are beside a stripe; None for a frame without lasers."""


def lit_cells(
    stripes_px: Float64[Array, "center xy=2"], image: UInt[Array, "row column"]
) -> UInt8[Array, "cell_row cell_column"]:
    """Which cells of the image are beside one of the stripes' centres."""
    lit = np.zeros((image.shape[0] // CELL_PX + 1, image.shape[1] // CELL_PX + 1), dtype=np.uint8)
    column, row = (stripes_px / CELL_PX).astype(np.int64).T
    lit[row, column] = 1
    dilated: UInt8[Array, "cell_row cell_column"] = cv2.dilate(lit, np.ones((2 * CELLS + 1, 2 * CELLS + 1), np.uint8))
    return dilated


def clear_of_stripes(frame: EdgeImage, trace: EdgeTrace) -> EdgeTrace:
    """The places without those beside a stripe."""
    if frame.lit is None:
        return trace
    column, row = (trace.place_px / CELL_PX).astype(np.int64).T
    return chosen(trace, frame.lit[row, column] == 0)


def steps_beside(frame: EdgeImage, trace: EdgeTrace, reach_px: int) -> EdgeSteps:
    """The steps within `reach_px` of the places of a trace, for want of better taken as blurred by `BLUR_PX`."""
    profiles = edge_profiles(frame.image, trace.place_px, trace.normal, reach_px, frame.saturation_dn)
    return edge_steps(profiles, reach_px, BLUR_PX)


def clear_steps(steps: EdgeSteps) -> Bool[Array, "n"]:
    """Which steps are more than noise."""
    known = np.isfinite(steps.offset_px) & (steps.sigma_px < STEP_SIGMA_PX)
    return known & (steps.height > STEP_SIGMAS) & (steps.height_dn > STEP_DN)


def step_sights(trace: EdgeTrace, steps: EdgeSteps) -> Sights:
    """The clear ones among the steps as evidence for the ring."""
    clear = clear_steps(steps)
    sigma_px = CLUTTER * np.hypot(steps.sigma_px[clear], LEAST_SIGMA_PX)
    return sights_at(chosen(trace, clear), steps.offset_px[clear], sigma_px)
