"""How far each laser's stripe is from where the rest of the shot puts the ring: what tells a drifted light plane."""

import numpy as np
from jaxtyping import Float64

from ringpose.pose.likelihood import RIDGE, Fit
from ringpose.pose.measurements import Measurements
from ringpose.pose.ring_model import PARAMETERS
from ringpose.types.arrays import Array

CHECKED_ABOVE = 1e-3
"""Share of a stripe's variance that the rest of the shot must check; two stripes alone agree with every plane."""

_MIDDLE_AND_SLOPE = np.array([[0.5, 0.5], [-1.0, 1.0]])


def stripe_deviation(fit: Fit, measured: Measurements, lasers: int) -> Float64[Array, "laser 2"]:
    """Middle and slope of each stripe's line minus what the rest of the shot predicts, in standard deviations.

    With C = S - J N^-1 J^T the covariance of a line's residual and S that of the line, the line minus its prediction
    without it is S C^-1 residual, with the covariance S C^-1 S. NaN for a laser without a line or without a check.
    """
    deviation = np.full((lasers, 2), np.nan)
    count = len(measured.lines.laser)
    if fit.weak or not count:
        return deviation
    inverse = np.linalg.inv(fit.normal_matrix + RIDGE * np.eye(PARAMETERS))
    by_state = fit.rows.by_state[: 2 * count].reshape(count, 2, PARAMETERS)
    line = np.broadcast_to(np.eye(2), (count, 2, 2))
    if fit.by_rig is not None:
        by_rig = fit.by_rig[: 2 * count].reshape(count, 2, -1)
        line = line + by_rig @ by_rig.swapaxes(1, 2)
    residual = line - by_state @ inverse @ by_state.swapaxes(1, 2)
    # a share of 1 is fully checked, 0 not at all
    share = np.linalg.eigvals(np.linalg.solve(line, residual)).real.min(axis=1)
    checked = share > CHECKED_ABOVE
    if not checked.any():
        return deviation
    to_pixels = _MIDDLE_AND_SLOPE @ np.linalg.inv(measured.lines.whitening[checked]) @ line[checked]
    healed = np.linalg.inv(residual[checked])
    value = (to_pixels @ healed @ fit.rows.residual[: 2 * count].reshape(count, 2, 1)[checked])[:, :, 0]
    variance = np.diagonal(to_pixels @ healed @ to_pixels.swapaxes(1, 2), axis1=1, axis2=2)
    deviation[measured.lines.laser[checked]] = value / np.sqrt(variance)
    return deviation
