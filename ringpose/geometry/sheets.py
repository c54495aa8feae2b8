"""Sheets of light: planes, or surfaces that are bent in one direction (ringpose-method(7), section 6).

A lens that spreads a laser beam into a fan may bend it. Its rays still start at the projector, and rise over the plane
with the square of the angle a from the direction in the plane that is nearest to the optical axis. At the range r from
the projector (both within the plane):

    (6.1) n . P = d + h(P),  h = b r a^2,  b the bow per radian

A bent sheet is as good as its tangent plane where it is measured, from which it deviates by the square of the distance.
Estimation and detection therefore take a plane of its own for each measurement (`light_planes`). A straight line fitted
to a bent stripe has two points in common with it, where their distances from the middle are 1 / sqrt(12) of the length
(`line_planes`).
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ringpose.geometry.rays import intersect
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.rig import Rig

BEND_STEPS = 6
"""Corrections of a light plane by the bend of its sheet; each is at most a tenth of the one before."""


class Bends(NamedTuple):
    """The bends of sheets of light over their planes."""

    per_rad: Float64[Array, "*#shape"]
    projector_m: Float64[Array, "*#shape xyz=3"]
    """Where the rays start; the camera's centre if that is not known."""
    axis: Float64[Array, "*#shape xyz=3"]
    """Direction in the plane that is nearest to the optical axis, a unit vector ..."""
    aside: Float64[Array, "*#shape xyz=3"]
    """... and the one in the plane across it."""

    def of(self, laser: Int64[Array, "*shape"] | int) -> "Bends":
        """Those of the lasers with these numbers."""
        return Bends(*(values[laser] for values in self))

    def height_m(self, points: Float64[Array, "*shape xyz=3"]) -> Float64[Array, "*shape"]:
        """Elevation h of the sheets over their planes, at points of them."""
        height: Float64[Array, "*shape"] = self.per_rad * self._unit_height_m(points)
        return height

    def gradient(self, points: Float64[Array, "*shape xyz=3"]) -> Float64[Array, "*shape xyz=3"]:
        """Derivative of h by the point."""
        by_aside, by_axis = self._unit_slopes(points)
        unit = by_aside[..., None] * self.aside + by_axis[..., None] * self.axis
        gradient: Float64[Array, "*shape xyz=3"] = self.per_rad[..., None] * unit
        return gradient

    def wrt_parameters(self, points: Float64[Array, "*shape xyz=3"]) -> Float64[Array, "*shape parameter=3"]:
        """Derivatives of h by `BOW_PARAMETERS`: the bow, and the projector's position aside and along the axis."""
        by_aside, by_axis = self._unit_slopes(points)
        return np.stack([self._unit_height_m(points), -self.per_rad * by_aside, -self.per_rad * by_axis], axis=-1)

    @property
    def parameters(self) -> Float64[Array, "*shape parameter=3"]:
        """Their `BOW_PARAMETERS`."""
        place = [(self.projector_m * each).sum(axis=-1) for each in (self.aside, self.axis)]
        return np.stack([self.per_rad, *place], axis=-1)

    def _in_plane(self, points: Float64[Array, "*shape xyz=3"]) -> tuple[Array, Array]:
        """Distances from the projector aside and along the axis."""
        from_projector = points - self.projector_m
        return (from_projector * self.aside).sum(axis=-1), (from_projector * self.axis).sum(axis=-1)

    def _unit_height_m(self, points: Float64[Array, "*shape xyz=3"]) -> Float64[Array, "*shape"]:
        aside, along = self._in_plane(points)
        height: Float64[Array, "*shape"] = np.hypot(along, aside) * np.arctan2(aside, along) ** 2
        return height

    def _unit_slopes(self, points: Float64[Array, "*shape xyz=3"]) -> tuple[Array, Array]:
        """Derivatives of r a^2 aside and along the axis."""
        aside, along = self._in_plane(points)
        angle = np.arctan2(aside, along)
        sine, cosine = np.sin(angle), np.cos(angle)
        return angle * (angle * sine + 2.0 * cosine), angle * (angle * cosine - 2.0 * sine)


def bends(
    normal: Float64[Array, "laser xyz=3"], per_rad: Float64[Array, "laser"], projector_m: Float64[Array, "laser xyz=3"]
) -> Bends:
    """The bends over planes with these normals; projectors that are not known (NaN) count as the camera's centre."""
    axis = np.array([0.0, 0.0, 1.0]) - normal[:, 2:] * normal
    axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    return Bends(per_rad, np.where(np.isfinite(projector_m), projector_m, 0.0), axis, np.cross(normal, axis))


def bends_in_planes(normal: Float64[Array, "laser xyz=3"], bow: Float64[Array, "laser parameter=3"]) -> Bends:
    """The bends by their `BOW_PARAMETERS`."""
    flat = bends(normal, bow[:, 0], np.zeros_like(normal))
    return flat._replace(projector_m=bow[:, 1:2] * flat.aside + bow[:, 2:] * flat.axis)


@lru_cache(maxsize=8)
def bends_of(rig: Rig) -> Bends | None:
    """The bends of a rig's sheets, by laser; None if all of them are flat."""
    if not rig.bows:
        return None
    per_rad = [rig.bows[name].per_rad if name in rig.bows else 0.0 for name in rig.lasers.names]
    return bends(rig.lasers.normal, np.array(per_rad), rig.lasers.projector_m)


def sheet_points(
    directions: Float64[Array, "*shape xyz=3"], laser: Int64[Array, "*#shape"], rig: Rig
) -> Float64[Array, "*shape xyz=3"]:
    """Intersections of rays from the camera's centre with the sheets of their lasers; NaN where there is none."""
    normal, distance_m = rig.lasers.normal[laser], rig.lasers.distance_m[laser]
    points = intersect(directions, normal, distance_m)
    bent = bends_of(rig)
    if bent is not None:
        own = bent.of(laser)
        for _ in range(BEND_STEPS):
            points = intersect(directions, normal, distance_m + own.height_m(points))
    return points


def light_planes(
    directions: Float64[Array, "n xyz=3"], laser: Int64[Array, "n"], rig: Rig
) -> tuple[Float64[Array, "n xyz=3"], Float64[Array, "n"]]:
    """Normals m and distances d of the planes m . P = d that the sheets are where rays meet them.

    Of a bent sheet it is the tangent plane. Its m is the gradient of n . P - h (not a unit vector), so that derivatives
    by the parameters of the plane are those of the sheet. A ray that does not meet a bent sheet has the flat plane.
    """
    normal, distance_m, bent = rig.lasers.normal[laser], rig.lasers.distance_m[laser], bends_of(rig)
    if bent is None:
        return normal, distance_m
    points = sheet_points(directions, laser, rig)
    met = np.isfinite(points[:, 0])
    tangent = normal - bent.of(laser).gradient(points)
    return np.where(met[:, None], tangent, normal), np.where(met, (tangent * points).sum(axis=1), distance_m)


def line_planes(
    ends: Float64[Array, "line end=2 xyz=3"], laser: Int64[Array, "line"], rig: Rig
) -> tuple[Float64[Array, "line xyz=3"], Float64[Array, "line"], Float64[Array, "line end=2 parameter=3"]]:
    """Normals and distances of planes m . P = d whose stripes are the straight lines fitted to bent stripes.

    `ends` are the rays of the ends of fitted lines. The plane has the direction of the sheet in the middle, and the
    sheet's mean distance in the two points that a parabola and the straight line fitted to it have in common. Also the
    derivatives of the elevation of the line's ends by `BOW_PARAMETERS`, from those of these two points. NaN where the
    rays do not meet the sheet.
    """
    bent = bends_of(rig)
    assert bent is not None
    middle, half = ends.mean(axis=1), 0.5 * (ends[:, 1] - ends[:, 0])
    common = middle[:, None] + half[:, None] * (np.array([[-1.0], [1.0]]) / np.sqrt(3.0))
    normal = light_normals(sheet_points(middle, laser, rig), laser, rig)
    points = sheet_points(common, laser[:, None], rig)
    distance_m: Float64[Array, "line"] = (points @ normal[:, :, None])[..., 0].mean(axis=1)
    by_bow = bent.of(laser[:, None]).wrt_parameters(points)
    mean, slope = by_bow.mean(axis=1, keepdims=True), 0.5 * np.sqrt(3.0) * (by_bow[:, 1:] - by_bow[:, :1])
    return normal, distance_m, np.concatenate([mean - slope, mean + slope], axis=1)


def light_normals(points: Float64[Array, "n xyz=3"], laser: Int64[Array, "n"], rig: Rig) -> Float64[Array, "n xyz=3"]:
    """Normals of the sheets at points on them, as those of `light_planes`."""
    normal: Float64[Array, "n xyz=3"] = rig.lasers.normal[laser]
    bent = bends_of(rig)
    return normal if bent is None else normal - bent.of(laser).gradient(points)
