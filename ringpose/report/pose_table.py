"""Pose lines and track lines as rows of a table for a person at a terminal."""

import math
import textwrap

import numpy as np

from ringpose.estimate.covariance import standard_deviation
from ringpose.types.arrays import Array, Float64
from ringpose.types.pose import HARMLESS_FLAGS, PoseLine, RingPose, names_of
from ringpose.types.track import TrackLine

WIDTH = 80
"""Columns of a terminal on which a row still fits."""

SHOT_WIDTH = 18

NUMBER_WIDTHS = (8, 8, 8, 6, 8, 8, 6)

NUMBERS = ("x", "y", "z", "+-", "pitch", "yaw", "+-")

HEADINGS = f"{'shot':{SHOT_WIDTH}} {'status':8}" + "".join(
    f"{name:>{width}}" for name, width in zip(NUMBERS, NUMBER_WIDTHS, strict=True)
)

MOST_DECIMALS_MM, MOST_DECIMALS_DEG = 2, 3
"""Finer than any rig measures."""


class PoseTable:
    """Rows of lines as they come, below a heading."""

    def __init__(self) -> None:
        self._is_begun = False

    def text(self, line: PoseLine | TrackLine) -> str:
        """The row of a line, in the frame of its vectors, and what degrades it in further rows; first the heading."""
        above = f"{f'grasp point in mm, {line.frame} frame':>{SHOT_WIDTH + 39}}{'normal in degrees':>22}"
        heading = () if self._is_begun else (above, HEADINGS)
        self._is_begun = True
        shot = line.shot if isinstance(line, PoseLine) else line.attempt.shot
        if len(shot) > SHOT_WIDTH:
            shot = f"{shot[: SHOT_WIDTH - 3]}..."
        cells = [] if line.pose is None else numbers_of(line.pose)
        numbers = "".join(f"{cell:>{width}}" for cell, width in zip(cells, NUMBER_WIDTHS, strict=False))
        row = f"{shot:{SHOT_WIDTH}} {line.status:8}{numbers}".rstrip()
        further = textwrap.wrap(limits_of(line), WIDTH, initial_indent="    ", subsequent_indent="    ")
        return "".join(f"{each}\n" for each in (*heading, row, *further))


def numbers_of(pose: RingPose) -> list[str]:
    """The grasp point in millimetres, pitch and yaw in degrees, each with the largest standard deviation.

    They have the digits that the standard deviations justify.
    """
    tilts = None if pose.covariance is None else pose.covariance[:2, :2]
    grasp_mm, sigma_mm = 1e3 * pose.grasp_m, 1e3 * _sigma(pose.covariance_grasp_m2)
    angles_deg, sigma_deg = np.degrees([pose.pitch_rad, pose.yaw_rad]), math.degrees(_sigma(tilts))
    return [*_numbers(grasp_mm, sigma_mm, MOST_DECIMALS_MM), *_numbers(angles_deg, sigma_deg, MOST_DECIMALS_DEG)]


def limits_of(line: PoseLine | TrackLine) -> str:
    """What degrades a pose, or why there is none."""
    flags = "" if line.pose is None else ", ".join(names_of(line.flags & ~HARMLESS_FLAGS))
    return "; ".join(filter(None, [flags, line.reason]))


def _sigma(covariance: Float64[Array, "n n"] | None) -> float:
    return math.nan if covariance is None or not np.isfinite(covariance).all() else standard_deviation(covariance)


def _numbers(values: Float64[Array, "n"], sigma: float, most: int) -> list[str]:
    """The values and their standard deviation with the digits that it justifies: two of its own."""
    decimals = min(max(1 - math.floor(math.log10(sigma)), 0), most) if sigma > 0 else most
    return [f"{value:.{decimals}f}" if math.isfinite(value) else "-" for value in (*values.tolist(), sigma)]
