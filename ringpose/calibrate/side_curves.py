"""A marker's side as a parabola in the image: a lens bends it."""

from dataclasses import dataclass

import numpy as np

from ringpose.calibrate.normal_spread import normal_spread
from ringpose.types.arrays import Array, Float64

LARGEST_MARGIN = 0.1
"""Share of a side at its ends that is left out at most."""

MINIMUM_SAMPLES = 8

_OUTLIER_SIGMAS = 4.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Side:
    """A parabola: `start + t along + (c0 + c1 t + c2 t^2) normal`, t in pixels."""

    start: Float64[Array, "2"]
    along: Float64[Array, "2"]
    normal: Float64[Array, "2"]
    """Outwards: corners run clockwise."""
    length: float
    coefficients: Float64[Array, "3"]
    left_out: float = LARGEST_MARGIN
    """Share of the side that was left out at each of its ends."""

    def points(self, t: Float64[Array, "n"], across: Float64[Array, "*k n"]) -> Float64[Array, "*k n 2"]:
        """Points at t, so far outside the parabola."""
        offset = self.offset(t) + across
        points: Float64[Array, "*k n 2"] = self.start + t[:, None] * self.along + offset[..., None] * self.normal
        return points

    def offset(self, t: Float64[Array, "n"]) -> Float64[Array, "n"]:
        """How far outside the chord the parabola is."""
        offset: Float64[Array, "n"] = np.polynomial.polynomial.polyval(t, self.coefficients)
        return offset

    def slope(self, t: Float64[Array, "n"]) -> Float64[Array, "n"]:
        """Of the parabola to its chord."""
        slope: Float64[Array, "n"] = self.coefficients[1] + 2 * self.coefficients[2] * t
        return slope

    def tangent(self, t: float) -> tuple[Float64[Array, "2"], Float64[Array, "2"]]:
        """Point and direction at t."""
        place = np.array([t])
        return self.points(place, np.zeros(1))[0], self.along + self.slope(place)[0] * self.normal


def straight_side(start: Float64[Array, "2"], end: Float64[Array, "2"]) -> Side:
    """The chord between two corners."""
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    normal = np.array([along[1], -along[0]])
    return Side(start=start, along=along, normal=normal, length=length, coefficients=np.zeros(3))


def robust_parabola(t: Float64[Array, "n"], offset: Float64[Array, "n"]) -> Float64[Array, "3"] | None:
    """Coefficients, strays and NaN left out; None where too few are left."""
    used = np.isfinite(offset)
    coefficients = None
    for _ in range(3):
        if used.sum() < MINIMUM_SAMPLES:
            return None
        coefficients = np.polynomial.polynomial.polyfit(t[used], offset[used], 2)
        residual = offset - np.polynomial.polynomial.polyval(t, coefficients)
        limit = max(_OUTLIER_SIGMAS * normal_spread(residual[used]), 1e-6)
        used = np.isfinite(offset) & (np.abs(np.nan_to_num(residual, nan=np.inf)) < limit)
    return coefficients


def meeting_point(before: Side, after: Side, corner: Float64[Array, "2"]) -> Float64[Array, "2"]:
    """Where the side that ends in a corner meets the side that starts there: tangents, re-drawn at the meeting."""
    t_before, t_after = before.length, 0.0
    meeting = corner
    for _ in range(3):
        first, along = before.tangent(t_before)
        second, away = after.tangent(t_after)
        system = np.stack([along, -away], axis=1)
        if abs(np.linalg.det(system)) < 1e-6:
            return corner
        step = np.linalg.solve(system, second - first)
        meeting = first + step[0] * along
        t_before, t_after = t_before + step[0], t_after + step[1]
    return meeting
