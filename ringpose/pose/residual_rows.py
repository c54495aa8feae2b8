"""All residuals of a shot in one column, each divided by its standard deviation, with their derivatives.

Order: lines (a of ringpose-method(7), section 5), break points along their lines (b), break points across where no
line is known, visible edges (c), then what is known beforehand (d; and what rings are like, where a shot leaves that
open).
"""

from typing import NamedTuple

import numpy as np

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
    arc_parts,
    edge_parts,
    origin_of,
    sights_of,
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


MIN_RATE = 1e-12
"""A distance from the circle that changes by less than this with the abscissa does not depend on it."""

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
    ends = len(sighted.whitening)
    sights = sights_of(state, sighted)
    y_by_plane = sights.y_by_plane[ends:]

    # a: whitened distances of the lines' ends from the predicted lines
    lines = np.zeros((ends, PARAMETERS))
    lines[:, PLANE] = -sighted.whitening @ sights.y_by_plane[:ends]
    parts = [(sighted.whitening @ (sighted.rays[:ends, 1] - sights.rays[:ends, 1]), lines)]

    # b: distances of the break points from their circles, along the predicted lines
    origin = origin_of(state, sights.rays[ends:], y_by_plane)
    arcs = arc_parts(state, sights.rays[ends:], sighted.edge_sign, origin)
    arcs.by_state[:, PLANE] += arcs.by_ray[:, 1:] * y_by_plane
    by_x = arcs.by_ray[:, 0] + sights.slope[ends:] * arcs.by_ray[:, 1]
    by_x = np.where(np.abs(by_x) < MIN_RATE, MIN_RATE, by_x)
    along_scale = 1.0 / (np.abs(by_x) * sighted.edge_sign_and_sigma[:, 1])
    parts.append((along_scale * arcs.distance_m, along_scale[:, None] * arcs.by_state))

    across = _across_scale(measured.points, sights.slope[ends:], by_x)
    if len(across.which):
        above = measured.points.y - sights.rays[ends:, 1]
        parts.append(_across_rows(across, above, y_by_plane, arcs))
    visible = edge_parts(state, measured.edges, origin) if len(measured.edges.edge) else None
    if visible is not None:
        parts.append((visible.residual, visible.by_state))
    if not before.nothing:
        parts.append(_known(state, before))
    residual, by_state = (np.concatenate(each) for each in zip(*parts, strict=True))
    return Rows(residual, by_state, ends, sights, arcs, origin, visible, by_x, along_scale, across)


def _across_rows(
    across: AcrossScale, above: Float64[Array, "point"], y_by_plane: Float64[Array, "point 3"], arcs: ArcParts
) -> tuple[Float64[Array, "alone"], Float64[Array, "alone 7"]]:
    which = across.which
    derivative = -across.share[:, None] * arcs.by_state[which]
    derivative[:, PLANE] -= y_by_plane[which]
    return across.scale * (above[which] - across.share * arcs.distance_m[which]), across.scale[:, None] * derivative


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
