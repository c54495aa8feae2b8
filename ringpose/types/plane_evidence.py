"""What one shot says about errors of the light planes."""

from dataclasses import dataclass

from ringpose.types.arrays import Array, Float64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlaneEvidence:
    """Whether each light plane, if it alone had moved, would explain what its stripe leaves over.

    Sums over shots add up. A plane's most likely error (tilt_1, tilt_2, distance) is information^-1 score, and
    score^T information^-1 score is the square of that error in its standard deviations.
    """

    score: Float64[Array, "laser parameter=3"]
    information: Float64[Array, "laser parameter=3 parameter=3"]
    """Zero for a laser that nothing checks: two stripes alone agree with every plane."""
