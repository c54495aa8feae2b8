"""The residuals of one shot, from which its ring is estimated, and the initial guess (ringpose-method(7), section 5).

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
    Rates,
    RingArcs,
    StripePrediction,
    predicted_view,
)
from ringpose.geometry.rotations import cross
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.assumptions import Assumptions
from ringpose.types.pose import KnownRadii

PARAMETERS = len(STEP)

EXPECTED_CURVATURE, CURVATURE_SD = 1.5, 1.5
"""Weak prior in 1/m (a radius of 0.3 m has 3.3; the largest ring in launcher manuals has 0.76)."""

TURN_SD_RAD = 0.5
"""Weak prior on the angle between the stripes and the radius, if a single stripe has to determine it."""

TILT_SD_RAD = 0.6
"""Weak prior on the angle between the ring's normal and the optical axis, if a single stripe leaves it open."""

EXPECTED_HALF_BAND_M, HALF_BAND_SD_M = 0.015, 0.015
"""Prior on half the width of the face if only one edge was seen: faces in launcher manuals are 0.03 m wide."""


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
    rate_deviations: Float64[Array, "rate"]
    """The rates in these standard deviations."""
    rows: Float64[Array, "row column"]
    """The residuals r, and their derivatives by the ring's step (J), by its rates, and by the mount's parameters."""
    ends: int
    """Number of the lines' ends: their residuals and predictions come before those of the break points."""
    stripe_rows: int
    """Number of residuals of stripes and break points, which come before those of visible edges."""
    data_rows: int
    """Number of residuals before those of the prior."""
    stripe_numbers: int
    """Number of distinct numbers of stripes and break points: a residual that is repeated counts once."""
    stripes: StripePrediction
    """Derivatives by the ring's step, its rates, and errors of the camera's motion."""
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
    def residual(self) -> Float64[Array, "row"]:
        """The residuals r."""
        residual: Float64[Array, "row"] = self.rows[:, 0]
        return residual

    @property
    def jacobian(self) -> Float64[Array, "row step=7"]:
        """Their derivatives J by the ring's step."""
        jacobian: Float64[Array, "row step=7"] = self.rows[:, 1 : 1 + PARAMETERS]
        return jacobian

    @property
    def wrt_rates(self) -> Float64[Array, "row rate"]:
        """Their derivatives by the rates; no columns for a still ring.

        Velocity of the ring's centre, and angular velocities about its inward axis and about the axis along its face.
        """
        wrt_rates: Float64[Array, "row rate"] = self.rows[:, 1 + PARAMETERS :][:, : len(self.rate_sds)]
        return wrt_rates

    @property
    def wrt_camera(self) -> Float64[Array, "row error"]:
        """Their derivatives by the mount's parameters (`Mount.uncertain`); no columns for a camera at rest."""
        wrt_camera: Float64[Array, "row error"] = self.rows[:, 1 + PARAMETERS + len(self.rate_sds) :]
        return wrt_camera


def ring_residuals(arcs: RingArcs, observations: Observations, prior: Prior, rates: Rates = STILL) -> Residuals:
    """The residuals of a ring at the reference time.

    With a prior of the motion, every residual is evaluated for the ring at the time of its own frame.
    """
    measured, view = observations.measured, observations.view
    motion = prior.assumptions.motion if observations.moving else None
    sds = np.zeros(0) if motion is None else np.array([motion.speed_sd_m_s] * 3 + [motion.rate_sd_rad_s] * 2)
    stripes, points, edges = predicted_view(arcs, view, rates if len(sds) else None)
    ends, samples = view.ends, len(view.rays)
    stripe_rows = samples + observations.isolated
    data_rows = stripe_rows + len(view.visible_rays)
    of_prior = _prior_rows(arcs, prior)
    rows = np.zeros((data_rows + len(of_prior), 1 + stripes.y_wrt_step.shape[1]))

    # a: whitened distances of the lines' ends from the predicted lines
    above = view.rays[:, 1] - stripes.rays[:, 1]
    rows[:ends, 0] = observations.whitening @ above[:ends]
    rows[:ends, 1:] = -observations.whitening @ stripes.y_wrt_step[:ends]

    # b: distances of the break points from their edges, along the predicted lines
    slope, y_wrt_step = stripes.slope[ends:], stripes.y_wrt_step[ends:]
    wrt_step = points.wrt_step + points.wrt_ray[:, 1:] * y_wrt_step  # the point moves with its line
    distance_wrt_x = points.wrt_ray[:, 0] + slope * points.wrt_ray[:, 1]
    distance_wrt_x = np.where(np.abs(distance_wrt_x) < MIN_RATE, MIN_RATE, distance_wrt_x)
    scale = 1.0 / (np.abs(distance_wrt_x) * measured.points.sigma_x)
    rows[ends:samples, 0] = scale * points.distance_m
    rows[ends:samples, 1:] = scale[:, None] * wrt_step

    ordinates = _ordinate_scale(measured.points, slope, distance_wrt_x)
    if observations.isolated:
        which, share, ordinate_scale = ordinates
        rows[samples:stripe_rows, 0] = ordinate_scale * (above[ends:][which] - share * points.distance_m[which])
        rows[samples:stripe_rows, 1:] = -ordinate_scale[:, None] * (
            y_wrt_step[which] + share[:, None] * wrt_step[which]
        )

    # c: distances of the visible edge points from their edges, along the edges' normals in the image
    sigma_m = np.abs((edges.wrt_ray * measured.edges.step).sum(axis=1))
    edge_scale = 1.0 / np.maximum(sigma_m, np.finfo(float).tiny)
    rows[stripe_rows:data_rows, 0] = edge_scale * edges.distance_m
    rows[stripe_rows:data_rows, 1:] = edge_scale[:, None] * edges.wrt_step

    rows[data_rows:, : 1 + PARAMETERS] = of_prior  # d
    return Residuals(
        arcs=arcs,
        rates=rates,
        rate_sds=sds,
        rate_deviations=rates_along(arcs, rates) / sds if len(sds) else sds,
        rows=rows,
        ends=ends,
        stripe_rows=stripe_rows,
        data_rows=data_rows,
        stripe_numbers=observations.stripe_numbers,
        stripes=stripes,
        points=points,
        edges=edges,
        edge_scale=edge_scale,
        distance_wrt_x=distance_wrt_x,
        distance_scale=scale,
        ordinates=ordinates,
    )


def rates_along(arcs: RingArcs, rates: Rates) -> Float64[Array, "rate=5"]:
    """The velocity, and the angular velocities about the inward axis and about the axis along the face."""
    return np.concatenate([rates.velocity_m_s, arcs.axes[:2] @ rates.rate_rad_s])


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


def _prior_rows(arcs: RingArcs, prior: Prior) -> Float64[Array, "row 8"]:
    """Residuals d and their derivatives by the step; `rows` holds each value with its nonzero derivatives."""
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
    found = np.zeros((len(rows), 1 + PARAMETERS))
    for row, (value, derivatives) in zip(found, rows, strict=True):
        row[0], row[1:][list(derivatives)] = value, list(derivatives.values())
    return found


# Initial guess

MIN_LENGTH_M = 1e-9
"""A shorter vector has no direction."""


def initial_guess(observations: Observations, prior: Prior) -> RingArcs | None:
    """The plane of the stripes, and a ring of typical size on it; None if the plane is not in front of the camera.

    The origin lies on the middle of the face, on the mean ray of the break points.
    """
    measured, view = observations.measured, observations.view
    if not len(measured.points.x):
        return None
    try:
        plane = _plane_of_stripes(observations)
    except np.linalg.LinAlgError:
        return None
    # the stripes on that plane, and the break points on them
    image_line = view.light_normal - view.light_distance_m[:, None] * plane
    slope = image_line[:, 0] / -image_line[:, 1]
    rays = view.rays.copy()
    rays[:, 1] = slope * rays[:, 0] - image_line[:, 2] / image_line[:, 1]
    inverse_depth = rays @ plane
    if not bool((inverse_depth > 0).all()):
        return None
    ends = view.ends
    rays, slope, depth_m = rays[ends:], slope[ends:], 1.0 / inverse_depth[ends:]
    points_m = depth_m[:, None] * rays
    # dP/dx of the break points along their stripes, for P = depth r
    points_wrt_x = depth_m[:, None] * np.column_stack([np.ones_like(slope), slope, np.zeros_like(slope)])
    points_wrt_x -= (depth_m * (plane[0] + slope * plane[1]))[:, None] * points_m

    normal = -plane / float(np.sqrt(plane @ plane))
    outward = _outward_direction(normal, measured, points_m, points_wrt_x)
    mean_ray = rays.mean(axis=0)
    curvature, half_band_m = _expected_size(measured, points_m @ outward, prior)
    return RingArcs(
        origin=mean_ray / float(mean_ray @ plane),
        axes=np.array([-outward, cross(normal, -outward), normal]),
        curvature=curvature,
        half_band_m=half_band_m,
    )


def _plane_of_stripes(observations: Observations) -> Float64[Array, "3"]:
    """The plane q that fits the stripes: (m . r - d q . r) / (m - d q)_y = 0, linear in q for a fixed denominator."""
    measured, view = observations.measured, observations.view
    ends, count = view.ends, len(view.rays)
    whitening = np.zeros((count, count))
    whitening[:ends, :ends] = observations.whitening
    isolated = ends + np.flatnonzero(measured.points.isolated)
    whitening[isolated, isolated] = 1.0 / np.sqrt(measured.points.covariance[isolated - ends, 1, 1])
    distance_m = view.light_distance_m
    cosine = (view.light_normal * view.rays).sum(axis=1)  # m . r
    plane = np.array([0.0, 0.0, float((cosine / distance_m).sum()) / count])
    for _ in range(2):
        denominator = view.light_normal[:, 1] - distance_m * plane[1]
        rows = whitening @ ((distance_m / denominator)[:, None] * view.rays)
        matrix = rows.T @ rows
        matrix[[0, 1], [0, 1]] += 1.0 / plane[2] ** 2  # with a single stripe: a plane that faces the camera
        plane = np.linalg.solve(matrix, rows.T @ (whitening @ (cosine / denominator)))
    return plane


def _outward_direction(
    normal: Float64[Array, "3"],
    measured: Measurements,
    points_m: Float64[Array, "point 3"],
    points_wrt_x: Float64[Array, "point 3"],
) -> Float64[Array, "3"]:
    """Mean direction from inner towards outer ends, seen from the middles of their stripes."""
    points = measured.points
    direction = ((2.0 * points.edge - 1.0) * (points.x - points.middle_x)) @ points_wrt_x
    if float(direction @ direction) < MIN_LENGTH_M**2:  # no stripe has a length: across the row of break points
        direction = cross(normal, points_m[-1] - points_m[0])
    if float(direction @ direction) < MIN_LENGTH_M**2:  # a single point: along its stripe
        direction = points_wrt_x[0]
    direction = direction - (direction @ normal) * normal
    unit: Float64[Array, "3"] = direction / np.sqrt(direction @ direction)
    return unit


def _expected_size(measured: Measurements, outward_m: Float64[Array, "point"], prior: Prior) -> tuple[float, float]:
    """Curvature (1/m) of the ring and half the width (m) of its face.

    Both follow from the prior of the radii where it gives them. Otherwise the curvature is that of a typical ring, and
    the width is the mean distance between the inner and the outer break points, at `outward_m` in radial direction.
    """
    inner, outer = (outward_m[measured.points.edge == edge].tolist() for edge in range(2))
    half_band_m = 0.5 * (sum(outer) / len(outer) - sum(inner) / len(inner)) if inner and outer else EXPECTED_HALF_BAND_M
    if prior.radii is None or not np.isfinite(prior.radii.radius_m).any():
        return EXPECTED_CURVATURE, half_band_m
    inner_m, outer_m = prior.radii.radius_m.tolist()
    both_known = np.isfinite(outer_m - inner_m)
    return 1.0 / float(np.nanmean(prior.radii.radius_m)), 0.5 * (outer_m - inner_m) if both_known else half_band_m
