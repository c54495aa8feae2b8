"""The measurement of a shot in information form, without priors (ringpose-method(7), section 9)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringpose.estimate.measurements import Measurements
from ringpose.estimate.nuisance import FORM_PARAMETERS, RigErrors, edge_jacobian
from ringpose.estimate.residuals import Estimate, Prior
from ringpose.geometry.ring import normal_and_center, public_wrt_rates, public_wrt_step
from ringpose.geometry.rotations import tilt_basis
from ringpose.types.arrays import Array, Float64
from ringpose.types.pose import MEASURED_PARAMETERS, LinearizationPoint, RingMeasurement

POSE, RATES = slice(0, 7), slice(7, 12)
"""Columns of `MEASURED_PARAMETERS`."""


def ring_measurement(estimate: Estimate, measured: Measurements, errors: RigErrors | None) -> RingMeasurement:
    """The square root of the shot's own information on the twelve parameters and the common errors, at t_0.

    The correlated errors of visible edge points are noise of this shot alone: they are eliminated first, with their
    prior, as the leading columns of the QR factorization.
    """
    rows, arcs = estimate.residuals.data_rows, estimate.arcs
    jacobian = _public_jacobian(estimate)[:rows]
    if estimate.residuals.wrt_rates.size:
        wrt_rates = estimate.residuals.wrt_rates[:rows].copy()
        wrt_rates[:, 3:] = wrt_rates[:, 3:] @ arcs.axes[:2] @ tilt_basis(arcs.normal).T
    else:  # of a ring that is assumed to be still, a rate moves it by (t - t_0) times its derivative, Eq. (8.2)
        time_s = measured.times_s(measured.stamp_s)
        wrt_rates = time_s[:, None] * (jacobian @ public_wrt_rates(arcs.normal, arcs.center))
    empty = np.zeros((rows, 0))
    wrt_rig = empty if estimate.fixed.rig is None else estimate.fixed.rig[:rows]
    wrt_form = empty if estimate.fixed.form is None else estimate.fixed.form[:rows]
    wrt_camera = estimate.fixed.camera[:rows]
    own = edge_jacobian(estimate.residuals, measured)[:rows] if len(measured.edges.edge) else np.zeros((rows, 0))
    residual = estimate.residuals.residual[:rows]

    # z - h(x) = r falls by -J dx: the derivative of the prediction h is minus that of the residual
    columns = np.concatenate([own, jacobian, wrt_rates, wrt_rig, wrt_form, wrt_camera, -residual[:, None]], axis=1)
    whitened = -columns * np.sqrt(estimate.weights[:rows])[:, None]
    count = own.shape[1]
    prior = np.eye(count, whitened.shape[1])
    triangle = np.linalg.qr(np.concatenate([prior, whitened]), mode="r")
    return RingMeasurement(
        linearized_at=LinearizationPoint(
            center_m=arcs.center,
            normal=arcs.normal,
            radius_inner_m=float(arcs.radius_m[0]),
            radius_outer_m=float(arcs.radius_m[1]),
            velocity_m_s=estimate.rates.velocity_m_s,
            rate_rad_s=estimate.rates.rate_rad_s,
        ),
        nuisance_parameters=(
            *(() if errors is None else errors.parameters),
            *(() if estimate.fixed.form is None else FORM_PARAMETERS),
            *(() if measured.camera is None else measured.camera.mount.uncertain),
        ),
        square_root=np.asarray(triangle)[count:, count:],
        degrees_of_freedom=estimate.degrees_of_freedom,
        chi2=estimate.chi2,
        camera_motion="none" if measured.camera is None else "robot_poses",
    )


def prior_rows(estimate: Estimate, prior: Prior) -> Float64[Array, "row 13"] | None:
    """The rows [J, z - h] of the weak priors, in the twelve parameters; None without weak priors.

    The rows of assumed radii, which the record states by themselves, come first and are left out.
    """
    radii = 0 if prior.radii is None else int(np.isfinite(prior.radii.radius_m).sum())
    first = estimate.residuals.data_rows + radii
    if first == len(estimate.residuals.residual):
        return None
    jacobian = -_public_jacobian(estimate)[first:]
    residual = estimate.residuals.residual[first:, None]
    return np.concatenate([jacobian, np.zeros((len(jacobian), len(MEASURED_PARAMETERS) - 7)), residual], axis=1)


def _public_jacobian(estimate: Estimate) -> Float64[Array, "row parameter=7"]:
    """Derivatives of the residuals by the seven parameters of a pose."""
    jacobian: Float64[Array, "row parameter=7"] = np.linalg.solve(
        public_wrt_step(estimate.arcs).T, estimate.residuals.jacobian.T
    ).T
    return jacobian


def relinearized(measurement: RingMeasurement, point: LinearizationPoint) -> RingMeasurement:
    """The measurement as one of increments about another ring nearby, so that shots can be combined.

    With the old increments x = a + T x', R x - z becomes R T x' - (z - R a). Basis vectors are carried from one normal
    to the other by the smallest rotation.
    """
    offset, jacobian = increments_between(measurement.linearized_at, point)
    count = len(MEASURED_PARAMETERS)
    columns = measurement.square_root.copy()
    columns[:, -1] -= columns[:, :count] @ offset
    columns[:, :count] = columns[:, :count] @ jacobian
    return replace(measurement, linearized_at=point, square_root=np.asarray(np.linalg.qr(columns, mode="r")))


def increments_between(
    origin: LinearizationPoint, point: LinearizationPoint
) -> tuple[Float64[Array, "parameter=12"], Float64[Array, "parameter=12 parameter=12"]]:
    """The increments about `origin` at which the ring is `point`, and their derivatives by increments about `point`.

    Angular velocities are those across the normal; their derivatives by the tilts are neglected.
    """
    basis, normal, center_m = tilt_basis(origin.normal), point.normal, point.center_m
    cosine = float(origin.normal @ normal)
    tilts = basis @ normal / cosine
    # e(n) = e - (e . n) (n_0 + n) / (1 + n_0 . n): the basis after the smallest rotation from n_0 to n
    both, share = origin.normal + normal, (basis @ normal) / (1.0 + cosine)
    carried = basis - np.outer(share, both)
    in_plane = carried @ center_m
    offset = np.concatenate(
        [
            tilts,
            [float(normal @ center_m - origin.normal @ origin.center_m)],
            in_plane - basis @ origin.center_m,
            [point.radius_inner_m - origin.radius_inner_m, point.radius_outer_m - origin.radius_outer_m],
            point.velocity_m_s - origin.velocity_m_s,
            carried @ point.rate_rad_s - basis @ origin.rate_rad_s,
        ]
    )
    normal_wrt, center_wrt = normal_and_center(normal, center_m)
    along, across = origin.normal @ normal_wrt, basis @ normal_wrt
    jacobian = np.eye(len(MEASURED_PARAMETERS))
    jacobian[:2, :5] = (across - np.outer(tilts, along)) / cosine
    jacobian[2, :5] = center_m @ normal_wrt + normal @ center_wrt
    jacobian[3:5, :5] = carried @ center_wrt - np.outer(share, center_m @ normal_wrt)
    jacobian[3:5, :5] -= (across - np.outer(share, along)) * float(both @ center_m) / (1.0 + cosine)
    jacobian[10:, 10:] = carried @ tilt_basis(normal).T
    return offset, jacobian


def solve_measurement(
    measurements: Sequence[RingMeasurement],
    prior_information: Float64[Array, "n n"],
    prior_vector: Float64[Array, "n"],
) -> tuple[Float64[Array, "n"], Float64[Array, "n n"]]:
    """Increments of parameters and nuisance parameters, and their covariance, from measurements and a prior.

    The measurements share linearisation point and nuisance parameters. Minimises
    sum |R [dx; dq] - z|^2 / 2 + [dx; dq]^T Lambda [dx; dq] / 2 - lambda^T [dx; dq], Eq. (9.1).
    """
    information, vector = prior_information.copy(), prior_vector.copy()
    for measurement in measurements:
        matrix, target = measurement.square_root[:, :-1], measurement.square_root[:, -1]
        information += matrix.T @ matrix
        vector += matrix.T @ target
    scale = 1.0 / np.sqrt(np.maximum(information.diagonal(), np.finfo(float).tiny))
    covariance = scale[:, None] * np.linalg.inv(information * scale[:, None] * scale) * scale
    return covariance @ vector, covariance
