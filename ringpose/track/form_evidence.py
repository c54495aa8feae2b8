"""Which tolerance of the ring's form the shots of a track support, all together (ringpose-method(7), section 12).

A shot by itself may be explained only by a larger deviation from circle and plane than assumed: by chance in one of
several hundred shots, or because a mark beside the edge was taken for it. The ring has one form. Where the other shots
do not support the larger tolerance, the deviation is an error of that shot alone.
"""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from ringpose.estimate.hypotheses import END_PROBABILITY
from ringpose.estimate.nuisance import FORM_PARAMETERS, form_amplitude_m
from ringpose.track.common_errors import CommonErrors
from ringpose.track.observation import BROAD
from ringpose.types.arrays import Array, Float64
from ringpose.types.pose import MEASURED_PARAMETERS, PoseLine, RingMeasurement

MAX_BLOCKS = 50
"""Number of shots after which their rows are reduced to one triangle, which loses nothing but limits the memory."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FormEvidence:
    """The evidence of shots for tolerances of the ring that their records assume."""

    names: tuple[str, ...] = ()
    tolerances_m: tuple[float, ...] = ()
    """Those that records assume, in ascending order. The smallest one is the user's; a record with the flag `ring_form`
    assumes a larger one."""
    newest_m: float = 0.0
    """That of the newest record."""
    blocks: tuple[tuple[RingMeasurement, float] | Float64[Array, "row column"], ...] = ()
    """Measurements with the factors on their variances, or rows [A, y] of the equations A q = y + N(0, 1) that are left
    of them without the ring."""

    def with_shot(
        self, line: PoseLine, measurement: RingMeasurement, common: CommonErrors, inflation: float
    ) -> "FormEvidence":
        """The evidence with that of one more shot; that about other parameters of the rig is not comparable."""
        tolerance_m = 0.0 if line.priors is None else line.priors.assumptions.ring_tolerance_m
        blocks = (*(self.blocks if self.names == common.names else ()), (measurement, inflation))
        together = replace(
            self,
            names=common.names,
            tolerances_m=tuple(sorted({*self.tolerances_m, tolerance_m})),
            newest_m=tolerance_m,
            blocks=blocks,
        )
        return together.reduced() if len(blocks) > MAX_BLOCKS else together

    def judged(self, measurement: RingMeasurement, common: CommonErrors) -> tuple[CommonErrors, RingMeasurement]:
        """The common errors with the tolerance that the shots support, and the newest measurement.

        What its record assumes beyond that tolerance is an error of this shot alone.
        """
        if not common.with_form:
            return common, measurement
        tolerance_m = self.tolerance_m(common)
        excess_m2 = self.newest_m**2 - tolerance_m**2
        return common.with_tolerance(tolerance_m), _with_own_form(measurement, excess_m2)

    def tolerance_m(self, common: CommonErrors) -> float:
        """Root mean square of the tolerances, each with its probability by the shots so far, Eq. (12.4)."""
        if len(self.tolerances_m) == 1:
            return self.tolerances_m[0]
        tolerances_m, rows = np.array(self.tolerances_m), self._rows()
        log_odds = np.full(len(tolerances_m), np.log(END_PROBABILITY))
        log_odds[0] = 0.0
        for number, tolerance_m in enumerate(self.tolerances_m):
            wrt_errors = rows[:, :-1] @ common.with_tolerance(tolerance_m).root
            covariance = np.eye(len(rows)) + wrt_errors @ wrt_errors.T
            chi2 = rows[:, -1] @ np.linalg.solve(covariance, rows[:, -1])
            log_odds[number] -= 0.5 * (chi2 + np.linalg.slogdet(covariance)[1])
        probability = np.exp(log_odds - log_odds.max())
        return sqrt(float(probability @ tolerances_m**2) / float(probability.sum()))

    def reduced(self) -> "FormEvidence":
        """The same with all rows in one triangle."""
        return replace(self, blocks=(self._rows(),))

    def _rows(self) -> Float64[Array, "row column"]:
        rows = [_without_ring(*each, self.names) if isinstance(each, tuple) else each for each in self.blocks]
        return np.asarray(np.linalg.qr(np.concatenate(rows), mode="r"))


def _without_ring(
    measurement: RingMeasurement, inflation: float, names: tuple[str, ...]
) -> Float64[Array, "row column"]:
    """What a measurement states about the common errors by themselves: its rows without the ring (Schur complement)."""
    root, ring = measurement.square_root / sqrt(inflation), len(MEASURED_PARAMETERS)
    columns = [ring + names.index(name) for name in measurement.nuisance_parameters]
    rows = np.zeros((ring + len(root), ring + len(names) + 1))
    rows[range(ring), range(ring)] = 1.0 / BROAD
    rows[ring:, [*range(ring), *columns, -1]] = root
    return np.asarray(np.linalg.qr(rows, mode="r"))[ring:, ring:]


def _with_own_form(measurement: RingMeasurement, excess_m2: float) -> RingMeasurement:
    """The measurement whose errors include a deviation of the form by this variance (m^2), independent of other shots.

    Its rows, whose errors then have the covariance 1 + F F^T = U U^T, are multiplied by the inverse of the upper
    triangle U, so that those without the ring remain without it.
    """
    names = measurement.nuisance_parameters
    of_form = [len(MEASURED_PARAMETERS) + index for index, name in enumerate(names) if name in FORM_PARAMETERS]
    if excess_m2 <= 0.0 or not of_form:
        return measurement
    root = measurement.square_root
    wrt_form = form_amplitude_m(sqrt(excess_m2)) * root[:, of_form]
    covariance = np.eye(len(root)) + wrt_form @ wrt_form.T
    upper = np.linalg.cholesky(covariance[::-1, ::-1])[::-1, ::-1]
    return replace(measurement, square_root=np.linalg.solve(upper, root))
