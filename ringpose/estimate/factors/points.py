"""Break points, measured by their abscissae."""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from ringpose.estimate.factors.lines import Lines, stamps_of
from ringpose.estimate.linearization import MIN_SIGMA_PX, Derivatives, ImageFactor, Index
from ringpose.geometry.rays import rays_wrt_pixel_and_camera, undistort
from ringpose.geometry.ring import MIN_RATE, RingPrediction
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.detection import BreakPointFlag, BreakPoints
from ringpose.types.rig import Camera


@dataclass(frozen=True, kw_only=True, eq=False)
class PointFactor(ImageFactor):
    """Break points. One whose stripe has no line has a second row, for its ordinate."""

    robust: ClassVar[bool] = True

    sigma_x: Float64[Array, "point"]
    y: Float64[Array, "point"]
    covariance: Float64[Array, "point xy=2 xy=2"]
    isolated: Int64[Array, "isolated"]
    """The points without a line."""

    def of_points(self, samples: Float64[Array, "sample *axis"]) -> Float64[Array, "point *axis"]:
        """The points' part of values by sample of a stripe, which is the last; there may be no points."""
        return samples[len(samples) - len(self.sigma_x) :]

    def rate(self, at: RingPrediction) -> Float64[Array, "point"]:
        """Derivative of the distance from the edge along the predicted line."""
        wrt_ray = at.edges.wrt_ray[: len(self.sigma_x)]
        rate = wrt_ray[:, 0] + self.of_points(at.stripes.slope) * wrt_ray[:, 1]
        return np.where(np.abs(rate) < MIN_RATE, MIN_RATE, rate)

    def scale(self, at: RingPrediction) -> Float64[Array, "point"]:
        """1 / standard deviation of the distance from the edge."""
        scale: Float64[Array, "point"] = 1.0 / (np.abs(self.rate(at)) * self.sigma_x)
        return scale

    def residuals(self, at: RingPrediction) -> tuple[Float64[Array, "row"], Derivatives]:
        """Eq. (5.5): the distance (5.2) of the predicted line at the measured abscissa."""
        count, scale = len(self.sigma_x), self.scale(at)
        distance_m, wrt_y = at.edges.distance_m[:count], at.edges.wrt_ray[:count, 1]
        residual, along = scale * distance_m, ((scale * wrt_y)[:, None], scale[:, None])
        if not len(self.isolated):
            return residual, Derivatives(*along)
        # the height above the predicted line, less what the error of the abscissa leads to expect
        which, (share, scale_y) = self.isolated, self.ordinate_weights(at)
        height = (self.y - self.of_points(at.stripes.rays)[:, 1])[which]
        across = (-scale_y * (1.0 + share * wrt_y[which]))[:, None], (-scale_y * share)[:, None]
        residual = np.concatenate([residual, scale_y * (height - share * distance_m[which])])
        return residual, Derivatives(*[np.concatenate(both) for both in zip(along, across, strict=True)])

    def wrt_ray(self, at: RingPrediction) -> Float64[Array, "row xy=2"]:
        """A displacement along the predicted line changes the distance, one across it the height."""
        rate, which, (share, scale_y) = self.rate(at), self.isolated, self.ordinate_weights(at)
        slope = self.of_points(at.stripes.slope)[which]
        by_x = np.concatenate([self.scale(at) * rate, -scale_y * (slope + share * rate[which])])
        return np.stack([by_x, np.concatenate([np.zeros(len(rate)), scale_y])], axis=1)

    def ordinate_weights(self, at: RingPrediction) -> tuple[Float64[Array, "isolated"], Float64[Array, "isolated"]]:
        """Share and scale of the residuals (y - y(x) - share * distance) * scale of points without a line.

        The height of such a point above the predicted line is correlated with the error of its abscissa. The
        coefficient of the regression on the abscissa is `share`; the remainder is independent of the abscissa and has
        the standard deviation 1 / scale.
        """
        which = self.isolated
        covariance, slope = self.covariance[which], self.of_points(at.stripes.slope)[which]
        xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
        cross_covariance = xy - slope * xx
        remainder = yy - 2.0 * slope * xy + slope**2 * xx - cross_covariance**2 / xx
        return cross_covariance / xx / self.rate(at)[which], 1.0 / np.sqrt(np.maximum(remainder, 1e-12 * xx))


class Points(NamedTuple):
    """Break points."""

    laser: Int64[Array, "point"]
    edge: Int64[Array, "point"]
    x: Float64[Array, "point"]
    y: Float64[Array, "point"]
    covariance: Float64[Array, "point xy=2 xy=2"]
    sigma_x: Float64[Array, "point"]
    middle_x: Float64[Array, "point"]
    """Abscissa of the middle of the point's stripe."""
    isolated: Bool[Array, "point"]
    """Whether its stripe has no line, so that the ordinate of the point is used too."""
    stamp_s: Float64[Array, "point"]
    """Mid exposure of the stripe's frame; NaN if unknown."""
    beside_occluder: Bool[Array, "point"]
    """Whether the image shows a surface in front of the ring beside the point."""
    wrt_camera: Float64[Array, "point xy=2 parameter"]
    """Derivatives of x and y for fixed pixels by the camera's parameters, as in `CAMERA_PARAMETERS`."""
    opposite: Bool[Array, "point"]
    """Whether the point lies on the arc opposite to that at which the ring is described."""

    @property
    def ends(self) -> Int64[Array, "point"]:
        """A number for each end of a stripe, the same where it was measured again."""
        numbers: Int64[Array, "point"] = 4 * self.laser + 2 * self.opposite + self.edge
        return numbers

    @property
    def numbers(self) -> int:
        """Number of measured values; an end that was measured twice counts once."""
        return len(set(self.ends.tolist())) + len(set(self.ends[self.isolated].tolist()))

    @property
    def described(self) -> Bool[Array, "point"]:
        """Whether the point is on the arc at which the ring is described: the opposite one if nothing else is seen."""
        return np.ones_like(self.opposite) if self.opposite.all() else ~self.opposite

    def factor(self, ends: int) -> PointFactor:
        """Their factor; their rays come after so many of ends of lines."""
        isolated, count = np.flatnonzero(self.isolated), len(self.x)
        row: Index = slice(0, count)
        ray: Index = slice(ends, ends + count)
        if len(isolated):
            row = np.concatenate([np.arange(count), isolated])
            ray = ends + row
        return PointFactor(
            stamp_s=self.stamp_s[row],
            opposite=self.opposite[row],
            ray=ray,
            beside=row,
            edge=self.edge[row],
            sigma_x=self.sigma_x,
            y=self.y,
            covariance=self.covariance,
            isolated=isolated,
        )


NOMINAL_SIGMA_PX = 0.3
"""Sigma of a break point without a covariance; it only weights points against each other and is not reported."""


def points_of(
    break_points: BreakPoints, lines: Lines, camera: Camera, *, opposite: bool = False
) -> tuple[Points, bool]:
    """The break points that were seen, and whether all of these have a covariance."""
    laser, edge = np.nonzero(~np.isnan(break_points.position_px[..., 0]))
    xy = undistort(break_points.position_px[laser, edge], camera)
    wrt_pixel, wrt_camera = rays_wrt_pixel_and_camera(xy, camera)
    covariance_px2 = break_points.covariance_px2[laser, edge]
    has_covariance = np.isfinite(covariance_px2).all(axis=(1, 2))
    covariance_px2[~has_covariance] = NOMINAL_SIGMA_PX**2 * np.eye(2)
    covariance_px2 = covariance_px2 + MIN_SIGMA_PX**2 * np.eye(2)
    covariance = wrt_pixel @ covariance_px2 @ wrt_pixel.swapaxes(1, 2)
    has_line = np.zeros(len(break_points.flags), dtype=bool)
    has_line[lines.laser] = True
    points = Points(
        laser=laser,
        edge=edge,
        x=xy[:, 0],
        y=xy[:, 1],
        covariance=covariance,
        sigma_x=np.sqrt(covariance[:, 0, 0]),
        middle_x=_middles(laser, xy[:, 0], lines),
        isolated=~has_line[laser],
        stamp_s=stamps_of(break_points)[laser],
        beside_occluder=break_points.flags[laser, edge] & int(BreakPointFlag.BESIDE_OCCLUDER) != 0,
        wrt_camera=wrt_camera,
        opposite=np.full(len(laser), opposite),
    )
    return points, bool(has_covariance.all())


def _middles(laser: Int64[Array, "point"], x: Float64[Array, "point"], lines: Lines) -> Float64[Array, "point"]:
    """Abscissa of the middle of each point's stripe: of its line, or else of its break points."""
    middle = {number: sum(ends) / 2 for number, ends in zip(lines.laser.tolist(), lines.x.tolist(), strict=True)}
    for number in set(laser.tolist()) - middle.keys():
        middle[number] = float(x[laser == number].mean())
    return np.array([middle[number] for number in laser.tolist()], dtype=np.float64)
