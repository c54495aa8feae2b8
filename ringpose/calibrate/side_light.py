"""Dark and bright beside a marker's sides, which a share of the rise between them is told by."""

from typing import NamedTuple

import cv2
import numpy as np

from ringpose.calibrate.normal_spread import normal_spread
from ringpose.calibrate.side_curves import LARGEST_MARGIN, Side, straight_side
from ringpose.types.arrays import Array, Float64, UInt8

REACH_PX = 5.0
"""How far across a side is looked for the edge, and at most half a cell of the marker's black border ..."""

LARGEST_REACH_PX = 8.0
"""... and how far where the edge is so blurred that less tells neither dark nor bright."""

CELLS = 6
"""Cells across the smallest dictionaries' markers, border included; a border cell is no larger than this share."""

_FLANK = 0.65
"""Of the reach: middle of what is taken for dark, and for bright."""

_UNEVEN = 0.1
"""Share of the contrast by which flanks may miss a plane."""

_OUTLIER_SIGMAS = 4.0


class Light(NamedTuple):
    """How brightness changes over a marker, in grey levels per pixel."""

    dark: Float64[Array, "xy=2"]
    """Within its border."""
    bright: Float64[Array, "xy=2"]
    """On the paper around it."""


def marker_light(image: UInt8[Array, "row column"], corners: Float64[Array, "corner=4 xy=2"]) -> Light:
    """By the flanks of the four sides: those of one side are too narrow to tell a slope.

    Where the light falls by a two-thousandth a pixel, a level taken 3 px from the edge draws the edge 0.002 px aside,
    the same way all over the image.
    """
    sides = [straight_side(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    reach = reach_px(min(side.length for side in sides))
    flanks = np.array([[_flank(image, side, end * _FLANK * reach) for end in (-1.0, 1.0)] for side in sides])
    middles = (corners + np.roll(corners, -1, axis=0)) / 2
    design = np.column_stack([np.ones(4), middles - middles.mean(axis=0)])
    planes = np.linalg.lstsq(design, flanks)[0]
    uneven = np.abs(design @ planes - flanks).max(axis=0) > _UNEVEN * np.ptp(planes[0])
    dark, bright = np.where(uneven, 0.0, planes[1:]).T
    return Light(dark=dark, bright=bright)


def reach_px(length: float, farthest_px: float = REACH_PX) -> float:
    """How far across a side of this length is looked."""
    return min(farthest_px, 0.5 * length / CELLS)


def smooth_level(t: Float64[Array, "n"], grey: Float64[Array, "n"]) -> Float64[Array, "n"]:
    """Grey along one flank of the edge: light falls off smoothly, and what lies in front of the board is cut out."""
    used = np.ones(len(t), dtype=bool)
    run = t / np.abs(t).max()
    for _ in range(3):
        line = np.polynomial.polynomial.polyfit(run[used], grey[used], 2)
        residual = np.abs(grey - np.polynomial.polynomial.polyval(run, line))
        used = residual <= max(_OUTLIER_SIGMAS * normal_spread(residual), 1e-6)
    level: Float64[Array, "n"] = np.polynomial.polynomial.polyval(run, line)
    return level


def _flank(image: UInt8[Array, "row column"], side: Side, across: float) -> float:
    """Grey beside a side, so far outside it: the median, as something may lie in front of the board."""
    t = np.linspace(LARGEST_MARGIN, 1.0 - LARGEST_MARGIN, int(side.length)) * side.length
    places = side.points(t, np.full(len(t), across)).astype(np.float32)
    grey = cv2.remap(image, places[None, :, 0], places[None, :, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return float(np.median(np.asarray(grey, dtype=np.float64)))
