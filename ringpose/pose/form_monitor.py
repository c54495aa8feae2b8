"""The form of the ring over a stream of shots (ringpose-method(7), section 12).

On the arc that one shot sees, a ring that is not round looks like a round ring with another radius, which depends on
the place of the arc: the radii of a stream of shots differ by more than their errors. A wave of order k and amplitude a
changes the radius that a short arc shows by up to (k^2 - 1) a: 8 a for order 3.
"""

from collections.abc import Sequence
from math import log, sqrt

import numpy as np

from ringpose.estimate.explanation import chi2_quantile
from ringpose.measure.status import with_findings
from ringpose.pose.drift import FALSE_ALARM_SIGMAS, SHOTS_KEPT, STREAM_SHOTS
from ringpose.types.arrays import Array, Float64
from ringpose.types.finding import Finding
from ringpose.types.pose import PoseLine

SAME_RING = 0.1
"""Relative difference of the mean radii up to which shots show the same ring: rings of other types differ by more."""

MIN_SHOTS = 4
"""Number of shots from which their radii are compared."""

_LIMIT_SIGMAS = sqrt(FALSE_ALARM_SIGMAS**2 + 2.0 * log(STREAM_SHOTS))
"""Limit of the test after each shot, as a normal quantile (Bonferroni, as for the planes)."""

_EDGES = 2

_MAX_SQUARED_DEVIATION = chi2_quantile(_EDGES, FALSE_ALARM_SIGMAS)
"""What a shot contributes at most: one of a thousand right shots deviates more."""

_REFITS = 3
"""Number of times that a ring is fitted to the shots that agree with it."""


class FormMonitor:
    """Compares the radii of the last shots of a ring, and flags the following ones if they differ."""

    def __init__(self) -> None:
        self._shots: list[tuple[Float64[Array, "edge=2"], Float64[Array, "edge=2 edge=2"]]] = []
        self._reason = ""

    def update(self, line: PoseLine) -> tuple[PoseLine, str | None]:
        """The line with the flags of a form that earlier shots have shown, and a warning where one is detected.

        Radii that are given, or assumed from the catalogue, show nothing; nor do shots that have a flag of their own.
        """
        pose = line.pose
        if pose is None or pose.covariance is None or line.priors is None or line.priors.radius is not None:
            return line, None
        radius_m = np.array([pose.radius_inner_m, pose.radius_outer_m])
        flagged = self._flagged(line)
        if line.status != "ok" or not bool(np.isfinite([*radius_m, *pose.covariance[5:7, 5:7].ravel()]).all()):
            return flagged, None
        to_curvature = -1.0 / radius_m**2  # the errors of curvatures are Gaussian even where those of radii are not
        covariance = pose.covariance[5:7, 5:7] * to_curvature[:, None] * to_curvature
        same = [each for each in self._shots if abs(each[0] * radius_m - 1.0).max() < SAME_RING]
        self._shots = [*(same if same else []), (1.0 / radius_m, covariance)][-SHOTS_KEPT:]
        known, self._reason = self._reason, self._finding()
        return flagged, self._reason if self._reason and not known else None

    def _flagged(self, line: PoseLine) -> PoseLine:
        if not self._reason or line.pose is None:
            return line
        return with_findings(line, Finding.RADII_DIFFER, self._reason)

    def _finding(self) -> str:
        """The reason why the ring is not round; empty if the radii agree."""
        count = len(self._shots)
        if count < MIN_SHOTS or _disagreement(self._shots) <= chi2_quantile(_EDGES * (count - 1), _LIMIT_SIGMAS):
            return ""
        spread_mm = 1e3 * float(np.std([1.0 / curvature[1] for curvature, _ in self._shots]))
        return (
            f"the ring's radius differs between shots by {spread_mm:.2g} mm (standard deviation), more than its errors "
            "allow: the ring is not round (give --ring-tolerance), or the rig has changed"
        )


def _disagreement(shots: Sequence[tuple[Float64[Array, "edge=2"], Float64[Array, "edge=2 edge=2"]]]) -> float:
    """Sum of the squared deviations of the curvatures from one ring, each in units of its variance and bounded.

    The ring is the one with the least sum of those found from the curvatures of each shot. A few wrong shots, however
    far they are off, are not evidence: of a ring that is not round, most shots deviate.
    """
    curvature = np.stack([each for each, _ in shots])
    information = np.linalg.inv([covariance for _, covariance in shots])
    weighted = (information @ curvature[..., None])[..., 0]

    def chi2_of(rings: Float64[Array, "ring edge=2"]) -> Float64[Array, "ring shot"]:
        error = curvature - rings[:, None]
        chi2: Float64[Array, "ring shot"] = np.einsum("rsi,sij,rsj->rs", error, information, error)
        return chi2

    chi2 = chi2_of(curvature)
    for _ in range(_REFITS):
        agrees = chi2 < _MAX_SQUARED_DEVIATION
        normal_matrix = np.einsum("rs,sij->rij", agrees, information)
        chi2 = chi2_of(np.linalg.solve(normal_matrix, (agrees @ weighted)[..., None])[..., 0])
    return float(np.minimum(chi2, _MAX_SQUARED_DEVIATION).sum(axis=1).min())
