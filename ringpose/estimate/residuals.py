"""Residuals of one shot with respect to the ring and their Jacobian (ringpose-method(7), section 5).

All residuals are in units of their standard deviations, in this order: the lines of the stripes (residual a), the
break points along their lines (b), the ordinates of break points without a line, the visible edges (c), and the prior
(d). The ring is described by `ringpose.geometry.ring`.
"""

from dataclasses import replace
from math import isfinite
from typing import NamedTuple

import numpy as np

from ringpose.estimate.measurements import Measurements, Observations, Points
from ringpose.geometry.ring import (
    CURVATURE,
    EDGE_SIGN,
    HALF_BAND,
    MIN_RATE,
    STEP,
    TILT_ALONG,
    TILT_INWARD,
    TURN,
    EdgeDistances,
    Rates,
    RingArcs,
    StripePrediction,
    motion_derivatives,
    predicted_view,
)
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.assumptions import Assumptions, MotionPrior
from ringpose.types.rig import LaserPlanes
from ringpose.types.ring import KnownRadii

PARAMETERS = len(STEP)

EXPECTED_CURVATURE, CURVATURE_SD = 1.5, 1.5
"""Weak prior in 1/m (a radius of 0.3 m has 3.3; the largest ring in launcher manuals has 0.76)."""

TURN_SD_RAD = 0.5
"""Weak prior on the angle between the stripes and the radius, if a single stripe has to determine it."""

TILT_SD_RAD = 0.6
"""Weak prior on the angle between the ring's normal and the optical axis, if a single stripe leaves it open."""

EXPECTED_HALF_BAND_M, HALF_BAND_SD_M = 0.015, 0.015
"""Prior on half the width of the face if only one edge was seen: faces in launcher manuals are 0.03 m wide."""


MIN_DEPTH_M, MAX_DEPTH_M = 1e-3, 1e3
"""Bounds of the plane's distance; beyond them the iteration has diverged."""

MAX_CURVATURE = 20.0
"""Bound in 1/m; beyond it the iteration has diverged."""

MAX_TILT_RAD = 0.7
"""Largest tilt in one iteration."""

STILL = Rates(np.zeros(3), np.zeros(3))


class Prior(NamedTuple):
    """What is known about the ring before the measurement."""

    radii: KnownRadii | None = None
    assumptions: Assumptions = Assumptions()
    """On motion, the ring's form and the rig."""
    regularize_about: RingArcs | None = None
    """The ring about which curvature, turn and tilt have weak priors; None to estimate from the shot alone."""
    single_edge: bool = False
    """Whether only one edge was seen, so that the width of the face needs a prior."""


class OrdinateScale(NamedTuple):
    """Weights of the ordinates of isolated break points: residual (y - y(x) - share * distance) * scale."""

    which: Int64[Array, "isolated"]
    share: Float64[Array, "isolated"]
    scale: Float64[Array, "isolated"]


class Residuals(NamedTuple):
    """The whitened residuals, their Jacobian, and the predictions that the nuisance parameters need."""

    arcs: RingArcs
    """The ring at the reference time ..."""
    rates: Rates
    """... and its motion, at which they are linearised."""
    rate_sds: Float64[Array, "rate"]
    """Standard deviations of the rates by their prior; empty if the ring is still or all rows are of one instant."""
    residual: Float64[Array, "row"]
    jacobian: Float64[Array, "row step=7"]
    ends: int
    """Number of the lines' ends: their residuals and predictions come before those of the break points."""
    data_rows: int
    """Number of residuals before those of the prior."""
    stripes: StripePrediction
    points: EdgeDistances
    """Of the break points from their edges."""
    edges: EdgeDistances
    """Of the visible edge points from their edges."""
    edge_scale: Float64[Array, "visible"]
    """1 / standard deviation of their distances."""
    distance_wrt_x: Float64[Array, "point"]
    """Derivative of a break point's distance from its edge along the predicted line."""
    distance_scale: Float64[Array, "point"]
    """1 / standard deviation of that distance."""
    ordinates: OrdinateScale
    wrt_rates: Float64[Array, "row rate"]
    """Derivatives by the rates: velocity of the ring's centre, and angular velocities about its inward axis and about
    the axis along its face. No columns for a still ring."""
    wrt_camera: Float64[Array, "row error"]
    """Derivatives by the errors of the camera's motion; no columns for a camera at rest."""
    y_wrt_rates: Float64[Array, "sample rate"]
    """Derivatives of the predicted ordinates by the rates."""
    y_wrt_camera: Float64[Array, "sample error"]

    @property
    def stripe_rows(self) -> int:
        """Number of residuals of stripes and break points, which come before those of visible edges."""
        return self.data_rows - len(self.edge_scale)

    @property
    def rate_deviations(self) -> Float64[Array, "rate"]:
        """The rates in standard deviations of their prior."""
        if not len(self.rate_sds):
            return self.rate_sds
        values = np.concatenate([self.rates.velocity_m_s, self.arcs.axes[:2] @ self.rates.rate_rad_s])
        deviations: Float64[Array, "rate"] = values / np.maximum(self.rate_sds, np.finfo(float).tiny)
        return deviations

    @property
    def slope(self) -> Float64[Array, "point"]:
        """Of the predicted lines at the break points."""
        return self.stripes.slope[self.ends :]

    @property
    def y(self) -> Float64[Array, "point"]:
        """Predicted ordinates of the break points."""
        return self.stripes.rays[self.ends :, 1]


def ring_residuals(
    arcs: RingArcs, measured: Measurements, observations: Observations, prior: Prior, rates: Rates = STILL
) -> Residuals:
    """The residuals of a ring at the reference time; `observations` are the measurements with their light planes.

    With a prior of the motion, every residual is evaluated for the ring at the time of its own frame.
    """
    sds = rate_sds(prior.assumptions.motion) if observations.moving else np.zeros(0)
    stripes, points, edges = predicted_view(arcs, observations.view, rates if len(sds) else None)
    ends = observations.view.ends
    # a: whitened distances of the lines' ends from the predicted lines
    above = observations.view.rays[:, 1] - stripes.rays[:, 1]
    blocks = [(observations.whitening @ above[:ends], -observations.whitening @ stripes.y_wrt_step[:ends])]

    # b: distances of the break points from their edges, along the predicted lines
    wrt_step = points.wrt_step + points.wrt_ray[:, 1:] * stripes.y_wrt_step[ends:]  # the point moves with its line
    distance_wrt_x = points.wrt_ray[:, 0] + stripes.slope[ends:] * points.wrt_ray[:, 1]
    distance_wrt_x = np.where(np.abs(distance_wrt_x) < MIN_RATE, MIN_RATE, distance_wrt_x)
    scale = 1.0 / (np.abs(distance_wrt_x) * observations.sigma_x)
    blocks.append((scale * points.distance_m, scale[:, None] * wrt_step))

    ordinates = _ordinate_scale(measured.points, stripes.slope[ends:], distance_wrt_x)
    which, share, ordinate_scale = ordinates
    if len(which):
        remainder = above[ends:][which] - share * points.distance_m[which]
        jacobian = -stripes.y_wrt_step[ends:][which] - share[:, None] * wrt_step[which]
        blocks.append((ordinate_scale * remainder, ordinate_scale[:, None] * jacobian))

    # c: distances of the visible edge points from their edges, along the edges' normals in the image
    sigma_m = np.abs((edges.wrt_ray * measured.edges.step).sum(axis=1))
    edge_scale = 1.0 / np.maximum(sigma_m, np.finfo(float).tiny)
    blocks.append((edge_scale * edges.distance_m, edge_scale[:, None] * edges.wrt_step))

    residual, wrt_all = (np.concatenate(each) for each in zip(*blocks, strict=True))
    prior_residual, prior_jacobian = _prior_residuals(arcs, prior)  # d
    rate_columns = slice(PARAMETERS, PARAMETERS + len(sds))
    return Residuals(
        arcs=arcs,
        rates=rates,
        rate_sds=sds,
        residual=np.concatenate([residual, prior_residual]),
        jacobian=np.concatenate([wrt_all[:, :PARAMETERS], prior_jacobian]),
        ends=ends,
        data_rows=len(residual),
        stripes=stripes._replace(y_wrt_step=stripes.y_wrt_step[:, :PARAMETERS]),
        points=points,
        edges=edges,
        edge_scale=edge_scale,
        distance_wrt_x=distance_wrt_x,
        distance_scale=scale,
        ordinates=ordinates,
        wrt_rates=_with_zero_rows(wrt_all[:, rate_columns], len(prior_residual)),
        wrt_camera=_with_zero_rows(wrt_all[:, rate_columns.stop :], len(prior_residual)),
        y_wrt_rates=stripes.y_wrt_step[:, rate_columns],
        y_wrt_camera=stripes.y_wrt_step[:, rate_columns.stop :],
    )


def rate_sds(prior: MotionPrior | None) -> Float64[Array, "rate"]:
    """Standard deviations of velocity and angular velocity, as the rates' columns of the residuals; empty if still."""
    return np.zeros(0) if prior is None else np.array([prior.speed_sd_m_s] * 3 + [prior.rate_sd_rad_s] * 2)


def moved_residuals(
    residuals: Residuals,
    step: Float64[Array, "step=7"],
    rate_step: Float64[Array, "rate"],
    measured: Measurements,
    observations: Observations,
    prior: Prior,
) -> Residuals | None:
    """The residuals after a step of the ring, and of its rates in their standard deviations.

    A step longer than `MAX_TILT_RAD` is shortened as a whole. None if the ring is then not in front of the camera, or
    has an impossible size. The angular velocity stays across the normal.
    """
    arcs, rates = residuals.arcs, residuals.rates
    largest = max(map(abs, step[[TILT_INWARD, TILT_ALONG, TURN]].tolist()))
    moved = arcs.moved(step * (MAX_TILT_RAD / largest) if largest > MAX_TILT_RAD else step)
    depth_m = -float(arcs.axes[2] @ moved.origin)
    possible = MIN_DEPTH_M < depth_m < MAX_DEPTH_M and abs(moved.curvature) < MAX_CURVATURE
    if not (possible and all(map(isfinite, step.tolist()))):
        return None
    if len(rate_step):
        change = rate_step * residuals.rate_sds
        across = arcs.axes[:2] @ rates.rate_rad_s + change[3:]
        rates = Rates(rates.velocity_m_s + change[:3], across @ moved.axes[:2])
    return ring_residuals(moved, measured, observations, prior, rates)


def _with_zero_rows(rows: Float64[Array, "data column"], count: int) -> Float64[Array, "row column"]:
    """The rows, and zeros for those of the prior."""
    return np.concatenate([rows, np.zeros((count, rows.shape[1]))])


def at_reference_time(arcs: RingArcs, measured: Measurements, planes: LaserPlanes) -> Measurements:
    """The measurements with t_0 the mean of their stamps, weighted by the information on the ring's position.

    At this time pose and rates are least correlated (ringpose-method(7), section 8). `arcs`: an approximate ring.
    """
    stamp_s = measured.stamp_s
    if not bool(np.isfinite(stamp_s).all()):
        return measured
    residuals = ring_residuals(arcs, measured, measured.observations(planes), Prior())
    rows = residuals.jacobian[: len(stamp_s)] @ motion_derivatives(arcs, arcs, 1.0).wrt_rates[:, :3]
    weight = (rows * rows).sum(axis=1)
    if not 0.0 < float(weight.sum()) < np.inf:
        return measured
    first = float(stamp_s.min())
    return replace(measured, reference_s=first + float(weight @ (stamp_s - first) / weight.sum()))


def _ordinate_scale(
    points: Points, slope: Float64[Array, "point"], distance_wrt_x: Float64[Array, "point"]
) -> OrdinateScale:
    """Weights of the ordinates of points without a line.

    The height above the predicted line is correlated with the error of the abscissa, which residual b uses; the
    remainder after regression on the abscissa (`share`) is independent of it and has the standard deviation 1 / scale.
    """
    which = np.flatnonzero(points.isolated)
    if not len(which):
        return OrdinateScale(which, np.empty(0), np.empty(0))
    covariance, slope = points.covariance[which], slope[which]
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    cross_covariance = xy - slope * xx
    remainder = yy - 2.0 * slope * xy + slope**2 * xx - cross_covariance**2 / xx
    scale = 1.0 / np.sqrt(np.maximum(remainder, 1e-12 * xx))
    return OrdinateScale(which, cross_covariance / xx / distance_wrt_x[which], scale)


def _prior_residuals(arcs: RingArcs, prior: Prior) -> tuple[Float64[Array, "row"], Float64[Array, "row step=7"]]:
    """Residuals d: each row is a value and its nonzero derivatives by component of the step."""
    rows: list[tuple[float, dict[int, float]]] = []
    if prior.radii is not None:
        for sign, radius_m, assumed_m, sd_m in zip(
            EDGE_SIGN, arcs.radius_m.tolist(), prior.radii.radius_m.tolist(), prior.radii.sd_m.tolist(), strict=True
        ):
            if assumed_m == assumed_m:
                derivatives = {CURVATURE: -(arcs.mean_radius_m**2) / sd_m, HALF_BAND: sign / sd_m}
                rows.append(((radius_m - assumed_m) / sd_m, derivatives))
    if prior.regularize_about is not None:
        inward, along, normal = arcs.axes
        rows += [
            ((arcs.curvature - EXPECTED_CURVATURE) / CURVATURE_SD, {CURVATURE: 1.0 / CURVATURE_SD}),
            (float(inward @ prior.regularize_about.axes[1]) / TURN_SD_RAD, {TURN: 1.0 / TURN_SD_RAD}),
        ]
        for axis in range(2):
            derivatives = {TILT_INWARD: inward[axis] / TILT_SD_RAD, TILT_ALONG: along[axis] / TILT_SD_RAD}
            rows.append((float(normal[axis]) / TILT_SD_RAD, derivatives))
    if prior.single_edge:
        rows.append(((arcs.half_band_m - EXPECTED_HALF_BAND_M) / HALF_BAND_SD_M, {HALF_BAND: 1.0 / HALF_BAND_SD_M}))
    jacobian = np.zeros((len(rows), PARAMETERS))
    for row, (_, derivatives) in zip(jacobian, rows, strict=True):
        row[list(derivatives)] = list(derivatives.values())
    return np.array([value for value, _ in rows], dtype=np.float64), jacobian
