"""The measurement of a ring in information form, without priors, and the evidence for errors of the rig.

Sections 9 and 11 of ringpose-method(7).
"""

from math import sqrt

import numpy as np

from ringpose.estimate.covariance import Quantities
from ringpose.estimate.factors.prior import Prior
from ringpose.estimate.linearization import PARAMETERS
from ringpose.estimate.measurements import Measurements
from ringpose.estimate.nuisance import FACE_SLOPE, FORM_PARAMETERS, form_amplitude_m, rig_errors, rig_jacobian
from ringpose.estimate.ring_estimate import STRIPES_OF_A_PLANE, Estimate
from ringpose.estimate.solver import RIDGE
from ringpose.geometry.ring import public_wrt_rates
from ringpose.types.arrays import Array, Float64
from ringpose.types.assumptions import TYPICAL_STABILITY
from ringpose.types.pose import MEASURED_PARAMETERS, LinearizationPoint, PlaneEvidence, RingMeasurement

POSE, RATES = slice(PARAMETERS), slice(PARAMETERS, len(MEASURED_PARAMETERS))
"""Columns of `MEASURED_PARAMETERS`."""


def ring_measurement(estimate: Estimate, measured: Measurements, values: Quantities) -> RingMeasurement:
    """The square root of the shot's own information on the twelve parameters and the common errors, at t_0.

    The correlated errors of visible edge points are noise of this shot alone: they are eliminated first, with their
    prior, as the leading columns of the QR factorization.
    """
    rows, arcs = estimate.residuals.data_rows, estimate.arcs
    jacobian = _public_jacobian(estimate, values)[:rows]
    errors = rig_errors(measured.rig, estimate.prior.assumptions.stability)
    if estimate.residuals.wrt_rates.size:
        wrt_rates = estimate.residuals.wrt_rates[:rows].copy()
        wrt_rates[:, 3:] = wrt_rates[:, 3:] @ arcs.axes[:2] @ values.basis.T
    else:  # of a ring that is assumed to be still, a rate moves it by (t - t_0) times its derivative, Eq. (8.2)
        time_s = measured.times_s(measured.stamp_s)
        wrt_rates = time_s[:, None] * (jacobian @ public_wrt_rates(values.normal, values.center_m, values.basis))
    empty = np.zeros((rows, 0))
    wrt_rig = empty if estimate.fixed.rig is None else estimate.fixed.rig[:rows]
    wrt_form = empty if estimate.fixed.form is None else estimate.fixed.form[:rows]
    wrt_slope = empty if estimate.fixed.slope is None else estimate.fixed.slope[:rows, None]
    wrt_camera = estimate.fixed.camera[:rows]
    own = estimate.fixed.columns[:rows, estimate.fixed.columns.shape[1] - estimate.fixed.edge_errors :]
    residual = estimate.residuals.residual[:rows]

    # z - h(x) = r falls by -J dx: the derivative of the prediction h is minus that of the residual
    columns = np.concatenate(
        [own, jacobian, wrt_rates, wrt_rig, wrt_form, wrt_slope, wrt_camera, -residual[:, None]], axis=1
    )
    whitened = -columns * np.sqrt(estimate.weights[:rows])[:, None]
    whitened = whitened[measured.of_first_arc]  # between two arcs a track would find its place where nothing was seen
    count = own.shape[1]
    prior = np.eye(count, whitened.shape[1])
    triangle = np.linalg.qr(np.concatenate([prior, whitened]), mode="r")
    return RingMeasurement(
        linearized_at=LinearizationPoint(
            center_m=values.center_m,
            normal=values.normal,
            radius_inner_m=float(values.radius_m[0]),
            radius_outer_m=float(values.radius_m[1]),
            velocity_m_s=estimate.rates.velocity_m_s,
            rate_rad_s=estimate.rates.rate_rad_s,
        ),
        nuisance_parameters=(
            *(() if errors is None else errors.parameters),
            *(() if estimate.fixed.form is None else FORM_PARAMETERS),
            *(() if estimate.fixed.slope is None else (FACE_SLOPE,)),
            *(() if measured.camera is None else measured.camera.mount.uncertain),
        ),
        square_root=np.asarray(triangle)[count:, count:],
        degrees_of_freedom=estimate.degrees_of_freedom,
        chi2=estimate.chi2,
        camera_motion="none" if measured.camera is None else "robot_poses",
    )


def prior_rows(estimate: Estimate, prior: Prior, values: Quantities) -> Float64[Array, "row 13"] | None:
    """The rows [J, z - h] of the weak priors, in the twelve parameters; None without weak priors.

    The rows of assumed radii, which the record states separately, come first and are left out.
    """
    radii = 0 if prior.radii is None else int(np.isfinite(prior.radii.radius_m).sum())
    first = estimate.residuals.data_rows + radii
    if first == len(estimate.residuals.residual):
        return None
    jacobian = -_public_jacobian(estimate, values)[first:]
    residual = estimate.residuals.residual[first:, None]
    return np.concatenate([jacobian, np.zeros((len(jacobian), len(MEASURED_PARAMETERS) - 7)), residual], axis=1)


def _public_jacobian(estimate: Estimate, values: Quantities) -> Float64[Array, "row parameter=7"]:
    """Derivatives of the residuals by the seven parameters of a pose."""
    jacobian: Float64[Array, "row parameter=7"] = np.linalg.solve(
        values.jacobian[:7].T, estimate.residuals.jacobian.T
    ).T
    return jacobian


def plane_evidence(estimate: Estimate, measured: Measurements) -> PlaneEvidence | None:
    """What a shot shows about the rig's parameters; None if it leaves parameters of the ring open.

    These are the rows A q = y of the QR factor that are left when ring, rates, form and the errors of visible edges are
    eliminated with their priors: the Schur complement of section 9. The form is among q, too: where shots show the same
    arc, they have it in common.
    """
    if estimate.prior.regularize_about is not None or len(measured.stripes) <= STRIPES_OF_A_PLANE:
        return None
    errors = rig_errors(measured.rig, TYPICAL_STABILITY)
    if errors is None:
        return None
    residuals, rates = estimate.residuals, len(estimate.residuals.rate_sds)
    of_rig = rates + estimate.fixed.mean_ray_wrt_rig.shape[1]
    own = np.delete(estimate.nuisance, range(rates, of_rig), axis=1)
    assumed = rig_errors(measured.rig, estimate.prior.assumptions.stability)
    wrt_rig = estimate.fixed.rig
    if wrt_rig is None or assumed is None or assumed.parameters != errors.parameters:
        wrt_rig, _ = rig_jacobian(residuals, errors)
    parameters, common = errors.parameters, [wrt_rig]
    if estimate.fixed.form is not None:
        parameters += FORM_PARAMETERS
        common.append(form_amplitude_m(estimate.prior.assumptions.ring_tolerance_m) * estimate.fixed.form)
    rows = np.concatenate([residuals.jacobian, own, *common, -residuals.residual[:, None]], axis=1)
    eliminated = PARAMETERS + own.shape[1]
    prior = np.zeros((eliminated, rows.shape[1]))
    diagonal = range(eliminated)
    prior[diagonal, diagonal] = np.concatenate([np.full(PARAMETERS, sqrt(RIDGE)), np.ones(own.shape[1])])
    prior[PARAMETERS : PARAMETERS + rates, -1] = -residuals.rate_deviations
    triangle = np.linalg.qr(np.concatenate([prior, np.sqrt(estimate.weights)[:, None] * rows]), mode="r")
    return PlaneEvidence(
        parameters=parameters,
        rows=np.asarray(triangle)[eliminated:, eliminated:],
        normal=estimate.arcs.axes[2],
        place_m=estimate.arcs.origin,
    )
