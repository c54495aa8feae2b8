"""Detection of a rig that has changed since its calibration, from the residuals of a stream of shots.

Noise leaves different residuals in each shot; a light plane that has moved leaves the same ones every time. With three
stripes a single shot hardly determines which plane has moved; shots of different poses do. Each shot contributes the
score and the information of its likelihood with respect to every plane's errors.
"""

from dataclasses import dataclass, replace

import numpy as np

from ringpose.estimate.measurements import Measurements
from ringpose.estimate.nuisance import light_plane_bases
from ringpose.estimate.residuals import PARAMETERS
from ringpose.estimate.solver import Estimate
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.options import Method
from ringpose.types.pose import PlaneEvidence, PoseFlag, PoseLine
from ringpose.types.rig import Rig

FORGETTING = 0.98
"""Factor on the accumulated evidence with each new shot: about fifty shots count."""

DRIFTED_FROM = 3.0
"""Error of a plane, in the standard deviations that a single shot has for it, from which the plane counts as drifted.

Noise that is identical in all shots (a target at rest) gives figures around 1; noise that is independent in each of n
shots gives 1 / sqrt(n).
"""

SHOTS_NEEDED = 10.0
"""No warning is issued before this number of shots."""

CLEARLY = 16.0
"""Margin in chi-squared by which one plane's error must explain more than any other's for the plane to be named."""

DOUBTED_FROM = 0.5
"""Share of shots with a rejected stripe, label or radius from which the rig is reported as changed."""

CONTRADICTORY = PoseFlag.STRIPE_REJECTED | PoseFlag.ASSIGNMENT_AMBIGUOUS | PoseFlag.INCONSISTENT
"""Flags of a shot whose stripes do not fit one ring as they were assigned."""

_NOTHING = 1e-9
"""Share of the largest eigenvalue below which a combination of a plane's errors counts as unobserved."""


class DriftMonitor:
    """Accumulates the evidence of a stream of pose lines and warns once of each drift."""

    def __init__(self, names: tuple[str, ...], method: Method) -> None:
        self._names = names
        self._method = method
        self._health = new_health(len(names))
        self._warned = False

    def update(self, line: PoseLine) -> tuple[PoseLine, str | None]:
        """The line with the lasers' health, and a warning where a drift is detected for the first time.

        Poses that contradict the given radii, and lines without a pose, contribute no evidence; a shot with a rejected
        part, or whose stripes contradict each other, counts as doubted. The paper's methods have no residuals to
        accumulate: their lines stay as they are.
        """
        if self._method is not Method.ML:
            return line, None
        new_warning = None
        contradictory = line.pose is None and bool(line.flags & CONTRADICTORY)
        if contradictory or (line.pose is not None and PoseFlag.RADIUS_INCONSISTENT not in line.flags):
            self._health = health_after(self._health, line.plane_evidence)
            warning = drift_warning(self._health, self._names)
            new_warning = None if self._warned else warning
            self._warned = warning is not None  # a rig that has recovered may be warned of again
        figures = dict(zip(self._names, self._health.figure.tolist(), strict=True))
        return replace(line, rig_health=figures), new_warning


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigHealth:
    """Accumulated evidence for errors of the light planes (two tilts and a distance each)."""

    score: Float64[Array, "laser parameter=3"]
    information: Float64[Array, "laser parameter=3 parameter=3"]
    shots: float
    """Effective number of shots; older ones count less."""
    doubted: float = 0.0
    """Effective number of shots with a rejected part, which contribute no evidence."""

    @property
    def explained(self) -> Float64[Array, "laser"]:
        """Chi-squared that an error of each plane explains, score^T information^-1 score; NaN if unobserved."""
        chi2 = np.full(len(self.score), np.nan)
        for laser, (score, information) in enumerate(zip(self.score, self.information, strict=True)):
            scale = np.sqrt(np.diag(information))
            if (scale > 0).all():
                variance, axes = np.linalg.eigh(information / scale / scale[:, None])
                kept = variance > _NOTHING * variance[-1]
                chi2[laser] = float(np.sum((axes.T @ (score / scale))[kept] ** 2 / variance[kept]))
        return chi2

    @property
    def figure(self) -> Float64[Array, "laser"]:
        """Error of each plane in the standard deviations that a single shot has for it: small is good."""
        figure: Float64[Array, "laser"] = np.sqrt(self.explained / max(self.shots, 1.0))
        return figure


def new_health(lasers: int) -> RigHealth:
    """The state before the first shot."""
    return RigHealth(score=np.zeros((lasers, 3)), information=np.zeros((lasers, 3, 3)), shots=0.0)


def health_after(health: RigHealth, evidence: PlaneEvidence | None) -> RigHealth:
    """The state after one more shot; `evidence` is None if a part of the shot was rejected."""
    kept = RigHealth(
        score=FORGETTING * health.score,
        information=FORGETTING * health.information,
        shots=FORGETTING * health.shots,
        doubted=FORGETTING * health.doubted + float(evidence is None),
    )
    if evidence is None:
        return kept
    return replace(
        kept,
        score=kept.score + evidence.score,
        information=kept.information + evidence.information,
        shots=kept.shots + float(evidence.information.any()),
    )


def drift_warning(health: RigHealth, names: tuple[str, ...]) -> str | None:
    """The warning about a rig that has changed; None if it has not, or if there are too few shots to decide."""
    shots = health.shots + health.doubted
    if shots < SHOTS_NEEDED:
        return None
    figure = health.figure
    observed = np.flatnonzero(figure == figure)
    if len(observed) and figure[observed].max() > DRIFTED_FROM:
        return _drifted_plane(health, observed, names)
    if health.doubted > DOUBTED_FROM * shots:
        share = 100.0 * health.doubted / shots
        return f"{share:.0f} % of the last shots contradict one ring: a light plane or the camera has moved"
    return None


def _drifted_plane(health: RigHealth, observed: Int64[Array, "n"], names: tuple[str, ...]) -> str:
    """Names the plane whose error explains most, if no other explains nearly as much.

    If the camera has moved against all planes together, the error of one plane explains that nearly as well.
    """
    chi2 = health.explained
    worst = int(observed[np.argmax(chi2[observed])])
    off = f"{health.figure[worst]:.1f} sigma"
    if bool((chi2[observed[observed != worst]] + CLEARLY < chi2[worst]).all()):
        return f"the light plane of laser {names[worst]} has moved, or the camera: its stripe is off by {off}"
    return f"the stripes disagree by {off}: a light plane or the camera has moved"


def plane_evidence(estimate: Estimate, measured: Measurements, rig: Rig) -> PlaneEvidence:
    """Score and information of each light plane's tilts and distance, from the residuals of the lines.

    With S the covariance of a whitened line (1 plus the contribution of the rig's calibration errors), C = S - J N^-1
    J^T that of its residual r, and D the derivative of r with respect to the plane: score D^T S^-1 r, information
    D^T S^-1 C S^-1 D.
    """
    lasers, count = len(rig.lasers.names), len(measured.lines.laser)
    score, information = np.zeros((lasers, 3)), np.zeros((lasers, 3, 3))
    if estimate.regularized or not count:
        return PlaneEvidence(score=score, information=information)
    jacobian = estimate.residuals.jacobian[: 2 * count].reshape(count, 2, PARAMETERS)
    covariance = np.eye(2) - jacobian @ estimate.inverse @ jacobian.swapaxes(1, 2)
    basis, stripes = light_plane_bases(rig)[np.repeat(measured.lines.laser, 2)], estimate.residuals.stripes
    y_wrt_tilts = (basis @ stripes.y_wrt_light_normal[: 2 * count, :, None])[:, :, 0]
    y_wrt_plane = np.column_stack([y_wrt_tilts, stripes.y_wrt_light_distance[: 2 * count]]).reshape(count, 2, 3)
    weighted = -measured.lines.whitening @ y_wrt_plane  # S^-1 D
    if estimate.nuisance.size:
        wrt_nuisance = estimate.nuisance[: 2 * count].reshape(count, 2, -1)
        added = wrt_nuisance @ wrt_nuisance.swapaxes(1, 2)
        covariance, weighted = covariance + added, np.linalg.solve(np.eye(2) + added, weighted)
    residual = estimate.residuals.residual[: 2 * count].reshape(count, 2, 1)
    score[measured.lines.laser] = (weighted * residual).sum(axis=1)
    information[measured.lines.laser] = weighted.swapaxes(1, 2) @ covariance @ weighted
    return PlaneEvidence(score=score, information=information)
