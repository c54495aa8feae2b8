"""Factors: the kinds of measurement of a ring, each in one class, and the linearised problem that they add up to.

A factor gives the residuals of its kind in units of their standard deviations: the lines of the stripes, Eq. (5.4) of
ringpose-method(7), break points (5.5), visible edge points (5.6), the prior (5.7). It also gives their derivatives by
what they are made of: the ordinate (5.1) of a predicted stripe, the distance (5.2) from an edge, and the measured ray.
The chain rule leads from there to the ring and its rates (section 8), and to errors of the rig and of the ring's form,
for all kinds alike (`ringpose.estimate.nuisance`). `ring_residuals` joins the rows; the solver knows no kind.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf, isfinite
from typing import ClassVar, NamedTuple

import numpy as np

from ringpose.estimate.linearization import Derivatives, FixedColumns, LinearProblem, Observations, Residuals
from ringpose.estimate.nuisance import FORM_ORDERS, FORM_PARAMETERS, FORM_SHARE, RigErrors, covariance_root, rig_errors
from ringpose.geometry.ring import (
    CURVATURE,
    EDGE_SIGN,
    HALF_BAND,
    LIFT,
    MIN_RATE,
    STEP,
    TILT_ALONG,
    TILT_INWARD,
    TINY,
    TURN,
    MovingRing,
    Rates,
    RingArcs,
    RingPrediction,
    edge_distances,
    polar_angles,
    predicted_view,
)
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.assumptions import Assumptions
from ringpose.types.plausible import RING_RADIUS_M
from ringpose.types.pose import KnownRadii

PARAMETERS = len(STEP)

Index = slice | Int64[Array, "row"]

MINUS_ONE = np.array([[-1.0]])


@dataclass(frozen=True, kw_only=True, eq=False)
class Factor:
    """One kind of measurement."""

    robust: ClassVar[bool] = False
    """Whether single rows may be outliers: they count linearly while the iteration approaches."""
    many: ClassVar[bool] = False
    """Whether they are too many, and too correlated, for chi-squared: single ones are rejected as outliers instead."""

    stamp_s: Float64[Array, "row"]
    """Mid exposure of the frame that each row comes from; NaN if unknown."""
    opposite: Bool[Array, "row"]
    """Whether each row is of the opposite arc."""
    ray: Index
    """Index of each row's ray among the samples of stripes, then the visible edge points (`RingSamples`) ..."""
    beside: Index | None = None
    """... and of its distance from an edge, among those of break points, then of visible edge points."""
    edge: Int64[Array, "row"] | None = None
    """0 for a row of the inner edge, 1 for one of the outer edge; None for rows of the middle of the face."""
    whitening: Float64[Array, "row row"] | None = None
    """W with W^T W the inverse covariance of the rows; None if each is divided by its own standard deviation."""

    def residuals(self, at: RingPrediction) -> tuple[Float64[Array, "row"], Derivatives]:
        """The residuals at a ring, before the whitening, and their derivatives."""
        raise NotImplementedError

    def linearized(self, at: RingPrediction) -> tuple[Float64[Array, "row column"], Derivatives | None]:
        """[r J] before the whitening: by the columns of the prediction, ring, rates and camera's motion, Eq. (8.2).

        Also the derivatives that lead there; None for a kind that is not seen in the image.
        """
        residual, by = self.residuals(at)
        rows = np.empty((len(residual), 1 + at.stripes.y_wrt_step.shape[1]))
        rows[:, 0], rows[:, 1:] = residual, 0.0
        if by.ordinate is not None:
            rows[:, 1:] = by.ordinate * at.stripes.y_wrt_step[self.ray]
        if by.distance is not None:
            rows[:, 1:] += by.distance * at.edges.wrt_step[self.beside]
        return rows, by

    def wrt_ray(self, at: RingPrediction) -> Float64[Array, "row xy=2"]:
        """Derivatives of the residuals by the measured rays, before the whitening."""
        raise NotImplementedError

    def whitened(self, rows: Float64[Array, "row *column"]) -> Float64[Array, "row *column"]:
        """The rows in units of their standard deviations."""
        return rows if self.whitening is None else self.whitening @ rows

    def own_errors(self, jacobian: Float64[Array, "row step=7"], tolerance_m: float) -> Float64[Array, "row error"]:
        """Derivatives by errors that only these rows have in common, in sigmas; `tolerance_m`: of the ring.

        `jacobian`: the derivatives of the whitened rows by the ring's step.
        """
        return np.zeros((len(jacobian), 0))


@dataclass(frozen=True, kw_only=True, eq=False)
class LineFactor(Factor):
    """The lines of the stripes on the face, by the ordinates y at their two ends."""

    y: Float64[Array, "row"]

    def residuals(self, at: RingPrediction) -> tuple[Float64[Array, "row"], Derivatives]:
        """Eq. (5.4): the heights y - y(x) above the predicted line y(x), Eq. (5.1)."""
        return self.y - at.stripes.rays[self.ray, 1], Derivatives(ordinate=MINUS_ONE)

    def wrt_ray(self, at: RingPrediction) -> Float64[Array, "row xy=2"]:
        """The predicted line is taken at the measured abscissa."""
        return np.stack([-at.stripes.slope[self.ray], np.ones(len(self.y))], axis=1)


@dataclass(frozen=True, kw_only=True, eq=False)
class PointFactor(Factor):
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


ROUNDED_M, ROUNDED_TOLERANCES = 5e-4, 5.0
"""Standard deviation of the displacement of a visible edge by a chamfer or rounding, and its limit as a multiple of the
ring's tolerance: machined edges are broken by up to half a millimetre, those of a perfect ring are sharp."""

WALL_SD_M = 0.03
"""Standard deviation of the depth of a wall's foot below the face: interface rings are 10 to 60 mm high."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeFactor(Factor):
    """Visible points of the ring's edges."""

    robust: ClassVar[bool] = True
    many: ClassVar[bool] = True

    step: Float64[Array, "row xy=2"]
    """Displacement by one standard deviation, along the edge's normal in the image."""
    common: Float64[Array, "row error"]
    """Derivatives by the errors of neighbouring points (unit variance), in the points' standard deviations."""
    walls: bool
    """Whether the edges may be the feet of the ring's walls."""

    def residuals(self, at: RingPrediction) -> tuple[Float64[Array, "row"], Derivatives]:
        """Eq. (5.6): the distance (5.2), divided by its change over one standard deviation along the edge's normal."""
        scale = self.scale(at)
        return scale * at.edges.distance_m[self.beside], Derivatives(distance=scale[:, None])

    def scale(self, at: RingPrediction) -> Float64[Array, "row"]:
        """1 / standard deviation of the distance from the edge."""
        wrt_sd = (at.edges.wrt_ray[self.beside] * self.step).sum(axis=1)
        scale: Float64[Array, "row"] = 1.0 / np.maximum(np.abs(wrt_sd), TINY)
        return scale

    def wrt_ray(self, at: RingPrediction) -> Float64[Array, "row xy=2"]:
        """By the derivatives of the distance."""
        wrt_ray: Float64[Array, "row xy=2"] = self.scale(at)[:, None] * at.edges.wrt_ray[self.beside]
        return wrt_ray

    def own_errors(self, jacobian: Float64[Array, "row step=7"], tolerance_m: float) -> Float64[Array, "row error"]:
        """By errors of neighbouring points, by displacements of whole edges, and by the depth of the feet of walls.

        A chamfer or a rounding reflects laser light and ambient light in different directions, so that the edge in
        ambient light lies beside the ends of the stripes by up to its width.

        What looks like an edge may be the foot of the ring's wall where the camera sees the wall and it is as bright as
        the face: the depth of the foot below the face is an error of each edge. Beside several stripes it mainly
        changes the curvature, as the wall's width in the image changes along the edge; a single one leaves the tilt
        about it to the edges, and a tilt has the same effect.
        """
        assert self.edge is not None
        columns, of_edge = [self.common], self.edge[:, None] == range(len(EDGE_SIGN))
        rounded_m = min(ROUNDED_M, ROUNDED_TOLERANCES * tolerance_m)
        if rounded_m > 0.0:
            columns.append(rounded_m * np.abs(jacobian[:, HALF_BAND, None]) * of_edge)
        if self.walls:
            outward = jacobian[:, LIFT, None]
            columns.append(WALL_SD_M * (of_edge & (outward * EDGE_SIGN > 0.0)) * outward)
        return np.concatenate(columns, axis=1)


EXPECTED_CURVATURE = 1.5
"""Mean and standard deviation in 1/m of the weak prior where nothing shows the radius: one of 0.3 m has 3.3; the
largest ring in launcher manuals has 0.76."""

TURN_SD_RAD = 0.5
"""Weak prior on the angle between the stripes and the radius, if a single stripe has to determine it."""

TILT_SD_RAD = 0.6
"""Weak prior on the angle between the ring's normal and the optical axis, if a single stripe leaves it open."""

EXPECTED_HALF_BAND_M, HALF_BAND_SD_M = 0.015, 0.015
"""Prior on half the width of the face if only one edge was seen: faces in launcher manuals are 0.03 m wide."""


class Prior(NamedTuple):
    """What is known about the ring before the measurement: the last factor of each problem."""

    radii: KnownRadii | None = None
    assumptions: Assumptions = Assumptions()
    """Assumptions on motion, the ring's form and the rig."""
    regularize_about: RingArcs | None = None
    """The ring about which curvature, turn and tilt have weak priors; None to estimate from the shot alone. Of a small
    ring, which ends on both arcs show, the curvature is also the standard deviation of its prior."""
    single_edge: bool = False
    """Whether only one edge was seen, so that the width of the face needs a prior."""

    def rows(self, at: RingPrediction) -> Float64[Array, "row column"]:
        """[r J] of Eq. (5.7); `rows` holds each residual with its nonzero derivatives."""
        arcs, rows = at.arcs, list[tuple[float, dict[int, float]]]()
        if self.radii is not None:
            for sign, radius_m, assumed_m, sd_m in zip(
                EDGE_SIGN, arcs.radius_m.tolist(), self.radii.radius_m.tolist(), self.radii.sd_m.tolist(), strict=True
            ):
                if assumed_m == assumed_m:
                    derivatives = {CURVATURE: -(arcs.mean_radius_m**2) / sd_m, HALF_BAND: sign / sd_m}
                    rows.append(((radius_m - assumed_m) / sd_m, derivatives))
        if self.regularize_about is not None:
            inward, along, normal = arcs.axes
            expected = max(abs(self.regularize_about.curvature), EXPECTED_CURVATURE)
            rows += [
                (arcs.curvature / expected - 1.0, {CURVATURE: 1.0 / expected}),
                (float(inward @ self.regularize_about.axes[1]) / TURN_SD_RAD, {TURN: 1.0 / TURN_SD_RAD}),
            ]
            for axis in range(2):
                derivatives = {TILT_INWARD: inward[axis] / TILT_SD_RAD, TILT_ALONG: along[axis] / TILT_SD_RAD}
                rows.append((float(normal[axis]) / TILT_SD_RAD, derivatives))
        if self.single_edge:
            half_band = (arcs.half_band_m - EXPECTED_HALF_BAND_M) / HALF_BAND_SD_M
            rows.append((half_band, {HALF_BAND: 1.0 / HALF_BAND_SD_M}))
        table = np.zeros((len(rows), 1 + at.stripes.y_wrt_step.shape[1]))
        for row, (value, derivatives) in zip(table, rows, strict=True):
            row[0], row[1:][list(derivatives)] = value, list(derivatives.values())
        return table


# The linearised problem

RIDGE = 1e-7
"""Added to the diagonal of the normal matrix (m, rad, 1/m), so that undetermined parameters keep their values."""

RIDGE_MATRIX = RIDGE * np.eye(PARAMETERS)

HOPELESS = 1e4
"""Factor on the limits of `poorly_determined` beyond which an iteration that starts without weak priors ends."""

STILL = Rates(np.zeros(3), np.zeros(3))

MIN_DEPTH_M, MAX_DEPTH_M = 1e-3, 1e3
"""Bounds of the plane's distance; beyond them the iteration has diverged."""

MAX_CURVATURE = 1 / RING_RADIUS_M.lowest
"""Bound in 1/m, of the smallest ring that a file may state; beyond it the iteration has diverged."""

MAX_TILT_RAD = 0.7
"""Largest tilt in one iteration."""


def ring_residuals(arcs: RingArcs, observations: Observations, prior: Prior, rates: Rates = STILL) -> Residuals:
    """The residuals of a ring at the reference time: of the factors in their order, then of the prior.

    With a prior of the motion, every residual is evaluated for the ring at the time of its own frame.
    """
    motion = prior.assumptions.motion if observations.moving else None
    sds = np.zeros(0) if motion is None else np.array([motion.speed_sd_m_s] * 3 + [motion.rate_sd_rad_s] * 2)
    rates, count = (rates, len(sds)) if len(sds) else (STILL, 0)
    at = predicted_view(arcs, observations.view, rates if count else None)
    rows = np.concatenate(
        [*[factor.whitened(factor.linearized(at)[0]) for factor, _ in observations.blocks], prior.rows(at)]
    )
    return Residuals(
        arcs=arcs,
        rates=rates,
        rate_sds=sds,
        rate_deviations=np.divide(rates_along(arcs, rates), sds, out=np.zeros(5), where=sds > 0) if count else sds,
        at=at,
        residual=rows[:, 0],
        jacobian=rows[:, 1 : 1 + PARAMETERS],
        wrt_rates=rows[:, 1 + PARAMETERS : 1 + PARAMETERS + count],
        wrt_camera=rows[:, 1 + PARAMETERS + count :],
        observations=observations,
        data_rows=len(observations.robust),
    )


def linearize(
    start: RingArcs | MovingRing,
    observations: Observations,
    prior: Prior,
    errors: Float64[Array, "error"] | None = None,
    hopeless: float = inf,
) -> LinearProblem:
    """The problem at a start; its derivatives by common errors are None for a ring that is a mere guess.

    `errors` are common errors that are known from an estimate nearby. LinAlgError if parameters are so far from being
    determined that an iteration is useless: `hopeless` times more than the limits of `poorly_determined`.
    """
    arcs, rates = (start, STILL) if isinstance(start, RingArcs) else start
    residuals = ring_residuals(arcs, observations, prior, rates)
    if poorly_determined(np.linalg.inv(residuals.jacobian.T @ residuals.jacobian + RIDGE_MATRIX), hopeless):
        raise np.linalg.LinAlgError("parameters are not determined")
    if isinstance(start, RingArcs):
        return LinearProblem(residuals, None, residuals.residual)
    return linearized_at(residuals, prior, errors)


def linearized_at(residuals: Residuals, prior: Prior, errors: Float64[Array, "error"] | None) -> LinearProblem:
    """The problem at a ring near the solution, with the derivatives there by common errors."""
    fixed, count = common_errors(residuals, prior), len(residuals.rate_sds)
    if errors is None or len(errors) != count + fixed.columns.shape[1]:
        return LinearProblem(residuals, fixed, residuals.residual)
    return LinearProblem(residuals, fixed, residuals.residual + fixed.columns @ errors[count:])


def with_sigmas_raised(residuals: Residuals, factor: Float64[Array, "row"], observations: Observations) -> Residuals:
    """The residuals of observations whose standard deviations are higher by a factor, which is 1 for the prior."""
    scale = 1.0 / factor[:, None]
    return residuals._replace(
        residual=residuals.residual / factor,
        jacobian=scale * residuals.jacobian,
        wrt_rates=scale * residuals.wrt_rates,
        wrt_camera=scale * residuals.wrt_camera,
        observations=observations,
    )


def poorly_determined(covariance: Float64[Array, "7 7"], factor: float = 1.0) -> bool:
    """Whether tilt or in-plane rotation are left to more than 0.5 rad, or curvature to more than 1/m (sigmas).

    The weak priors of `Prior.rows` have about these standard deviations. `factor` multiplies the variances.
    """
    variance = covariance.diagonal().tolist()
    return bool(max(variance[TILT_INWARD], variance[TILT_ALONG], variance[TURN]) > 0.25 * factor) or bool(
        variance[CURVATURE] > factor
    )


def rates_along(arcs: RingArcs, rates: Rates) -> Float64[Array, "rate=5"]:
    """The velocity, and the angular velocities about the inward axis and about the axis along the face."""
    return np.concatenate([rates.velocity_m_s, arcs.axes[:2] @ rates.rate_rad_s])


def retract_ring(residuals: Residuals, step: Float64[Array, "step=7"], rate_step: Float64[Array, "rate"]) -> Residuals:
    """The ring and its rates after one step, with the residuals that it predicts.

    `rate_step` is in standard deviations of the rates' prior. A step longer than `MAX_TILT_RAD` is shortened as a
    whole. LinAlgError if the ring is then not in front of the camera, or has an impossible size. The angular velocity
    stays across the normal.
    """
    arcs, rates = residuals.arcs, residuals.rates
    largest = max(map(abs, step[[TILT_INWARD, TILT_ALONG, TURN]].tolist()))
    step = step * (MAX_TILT_RAD / largest) if largest > MAX_TILT_RAD else step
    moved = arcs.retract(step)
    depth_m = -float(arcs.axes[2] @ moved.origin)
    possible = MIN_DEPTH_M < depth_m < MAX_DEPTH_M and abs(moved.curvature) < MAX_CURVATURE
    if not (possible and all(map(isfinite, step.tolist()))):
        raise np.linalg.LinAlgError("the iteration diverges")
    if len(rate_step):
        along = rates_along(arcs, rates) + rate_step * residuals.rate_sds
        rates = Rates(along[:3], along[3:] @ moved.axes[:2])
    predicted = residuals.residual + residuals.jacobian @ step + residuals.wrt_rates @ (rate_step * residuals.rate_sds)
    return residuals._replace(
        arcs=moved, rates=rates, rate_deviations=residuals.rate_deviations + rate_step, residual=predicted
    )


# Errors that many rows have in common, whose derivatives are evaluated once, near the solution


def common_errors(residuals: Residuals, prior: Prior) -> FixedColumns:
    """Derivatives of the residuals by errors of rig, form and mount, then by those of single factors."""
    observations, assumed = residuals.observations, prior.assumptions
    rig, form, slope, columns = None, None, None, [np.zeros((len(residuals.residual), 0))]
    mean_ray = np.zeros((2, 0))
    errors = rig_errors(observations.rig, assumed.stability)
    if errors is not None:
        rig, mean_ray = rig_jacobian(residuals, errors)
        mean_ray = mean_ray @ errors.root
        columns.append(rig @ errors.root)
    if assumed.ring_tolerance_m > 0.0:
        form = form_jacobian(residuals)
        columns.append(FORM_SHARE * assumed.ring_tolerance_m * form)
    if assumed.face_slope_rad > 0.0:
        slope = slope_jacobian(residuals)
        columns.append(assumed.face_slope_rad * slope[:, None])
    if residuals.wrt_camera.shape[1] and observations.camera is not None:
        covariance = observations.camera.mount.covariance
        uncertain = np.diag(covariance) > 0
        columns.append(residuals.wrt_camera @ covariance_root(covariance[np.ix_(uncertain, uncertain)]))
    shared = sum(each.shape[1] for each in columns)
    for factor, rows in observations.blocks:
        own = factor.own_errors(residuals.jacobian[rows], assumed.ring_tolerance_m)
        columns.append(np.zeros((len(residuals.residual), own.shape[1])))
        columns[-1][rows] = own
    joined = np.concatenate(columns, axis=1)
    return FixedColumns(rig, form, slope, residuals.wrt_camera, mean_ray, joined, joined.shape[1] - shared)


def rig_jacobian(
    residuals: Residuals, errors: RigErrors
) -> tuple[Float64[Array, "row parameter"], Float64[Array, "xy=2 parameter"]]:
    """Derivatives of the residuals, and of the mean of the predicted break points for a fixed ring.

    Errors of the camera move the rays of fixed pixels, errors of a light plane move the predicted stripe. The abscissae
    of predicted points are those of the measured pixels, their ordinates those of the predicted stripes.
    """
    observations, stripes, count = residuals.observations, residuals.at.stripes, len(errors.parameters)
    laser, wrt_camera = observations.laser, observations.wrt_camera
    rays = (wrt_camera.reshape(-1, len(errors.camera)) @ errors.camera).reshape(len(wrt_camera), 2, count)
    # m . r = d / depth: the cosine by the tilts is e1 . r and e2 . r, and the distance acts like a cosine of -1 / depth
    cosine_wrt_tilts = (errors.basis[laser] @ stripes.rays[:, :, None])[:, :, 0]
    y_wrt_plane = stripes.y_wrt_cosine[:, None] * np.column_stack([cosine_wrt_tilts, -1.0 / stripes.depth])
    ordinates = (y_wrt_plane[:, None] @ errors.lasers[laser])[:, 0]
    jacobian = np.zeros((len(residuals.residual), count))
    for factor, rows, _, by in _seen(residuals):
        jacobian[rows] = (factor.wrt_ray(residuals.at)[:, :, None] * rays[factor.ray]).sum(axis=1)
        if by.ordinate is not None:
            jacobian[rows] += by.ordinate * ordinates[factor.ray]
        jacobian[rows] = factor.whitened(jacobian[rows])
    points, x = observations.described, rays[: len(laser), 0]
    predicted = x, ordinates + stripes.slope[:, None] * x
    return jacobian, np.array([each[points].mean(axis=0) for each in predicted])


def form_jacobian(residuals: Residuals) -> Float64[Array, "row amplitude=18"]:
    """Derivatives of the residuals with respect to the amplitudes of the ring's form (`FORM_PARAMETERS`), Eq. (12.1).

    An axial deviation acts like an offset of the plane, a radial one like a change of its edge's radius, both at the
    angle of the row: the two ends of a line are at different angles.
    """
    at, view = residuals.at, residuals.observations.view
    phase = polar_angles(at.arcs, np.concatenate([at.stripes.rays, view.visible_rays]))[:, None] * FORM_ORDERS
    shape = np.stack([np.cos(phase), np.sin(phase)], axis=-1).reshape(len(phase), -1)
    jacobian = np.zeros((len(residuals.residual), len(FORM_PARAMETERS)))
    for factor, rows, unwhitened, by in _seen(residuals):
        deviation = np.zeros((len(unwhitened), 3))  # inner, outer, axial
        if factor.edge is not None and by.distance is not None:
            deviation[range(len(deviation)), factor.edge] -= by.distance[:, 0]
        deviation[:, 2] = unwhitened[:, 1 + LIFT]
        of_rows = deviation[:, :, None] * shape[factor.ray][:, None]
        jacobian[rows] = factor.whitened(of_rows.reshape(len(of_rows), -1))
    return jacobian


def slope_jacobian(residuals: Residuals) -> Float64[Array, "row"]:
    """Derivatives of the residuals with respect to the slope of the face, Eq. (12.3).

    The face rises outwards by the slope times the distance from its middle, and acts there like an offset of the plane.
    """
    at, arcs = residuals.at, residuals.arcs
    jacobian = np.zeros(len(residuals.residual))
    for factor, rows, unwhitened, _ in _seen(residuals):
        if factor.edge is None:
            outside_m = edge_distances(arcs, at.stripes.rays[factor.ray], np.zeros(len(unwhitened))).distance_m
        else:
            outside_m = arcs.half_band_m * np.array(EDGE_SIGN)[factor.edge]
        jacobian[rows] = factor.whitened(outside_m * unwhitened[:, 1 + LIFT])
    return jacobian


def _seen(
    residuals: Residuals,
) -> Iterator[tuple[Factor, slice, Float64[Array, "row column"], Derivatives]]:
    """The factors that are seen in the image, with their rows before the whitening and the derivatives of these."""
    for factor, rows in residuals.observations.blocks:
        unwhitened, by = factor.linearized(residuals.at)
        if by is not None:
            yield factor, rows, unwhitened, by
