"""Cramér-Rao bounds: the smallest errors that a rig, a ring and its place allow (ringpose-method(7), section 14).

The Fisher information is that of the measurement in information form (section 9) at the true ring, computed from
features without errors that have the covariances of detected ones. Errors of the rig are nuisance parameters, whose
prior is the covariance in rig.yaml plus that of its stability.
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from ringpose.estimate.covariance import GRASP_UNKNOWN_FROM_M, WEAK_SD, exceeds_sd
from ringpose.estimate.nuisance import covariance_root
from ringpose.geometry.ring import normal_and_center
from ringpose.types.arrays import Array, Float64
from ringpose.types.pose import MEASURED_PARAMETERS, PoseLine, PoseResult
from ringpose.types.rig import Rig

_POSE = 7
"""Number of the ring's own parameters, the first of `MEASURED_PARAMETERS`; its rates, which follow, are zero."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bound:
    """Smallest covariances of an unbiased estimator, camera frame, for a ring without motion."""

    parameters: Float64[Array, "7 7"]
    """Covariance of the first seven `MEASURED_PARAMETERS`."""
    center_m2: Float64[Array, "3 3"]

    @property
    def center_sd_m(self) -> float:
        """Root of the mean square length of the centre's error."""
        return sqrt(float(np.trace(self.center_m2)))

    @property
    def normal_sd_rad(self) -> float:
        """Root of the mean square angle of the normal's error."""
        return sqrt(float(np.trace(self.parameters[:2, :2])))

    @property
    def radius_outer_sd_m(self) -> float:
        """Standard deviation of the outer radius."""
        return sqrt(float(self.parameters[6, 6]))

    @property
    def standard_deviations(self) -> dict[str, float]:
        """The three standard deviations of this bound, keyed by the names of the errors that they bound."""
        return {
            "center_m": self.center_sd_m,
            "normal_rad": self.normal_sd_rad,
            "radius_outer_m": self.radius_outer_sd_m,
        }


def determined_quantities(line: PoseLine, bound: Bound | None, radius_inner_m: float) -> tuple[str, ...]:
    """Which of `center` and `grasp` a shot determines within the limits from which `pose` flags them.

    `line` is the pose from features without errors: the grasp point is also determined where a bound of all parameters
    does not exist, by its stated covariance.
    """
    grasp_m2 = None if line.pose is None else line.pose.covariance_grasp_m2
    of_center = bound is not None and not exceeds_sd(bound.center_m2, WEAK_SD * radius_inner_m)
    of_grasp = grasp_m2 is not None and not exceeds_sd(grasp_m2, GRASP_UNKNOWN_FROM_M)
    return tuple(name for name, is_known in (("center", of_center), ("grasp", of_grasp)) if is_known)


def cramer_rao(line: PoseLine | PoseResult, rig: Rig) -> Bound | None:
    """The Cramér-Rao bound of a ring from its pose, estimated from features without errors.

    None if the features do not determine every parameter of the ring.

    `rig` is the rig by which the ring was measured: its covariance is the prior of the nuisance parameters; parameters
    that the covariance does not name count as exact. The prior of the radii is that of the pose.
    """
    measurement, priors = line.measurement, line.priors
    if measurement is None or priors is None or priors.regularization is not None:
        return None  # weak priors have moved the ring away from the true one
    count = len(MEASURED_PARAMETERS)
    names = measurement.nuisance_parameters
    # R R^T is the prior covariance of the nuisance parameters; rows of those that count as exact are zero
    root = np.zeros((len(names), 0)) if rig.covariance is None else covariance_root(rig.covariance.of(names))
    rows, errors = measurement.square_root, root.shape[1]
    whitened = np.concatenate([rows[:, :_POSE], rows[:, count:-1] @ root], axis=1)
    information = whitened.T @ whitened
    information[_POSE:, _POSE:] += np.eye(errors)
    if priors.radius is not None:
        sds_m = np.array([priors.radius.inner_sd_m, priors.radius.outer_sd_m])
        given = np.isfinite([priors.radius.inner_m, priors.radius.outer_m])
        information[[5, 6], [5, 6]] += np.where(given, 1.0 / sds_m**2, 0.0)
    diagonal = information.diagonal()
    if not bool((diagonal > 0).all()):
        return None
    scale = 1.0 / np.sqrt(diagonal)
    scaled = information * scale[:, None] * scale
    variances, axes = np.linalg.eigh(scaled)
    if variances[0] <= 1e-14 * variances[-1]:
        return None
    covariance = (axes / variances) @ axes.T * scale[:, None] * scale
    parameters = covariance[:_POSE, :_POSE]
    at = measurement.linearized_at
    _, center_wrt = normal_and_center(at.normal, at.center_m)
    return Bound(parameters=parameters, center_m2=center_wrt @ parameters[:5, :5] @ center_wrt.T)
