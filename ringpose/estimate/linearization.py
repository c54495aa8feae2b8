"""Records of the linearised problem: the factors of a shot, their residuals at a ring, and derivatives of these.

The factors are defined in `ringpose.estimate.factors`, the ring in `ringpose.geometry.ring`.
"""

from typing import TYPE_CHECKING, NamedTuple

from ringpose.geometry.camera_motion import CameraMotion
from ringpose.geometry.ring import Rates, RingArcs, RingPrediction, RingSamples
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.rig import Rig

if TYPE_CHECKING:
    from ringpose.estimate.factors import Factor, PointFactor


class Derivatives(NamedTuple):
    """Derivatives of the residuals of one kind, before its whitening; None where they do not depend on it."""

    ordinate: Float64[Array, "#row 1"] | None = None
    """By the ordinate of the predicted stripe at the row's ray."""
    distance: Float64[Array, "#row 1"] | None = None
    """By the distance of the row's ray from the row's edge."""


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
