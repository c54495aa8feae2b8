"""The problem linearised at a ring: the factors of a shot, their residuals at a ring, and derivatives of these.

A factor is one kind of measurement; each has a module in `ringpose.estimate.factors`. It gives the residuals of its
kind in units of their standard deviations, and their derivatives by what they are made of: the ordinate, Eq. (5.1) of
ringpose-method(7), of a predicted stripe, the distance (5.2) from an edge, and the measured ray. The chain rule leads
from there to the ring and its rates (section 8), and to errors of the rig and of the ring's form, for all kinds alike
(`ringpose.estimate.nuisance`). `ring_residuals` joins the rows; the solver knows no kind.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from ringpose.estimate.factors.prior import Prior
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.geometry.ring import (
    STEP,
    STILL,
    TILT_ALONG,
    TILT_INWARD,
    TURN,
    Rates,
    RingArcs,
    RingPrediction,
    RingSamples,
    predicted_view,
)
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.plausible import RING_RADIUS_M, TARGET_DISTANCE_M
from ringpose.types.rig import Rig

if TYPE_CHECKING:
    from ringpose.estimate.factors.points import PointFactor


class Derivatives(NamedTuple):
    """Derivatives of the residuals of one kind, before its whitening; None where they do not depend on it."""

    ordinate: Float64[Array, "#row 1"] | None = None
    """By the ordinate of the predicted stripe at the row's ray."""
    distance: Float64[Array, "#row 1"] | None = None
    """By the distance of the row's ray from the row's edge."""


Index = slice | Int64[Array, "row"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Factor(ABC):
    """One kind of measurement."""

    robust: ClassVar[bool] = False
    """Whether single rows may be outliers: they count linearly while the iteration approaches."""
    many: ClassVar[bool] = False
    """Whether they are too many, and too correlated, for chi-squared: single ones are rejected as outliers instead."""

    stamp_s: Float64[Array, "row"]
    """Mid exposure of the frame that each row comes from; NaN if unknown."""
    opposite: Bool[Array, "row"]
    """Whether each row is of the opposite arc."""

    @abstractmethod
    def linearized(self, at: RingPrediction) -> Float64[Array, "row column"]:
        """[r J] in sigmas: by the columns of the prediction, for ring, rates and the camera's motion, Eq. (8.2)."""

    def own_errors(self, jacobian: Float64[Array, "row step=7"], tolerance_m: float) -> Float64[Array, "row error"]:
        """Derivatives by errors that only these rows have in common, in sigmas; `tolerance_m`: of the ring.

        `jacobian`: the derivatives of the whitened rows by the ring's step.
        """
        return np.zeros((len(jacobian), 0))


@dataclass(frozen=True, kw_only=True, eq=False)
class ImageFactor(Factor):
    """A kind of measurement in the image, which errors of the rig and of the ring's form displace."""

    ray: Index
    """Index of each row's ray among the samples of stripes, then the visible edge points (`RingSamples`) ..."""
    beside: Index | None = None
    """... and of its distance from an edge, among those of break points, then of visible edge points."""
    edge: Int64[Array, "row"] | None = None
    """0 for a row of the inner edge, 1 for one of the outer edge; None for rows of the middle of the face."""
    whitening: Float64[Array, "row row"] | None = None
    """W with W^T W the inverse covariance of the rows; None if each is divided by its own standard deviation."""

    @abstractmethod
    def residuals(self, at: RingPrediction) -> tuple[Float64[Array, "row"], Derivatives]:
        """The residuals at a ring, before the whitening, and their derivatives."""

    @abstractmethod
    def wrt_ray(self, at: RingPrediction) -> Float64[Array, "row xy=2"]:
        """Derivatives of the residuals by the measured rays, before the whitening."""

    def linearized(self, at: RingPrediction) -> Float64[Array, "row column"]:
        """The whitened rows, by the chain rule."""
        return self.whitened(self.unwhitened(at)[0])

    def unwhitened(self, at: RingPrediction) -> tuple[Float64[Array, "row column"], Derivatives]:
        """[r J] before the whitening, and the derivatives that lead there."""
        residual, by = self.residuals(at)
        rows = np.empty((len(residual), 1 + at.stripes.y_wrt_step.shape[1]))
        rows[:, 0], rows[:, 1:] = residual, 0.0
        if by.ordinate is not None:
            rows[:, 1:] = by.ordinate * at.stripes.y_wrt_step[self.ray]
        if by.distance is not None:
            rows[:, 1:] += by.distance * at.edges.wrt_step[self.beside]
        return rows, by

    def whitened(self, rows: Float64[Array, "row *column"]) -> Float64[Array, "row *column"]:
        """The rows in units of their standard deviations."""
        return rows if self.whitening is None else self.whitening @ rows


class Observations(NamedTuple):
    """The factors of a shot, and the samples of the ring to which their rows refer."""

    blocks: "tuple[tuple[Factor, slice], ...]"
    """The factors with the rows of each: lines, break points, other kinds, visible edges."""
    view: RingSamples
    rig: Rig
    moving: bool
    """Whether the shot has times from which a motion can be estimated."""
    laser: Int64[Array, "sample"]
    whitening: Float64[Array, "end end"] | None
    """Of the lines' ordinates, block-diagonal."""
    points: "PointFactor"
    described: Int64[Array, "point"]
    """The samples that are break points on the arc at which the ring is described."""
    wrt_camera: Float64[Array, "ray xy=2 parameter"]
    """Derivatives of the rays by the camera's parameters."""
    bend_m: Float64[Array, "sample bow=3"] | None
    """Derivatives of the elevation of bent sheets over their planes by `BOW_PARAMETERS`; None if all are flat."""
    camera: CameraMotion | None
    """Motion of the camera; None if it counts as inertial."""
    robust: Bool[Array, "row"]
    """`Factor.robust` of each row ..."""
    many: Bool[Array, "row"]
    """... and `Factor.many`; both without the rows of the prior."""
    numbers: int
    """Number of measured values of the factors that are not many; one that was measured twice counts once."""


class Residuals(NamedTuple):
    """The whitened residuals at a ring, their Jacobian, and the prediction that they come from."""

    arcs: RingArcs
    """The ring at the reference time ..."""
    rates: Rates
    """... and its motion, at which they are linearised."""
    rate_sds: Float64[Array, "rate"]
    """Standard deviations of the rates by their prior; empty if the ring is still or all rows are of one instant."""
    rate_deviations: Float64[Array, "rate"]
    """The rates in these standard deviations."""
    at: RingPrediction
    residual: Float64[Array, "row"]
    jacobian: Float64[Array, "row step=7"]
    """Derivatives by the ring's step."""
    wrt_rates: Float64[Array, "row rate"]
    """Derivatives by the rates: velocity of the ring's centre, and angular velocities about its inward axis and about
    the axis along its face. No columns for a still ring."""
    wrt_camera: Float64[Array, "row error"]
    """Derivatives by the mount's parameters (`Mount.uncertain`); no columns for a camera at rest."""
    observations: Observations
    data_rows: int
    """Number of residuals before those of the prior."""


class FixedColumns(NamedTuple):
    """Derivatives of the residuals with respect to common errors, evaluated once, near the solution."""

    rig: Float64[Array, "row parameter"] | None
    """Derivatives by the rig's parameters, in their own units; None if the rig counts as exact."""
    form: Float64[Array, "row amplitude"] | None
    """Derivatives by the amplitudes of the ring's form, in metres; None for a perfect ring."""
    slope: Float64[Array, "row"] | None
    """Derivatives by the slope of the face; None if it is flat."""
    camera: Float64[Array, "row parameter"]
    """Derivatives by the mount's parameters, in their own units."""
    mean_ray_wrt_rig: Float64[Array, "xy=2 error"]
    """Derivatives of the mean of the predicted break points by the rig's errors (in sigmas), for a fixed ring."""
    columns: Float64[Array, "row error"]
    """Derivatives by the errors of rig, form, mount and visible edges, in standard deviations."""
    edge_errors: int
    """Number of columns by errors of visible edges, which are the last ones."""


class LinearProblem(NamedTuple):
    """The problem linearised at a ring."""

    residuals: Residuals
    fixed: FixedColumns | None
    """None if the ring is not near the solution."""
    remaining: Float64[Array, "row"]
    """What is left of the residuals by common errors that are known."""


PARAMETERS = len(STEP)

MIN_SIGMA_PX = 1e-4
"""Lower bound of all standard deviations: smaller ones would make the normal equations ill-conditioned."""

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
    rows = np.concatenate([*[factor.linearized(at) for factor, _ in observations.blocks], prior.rows(at)])
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
    possible = 0.0 < depth_m < TARGET_DISTANCE_M.highest and abs(moved.curvature) * RING_RADIUS_M.lowest < 1.0
    if not (possible and all(map(isfinite, step.tolist()))):
        raise np.linalg.LinAlgError("the iteration diverges")
    if len(rate_step):
        along = rates_along(arcs, rates) + rate_step * residuals.rate_sds
        rates = Rates(along[:3], along[3:] @ moved.axes[:2])
    predicted = residuals.residual + residuals.jacobian @ step + residuals.wrt_rates @ (rate_step * residuals.rate_sds)
    return residuals._replace(
        arcs=moved, rates=rates, rate_deviations=residuals.rate_deviations + rate_step, residual=predicted
    )
