"""All residuals of a shot in one column, each divided by its standard deviation, with their derivatives.

Order: lines (a of ringpose-method(7), section 5), break points along their lines (b), break points across where no
line is known, visible edges (c), then what is known beforehand (d; and what rings are like, where a shot leaves that
open).
"""

from typing import NamedTuple

import numpy as np

from ringpose.kernels.ring_rows import Predicted, predicted
from ringpose.pose.measurements import Measurements, Points, Sighted
from ringpose.pose.ring_model import (
    BAND,
    CURVATURE,
    PARAMETERS,
    PLANE,
    TURN,
    ArcParts,
    EdgeParts,
    Origin,
    RingState,
    Sights,
    edge_parts,
)
from ringpose.types.arrays import Array, Float64
from ringpose.types.ring import KnownRadii

LIKELY_CURVATURE, CURVATURE_SD = 1.5, 1.5
"""One over metres: what a ring that somebody builds may have (0.3 m: 3.3; the largest in launcher manuals: 0.76)."""

TURN_SD_RAD = 0.5
"""How far the stripes' direction may be from the radius, where one stripe alone has to tell it."""

TILT_SD_RAD = 0.6
"""How far a face that is seen may be turned from the line of sight, where one stripe leaves that open."""


LIKELY_BAND_M, BAND_SD_M = 0.03, 0.03
"""Where only one edge was seen: as wide as the bands in launcher manuals, or twice that, or very narrow."""


_NONE = np.empty(0)


class Beforehand(NamedTuple):
    """What is known before the measurement."""

    radii: KnownRadii | None = None
    weak_about: RingState | None = None
    """The start of a search in which what the shot leaves open is held to what rings are like."""
    one_edge: bool = False
    """Whether only one edge was seen."""

    @property
    def nothing(self) -> bool:
        """Whether that is all."""
        return self.radii is None and self.weak_about is None and not self.one_edge


class Rows(NamedTuple):
    """The column and what it was made of."""

    residual: Float64[Array, "row"]
    by_state: Float64[Array, "row 7"]
    ends: int
    """Number of the lines' ends: so many rows, and so many sights before those of the break points."""
    sights: Sights
    arcs: ArcParts
    origin: Origin
    edges: EdgeParts | None
    by_x: Float64[Array, "point"]
    """Derivative of a break point's distance from its circle by its abscissa, along the predicted line."""
    along_scale: Float64[Array, "point"]
    """One over the standard deviation of that distance."""
    across: "AcrossScale"

    @property
    def slope(self) -> Float64[Array, "point"]:
        """Of the predicted lines at the break points."""
        return self.sights.slope[self.ends :]

    @property
    def y(self) -> Float64[Array, "point"]:
        """Predicted ordinates of the break points."""
        return self.sights.rays[self.ends :, 1]


class AcrossScale(NamedTuple):
    """How ordinates of break points without a line enter: (y - y(x) - share * distance) * scale."""

    which: Array
    share: Float64[Array, "alone"]
    scale: Float64[Array, "alone"]


_NOTHING_ACROSS = AcrossScale(np.empty(0, dtype=np.int64), _NONE, _NONE)


def rows_of(state: RingState, measured: Measurements, sighted: Sighted, before: Beforehand) -> Rows:
    """The residuals of a state; `sighted` are the same measurements with their light planes."""
    own = predicted(state.numbers, sighted.rays, sighted.light, sighted.whitening, sighted.edge_sign_and_sigma)
    ends, origin = len(sighted.whitening), Origin(own.origin_m, own.origin_by_plane, own.origin_by_ray)
    parts = [(own.residual, own.by_state)]
    across = _across_scale(measured.points, own.slope[ends:], own.by_x)
    if len(across.which):
        parts.append(_across_rows(measured.points, across, own, ends))
    visible = edge_parts(state, measured.edges, origin) if len(measured.edges.edge) else None
    if visible is not None:
        parts.append((visible.residual, visible.by_state))
    if not before.nothing:
        parts.append(_known(state, before))
    residual, by_state = parts[0] if len(parts) == 1 else (np.concatenate(each) for each in zip(*parts, strict=True))
    return rows_of_prediction(own, ends, residual, by_state)._replace(edges=visible, across=across)


def rows_of_prediction(
    own: Predicted, ends: int, residual: Float64[Array, "row"], by_state: Float64[Array, "row 7"]
) -> Rows:
    """The same where the kernel has made all residuals: of stripes, break points with a line, and radii."""
    return Rows(
        residual=residual,
        by_state=by_state,
        ends=ends,
        sights=Sights(own.rays, own.slope, own.steepness, own.y_by_plane),
        arcs=ArcParts(own.distance_m, own.distance_by_state, own.by_ray),
        origin=Origin(own.origin_m, own.origin_by_plane, own.origin_by_ray),
        edges=None,
        by_x=own.by_x,
        along_scale=own.along_scale,
        across=_NOTHING_ACROSS,
    )


def _across_rows(
    points: Points, across: AcrossScale, own: Predicted, ends: int
) -> tuple[Float64[Array, "alone"], Float64[Array, "alone 7"]]:
    which = across.which
    above = points.y[which] - own.rays[ends:][which, 1]
    derivative = -across.share[:, None] * own.distance_by_state[which]
    derivative[:, PLANE] -= own.y_by_plane[ends:][which]
    return across.scale * (above - across.share * own.distance_m[which]), across.scale[:, None] * derivative


def _across_scale(points: Points, slope: Float64[Array, "point"], by_x: Float64[Array, "point"]) -> AcrossScale:
    """The ordinate above the predicted line errs with the abscissa too; what is left of it does not."""
    which = np.flatnonzero(points.alone)
    if not len(which):
        return _NOTHING_ACROSS
    covariance, slope = points.covariance[which], slope[which]
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    with_x = xy - slope * xx
    left = yy - 2.0 * slope * xy + slope**2 * xx - with_x**2 / xx
    return AcrossScale(which, with_x / xx / by_x[which], 1.0 / np.sqrt(np.maximum(left, 1e-12 * xx)))


def _known(state: RingState, before: Beforehand) -> tuple[Float64[Array, "row"], Float64[Array, "row 7"]]:
    residual: list[float] = []
    rows: list[tuple[dict[int, float], float]] = []
    if before.radii is not None:
        rows += _radius_rows(state, before.radii)
    if before.weak_about is not None:
        rows += _weak_rows(state, before.weak_about)
    if before.one_edge:
        rows.append(({BAND: 1.0 / BAND_SD_M}, (state.band_m - LIKELY_BAND_M) / BAND_SD_M))
    derivative = np.zeros((len(rows), PARAMETERS))
    for number, (entries, value) in enumerate(rows):
        residual.append(value)
        for column, entry in entries.items():
            derivative[number, column] = entry
    return np.array(residual, dtype=np.float64), derivative


def _radius_rows(state: RingState, radii: KnownRadii) -> list[tuple[dict[int, float], float]]:
    """(1/k -+ band/2 - radius) / sd, written as 1 - k (radius -+ band/2) so that no curvature is forbidden."""
    rows = []
    for sign, radius_m, sd_m in zip((-1.0, 1.0), radii.radius_m.tolist(), radii.sd_m.tolist(), strict=True):
        if radius_m == radius_m:
            middle_m, weight = radius_m - 0.5 * sign * state.band_m, radius_m / sd_m
            entries = {CURVATURE: -weight * middle_m, BAND: weight * 0.5 * sign * state.curvature}
            rows.append((entries, weight * (1.0 - state.curvature * middle_m)))
    return rows


def _weak_rows(state: RingState, about: RingState) -> list[tuple[dict[int, float], float]]:
    tilt_scale = TILT_SD_RAD * float(about.plane[2])
    turn = float(state.outward @ about.along)
    return [
        ({CURVATURE: 1.0 / CURVATURE_SD}, (state.curvature - LIKELY_CURVATURE) / CURVATURE_SD),
        ({TURN: 1.0 / TURN_SD_RAD}, turn / TURN_SD_RAD),
        ({0: 1.0 / tilt_scale}, float(state.plane[0]) / tilt_scale),
        ({1: 1.0 / tilt_scale}, float(state.plane[1]) / tilt_scale),
    ]
