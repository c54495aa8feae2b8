"""Residuals of one shot with respect to the ring and their Jacobian (ringpose-method(7), section 5).

All residuals are in units of their standard deviations, in this order: the lines of the stripes (residual a), the
break points along their lines (b), the ordinates of break points without a line, the visible edges (c), and the prior
(d). The ring is described by `ringpose.geometry.ring`.
"""

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
    RingArcs,
    StripePrediction,
    edge_distances,
    predicted_stripes,
)
from ringpose.types.arrays import Array, Float64, Int64
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


class Prior(NamedTuple):
    """What is known about the ring before the measurement."""

    radii: KnownRadii | None = None
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

    @property
    def slope(self) -> Float64[Array, "point"]:
        """Of the predicted lines at the break points."""
        return self.stripes.slope[self.ends :]

    @property
    def y(self) -> Float64[Array, "point"]:
        """Predicted ordinates of the break points."""
        return self.stripes.rays[self.ends :, 1]


def ring_residuals(arcs: RingArcs, measured: Measurements, observations: Observations, prior: Prior) -> Residuals:
    """The residuals of a ring; `observations` are the same measurements with their light planes."""
    ends = len(observations.whitening)
    stripes = predicted_stripes(arcs, observations.rays[:, 0], observations.light_normal, observations.light_distance_m)
    # a: whitened distances of the lines' ends from the predicted lines
    above = observations.rays[:, 1] - stripes.rays[:, 1]
    blocks = [(observations.whitening @ above[:ends], -observations.whitening @ stripes.y_wrt_step[:ends])]

    # b: distances of the break points from their edges, along the predicted lines
    points = edge_distances(arcs, stripes.rays[ends:], observations.edge_sign)
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
    edges = edge_distances(arcs, measured.edges.ray, np.array(EDGE_SIGN)[measured.edges.edge])
    sigma_m = np.abs((edges.wrt_ray * measured.edges.step).sum(axis=1))
    edge_scale = 1.0 / np.maximum(sigma_m, np.finfo(float).tiny)
    blocks.append((edge_scale * edges.distance_m, edge_scale[:, None] * edges.wrt_step))

    data_rows = sum(len(block) for block, _ in blocks)
    blocks.append(_prior_residuals(arcs, prior))  # d
    residual, jacobian = (np.concatenate(each) for each in zip(*blocks, strict=True))
    return Residuals(
        residual, jacobian, ends, data_rows, stripes, points, edges, edge_scale, distance_wrt_x, scale, ordinates
    )


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
