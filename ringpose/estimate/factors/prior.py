"""What is known about the ring before the measurement."""

from typing import NamedTuple

import numpy as np

from ringpose.geometry.ring import (
    CURVATURE,
    EDGE_SIGN,
    HALF_BAND,
    TILT_ALONG,
    TILT_INWARD,
    TURN,
    RingArcs,
    RingPrediction,
)
from ringpose.types.arrays import Array, Float64
from ringpose.types.assumptions import Assumptions
from ringpose.types.pose import KnownRadii

EXPECTED_CURVATURE = 1.5
"""Mean and standard deviation in 1/m of the weak prior where nothing shows the radius: one of 0.3 m has 3.3; the
largest ring in launcher manuals has 0.76."""

ANGLE_SD_RAD = 0.6
"""Weak prior on the angles between the stripes and the radius, and between the ring's normal and the optical axis, if a
single stripe leaves them open."""

EXPECTED_HALF_BAND_M = 0.015
"""Mean and standard deviation of the prior on half the width of the face if only one edge was seen: faces in launcher
manuals are 0.03 m wide."""


class Prior(NamedTuple):
    """What is known about the ring before the measurement: the last factor of each problem."""

    radii: KnownRadii | None = None
    assumptions: Assumptions = Assumptions()
    """Assumptions on motion, the ring's form and the rig."""
    regularize_about: RingArcs | None = None
    """The ring about which curvature, turn and tilt have weak priors; None to estimate from the shot alone. Of a small
    ring, which ends on both arcs show, the curvature is also the standard deviation of its prior."""
    single_edge: bool = False
    """Whether only one edge was seen, so that the width of the face needs a prior."""

    def rows(self, at: RingPrediction) -> Float64[Array, "row column"]:
        """[r J] of Eq. (5.7); `rows` holds each residual with its nonzero derivatives."""
        arcs, rows = at.arcs, list[tuple[float, dict[int, float]]]()
        if self.radii is not None:
            for sign, radius_m, assumed_m, sd_m in zip(
                EDGE_SIGN, arcs.radius_m.tolist(), self.radii.radius_m.tolist(), self.radii.sd_m.tolist(), strict=True
            ):
                if assumed_m == assumed_m:
                    derivatives = {CURVATURE: -(arcs.mean_radius_m**2) / sd_m, HALF_BAND: sign / sd_m}
                    rows.append(((radius_m - assumed_m) / sd_m, derivatives))
        if self.regularize_about is not None:
            inward, along, normal = arcs.axes
            expected = max(abs(self.regularize_about.curvature), EXPECTED_CURVATURE)
            rows += [
                (arcs.curvature / expected - 1.0, {CURVATURE: 1.0 / expected}),
                (float(inward @ self.regularize_about.axes[1]) / ANGLE_SD_RAD, {TURN: 1.0 / ANGLE_SD_RAD}),
            ]
            for axis in range(2):
                derivatives = {TILT_INWARD: inward[axis] / ANGLE_SD_RAD, TILT_ALONG: along[axis] / ANGLE_SD_RAD}
                rows.append((float(normal[axis]) / ANGLE_SD_RAD, derivatives))
        if self.single_edge:
            half_band = (arcs.half_band_m - EXPECTED_HALF_BAND_M) / EXPECTED_HALF_BAND_M
            rows.append((half_band, {HALF_BAND: 1.0 / EXPECTED_HALF_BAND_M}))
        table = np.zeros((len(rows), 1 + at.stripes.y_wrt_step.shape[1]))
        for row, (value, derivatives) in zip(table, rows, strict=True):
            row[0], row[1:][list(derivatives)] = value, list(derivatives.values())
        return table
