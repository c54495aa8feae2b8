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

HEADINGS = f"{'shot':{SHOT_WIDTH}} {'status':8}{'x':>8}{'y':>8}{'z':>8}{'+-':>6}{'pitch':>8}{'yaw':>8}{'+-':>6}"

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
        numbers = "" if line.pose is None else f"{_grasp_point(line.pose)}{_normal(line.pose)}"
        row = f"{shot:{SHOT_WIDTH}} {line.status:8}{numbers}".rstrip()
        flags = "" if line.pose is None else ", ".join(names_of(line.flags & ~HARMLESS_FLAGS))
        limits = "; ".join(filter(None, [flags, line.reason]))
        further = textwrap.wrap(limits, WIDTH, initial_indent="    ", subsequent_indent="    ")
        return "".join(f"{each}\n" for each in (*heading, row, *further))


def _grasp_point(pose: RingPose) -> str:
    """Millimetres, and the largest standard deviation."""
    return _numbers(1e3 * pose.grasp_m, 1e3 * _sigma(pose.covariance_grasp_m2), 8, MOST_DECIMALS_MM)


def _normal(pose: RingPose) -> str:
    """Pitch and yaw in degrees, and the largest standard deviation of the normal."""
    tilts = None if pose.covariance is None else pose.covariance[:2, :2]
    return _numbers(np.degrees([pose.pitch_rad, pose.yaw_rad]), math.degrees(_sigma(tilts)), 8, MOST_DECIMALS_DEG)


def _sigma(covariance: Float64[Array, "n n"] | None) -> float:
    return math.nan if covariance is None or not np.isfinite(covariance).all() else standard_deviation(covariance)


def _numbers(values: Float64[Array, "n"], sigma: float, width: int, most: int) -> str:
    """The values and their standard deviation with the digits that it justifies: two of its own."""
    decimals = min(max(1 - math.floor(math.log10(sigma)), 0), most) if sigma > 0 else most
    shown = [f"{value:{width}.{decimals}f}" if math.isfinite(value) else f"{'-':>{width}}" for value in values.tolist()]
    return "".join(shown) + (f"{sigma:6.{decimals}f}" if math.isfinite(sigma) else f"{'-':>6}")
