"""Whether the rig still is as it was calibrated, from what the stripes leave over in shot after shot.

Noise leaves something else each time; a light plane that has moved leaves what its error would, always. With three
stripes a single shot hardly tells which plane it is; shots of different poses do.

What each stripe leaves over, as evidence for an error of its light plane.

What would make a pose better, in words.
"""

from dataclasses import dataclass, replace

import numpy as np

from ringpose.pose.covariance import standard_deviation
from ringpose.pose.measurements import Measurements
from ringpose.pose.nuisance import light_plane_bases
from ringpose.pose.residuals import PARAMETERS
from ringpose.pose.solver import Fit
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.pose import PlaneEvidence, PoseFlag, RingPose
from ringpose.types.rig import Rig

FORGETTING = 0.98
"""Share of what is known that is left after the next shot: about fifty shots count."""

DRIFTED_FROM = 3.0
"""A plane's error, in standard deviations of what one shot tells of it, from which it counts as drifted.

A figure around 1 is what noise gives that stays the same in all shots, as on a target that stands still; noise that
is new in each of n shots gives 1 / sqrt(n).
"""

SHOTS_NEEDED = 10.0
"""Fewer shots warn of nothing."""

CLEARLY = 16.0
"""By how many squared standard deviations one plane's error must explain more than another's to be the one to blame."""

DOUBTED_FROM = 0.5
"""Share of shots of which a stripe, its label or the radii had to be left out from which the rig is to blame."""

_NOTHING = 1e-9
"""Share of the largest eigenvalue under which a combination of a plane's errors is not seen at all."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigHealth:
    """What a stream of shots says about the light planes."""

    score: Float64[Array, "laser parameter=3"]
    information: Float64[Array, "laser parameter=3 parameter=3"]
    shots: float
    """That count, older ones less."""
    doubted: float = 0.0
    """Of which something had to be left out, so that they say nothing about the planes."""

    @property
    def explained(self) -> Float64[Array, "laser"]:
        """What a plane's own error explains, in squared standard deviations; NaN for one that nothing checks."""
        squares = np.full(len(self.score), np.nan)
        for laser, (score, information) in enumerate(zip(self.score, self.information, strict=True)):
            scale = np.sqrt(np.diag(information))
            if (scale > 0).all():
                variance, axes = np.linalg.eigh(information / scale / scale[:, None])
                kept = variance > _NOTHING * variance[-1]
                squares[laser] = float(np.sum((axes.T @ (score / scale))[kept] ** 2 / variance[kept]))
        return squares

    @property
    def figure(self) -> Float64[Array, "laser"]:
        """Each plane's error in standard deviations of what one shot tells of it: small is good."""
        figure: Float64[Array, "laser"] = np.sqrt(self.explained / max(self.shots, 1.0))
        return figure


def new_health(lasers: int) -> RigHealth:
    """Before the first shot."""
    return RigHealth(score=np.zeros((lasers, 3)), information=np.zeros((lasers, 3, 3)), shots=0.0)


def health_after(health: RigHealth, evidence: PlaneEvidence | None) -> RigHealth:
    """With one more shot; None for one of which something had to be left out."""
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
    """What to say about a rig that has changed; None while it is as calibrated, or too little is known."""
    shots = health.shots + health.doubted
    if shots < SHOTS_NEEDED:
        return None
    figure = health.figure
    known = np.flatnonzero(figure == figure)
    if len(known) and figure[known].max() > DRIFTED_FROM:
        return _where(health, known, names)
    if health.doubted > DOUBTED_FROM * shots:
        share = 100.0 * health.doubted / shots
        return f"{share:.0f} % of the last shots contradict one ring: a light plane or the camera has moved"
    return None


def _where(health: RigHealth, known: Int64[Array, "n"], names: tuple[str, ...]) -> str:
    """The plane whose error explains most, if none explains nearly as much.

    If the camera has moved against all planes alike, one of them explains that nearly as well.
    """
    squares = health.explained
    worst = int(known[np.argmax(squares[known])])
    off = f"{health.figure[worst]:.1f} sigma"
    if bool((squares[known[known != worst]] + CLEARLY < squares[worst]).all()):
        return f"the light plane of laser {names[worst]} has moved, or the camera: its stripe is off by {off}"
    return f"the stripes disagree by {off}: a light plane or the camera has moved"


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
    denominator = fit.rows.sights.denominator[: 2 * count : 2, None, None]
    by_plane = np.concatenate([rays @ basis.swapaxes(1, 2), -(rays @ fit.state.plane)[:, :, None]], axis=-1)
    weighted = measured.lines.whitening @ by_plane / denominator
    if fit.by_rig is not None:
        by_rig = fit.by_rig[: 2 * count].reshape(count, 2, -1)
        more = by_rig @ by_rig.swapaxes(1, 2)
        left, weighted = left + more, np.linalg.solve(np.eye(2) + more, weighted)
    score[measured.lines.laser] = (weighted * fit.rows.residual[: 2 * count].reshape(count, 2, 1)).sum(axis=1)
    information[measured.lines.laser] = weighted.swapaxes(1, 2) @ left @ weighted
    return PlaneEvidence(score=score, information=information)


RADIUS_SD_M = 0.0005
"""How well a radius that is looked up is known."""


def advice(pose: RingPose) -> str:
    """Which measurement would help most, and by how much; empty if nothing is weak."""
    if PoseFlag.NORMAL_WEAK in pose.flags:
        return "one stripe leaves the tilt about it open; bring a second one onto the ring, or step back"
    if PoseFlag.SIDE_UNKNOWN in pose.flags:
        return (
            "the centre may lie on either side; lasers farther apart or a longer distance would tell inner from outer"
        )
    if PoseFlag.CENTER_WEAK not in pose.flags:
        return ""
    if pose.covariance_center_m2 is None or pose.covariance is None:
        return "the centre is not determined; the ring's radius (--radius-outer, --ring) or visible edges would give it"
    now_mm, then_mm = (
        1000.0 * standard_deviation(each)
        for each in (pose.covariance_center_m2, center_with_radius(pose.covariance, pose))
    )
    help_ = "the ring's radius (--radius-outer, --ring) or visible edges would make it"
    if then_mm > 0.5 * now_mm:
        help_ = "only stripes farther apart on the face would help much; with the radius it is"
    return f"the centre is known to {now_mm:.1f} mm; {help_} {then_mm:.1f} mm"


def center_with_radius(covariance: Float64[Array, "7 7"], pose: RingPose) -> Float64[Array, "2 2"]:
    """Covariance of the centre in the ring's plane if the outer radius (the inner, if that was not seen) were known.

    Conditioning of a Gaussian on one of its parts.
    """
    radius = 6 if np.isfinite(pose.radius_outer_m) else 5
    own, mixed = covariance[3:5, 3:5], covariance[3:5, radius]
    conditioned: Float64[Array, "2 2"] = own - np.outer(mixed, mixed) / (covariance[radius, radius] + RADIUS_SD_M**2)
    return conditioned
