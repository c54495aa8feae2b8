"""What each stripe leaves over, as evidence for an error of its light plane."""

import numpy as np

from ringpose.pose.likelihood import Fit
from ringpose.pose.measurements import Measurements
from ringpose.pose.rig_errors import light_plane_bases
from ringpose.pose.ring_model import PARAMETERS
from ringpose.types.pose import PlaneEvidence
from ringpose.types.rig import Rig


def plane_evidence(fit: Fit, measured: Measurements, rig: Rig) -> PlaneEvidence:
    """Score and information of each light plane's tilts and distance.

    With S the covariance of a line (1, in standard deviations, and what the rig's known errors add), C = S - J N^-1 J^T
    that of its residual and D the residual's derivative by the plane: score D^T S^-1 residual, information
    D^T S^-1 C S^-1 D.
    """
    lasers, count = len(rig.lasers.names), len(measured.lines.laser)
    score, information = np.zeros((lasers, 3)), np.zeros((lasers, 3, 3))
    if fit.weak or not count:
        return PlaneEvidence(score=score, information=information)
    inverse = fit.inverse
    by_state = fit.rows.by_state[: 2 * count].reshape(count, 2, PARAMETERS)
    left = np.eye(2) - by_state @ inverse @ by_state.swapaxes(1, 2)
    basis = light_plane_bases(rig)[measured.lines.laser]
    rays = fit.rows.sights.rays[: 2 * count].reshape(count, 2, 3)
    steepness = fit.rows.sights.steepness[: 2 * count : 2, None, None]
    by_plane = np.concatenate([rays @ basis.swapaxes(1, 2), -(rays @ fit.state.plane)[:, :, None]], axis=-1)
    weighted = measured.lines.whitening @ by_plane / steepness
    if fit.by_rig is not None:
        by_rig = fit.by_rig[: 2 * count].reshape(count, 2, -1)
        more = by_rig @ by_rig.swapaxes(1, 2)
        left, weighted = left + more, np.linalg.solve(np.eye(2) + more, weighted)
    score[measured.lines.laser] = (weighted * fit.rows.residual[: 2 * count].reshape(count, 2, 1)).sum(axis=1)
    information[measured.lines.laser] = weighted.swapaxes(1, 2) @ left @ weighted
    return PlaneEvidence(score=score, information=information)
