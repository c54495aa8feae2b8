"""All residuals of a shot in one column, each divided by its standard deviation, with their derivatives.

Order: lines, break points along their lines, break points across where no line is known, visible edges, then
what is known beforehand.
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


_NONE, _NO_ROWS = np.empty(0), np.empty((0, PARAMETERS))


class Beforehand(NamedTuple):
    """What is known before the measurement."""

    radii: KnownRadii | None = None
    weak_about: RingState | None = None
    """The start of a search in which what the shot leaves open is held to what rings are like."""
    one_edge: bool = False
    """Whether only one edge was seen."""


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


def rows_of(state: RingState, measured: Measurements, sighted: Sighted, before: Beforehand) -> Rows:
    """The residuals of a state; `sighted` are the same measurements with their light planes."""
    ends, points = len(sighted.whitening), measured.points
    sights = sights_of(state, sighted)
    rays, y_by_plane = sights.rays[ends:], sights.y_by_plane[ends:]
    origin = origin_of(state, rays, y_by_plane)
    arcs = arc_parts(state, rays, sighted.edge_sign, origin)
    by_state = arcs.by_state
    by_state[:, PLANE] += arcs.by_ray[:, 1:] * y_by_plane
    by_x = _away_from_zero(arcs.by_ray[:, 0] + sights.slope[ends:] * arcs.by_ray[:, 1])
    scale = 1.0 / (np.abs(by_x) * points.sigma_x)
    lines = np.zeros((ends, PARAMETERS))
    lines[:, PLANE] = sighted.whitening @ -sights.y_by_plane[:ends]
    residual = [sighted.whitening @ (sighted.rays[:ends, 1] - sights.rays[:ends, 1]), scale * arcs.distance_m]
    derivative = [lines, scale[:, None] * by_state]

    across = _across_scale(points, sights.slope[ends:], by_x)
    if len(across.which):
        y = points.y[across.which] - rays[across.which, 1]
        own = -across.share[:, None] * by_state[across.which]
        own[:, PLANE] -= y_by_plane[across.which]
        residual.append(across.scale * (y - across.share * arcs.distance_m[across.which]))
        derivative.append(across.scale[:, None] * own)
    visible = edge_parts(state, measured.edges, origin) if len(measured.edges.edge) else None
    if visible is not None:
        residual.append(visible.residual)
        derivative.append(visible.by_state)
    known_residual, known_derivative = _known(state, before)
    return Rows(
        residual=np.concatenate([*residual, known_residual]),
        by_state=np.concatenate([*derivative, known_derivative]),
        ends=ends,
        sights=sights,
        arcs=arcs,
        origin=origin,
        edges=visible,
        by_x=by_x,
        along_scale=scale,
        across=across,
    )


def _across_scale(points: Points, slope: Float64[Array, "point"], by_x: Float64[Array, "point"]) -> AcrossScale:
    """The ordinate above the predicted line errs with the abscissa too; what is left of it does not."""
    which = np.flatnonzero(points.alone)
    if not len(which):
        return AcrossScale(which, _NONE, _NONE)
    covariance, slope = points.covariance[which], slope[which]
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    with_x = xy - slope * xx
    left = yy - 2.0 * slope * xy + slope**2 * xx - with_x**2 / xx
    return AcrossScale(which, with_x / xx / by_x[which], 1.0 / np.sqrt(np.maximum(left, 1e-12 * xx)))


def _known(state: RingState, before: Beforehand) -> tuple[Float64[Array, "row"], Float64[Array, "row 7"]]:
    if before.radii is None and before.weak_about is None and not before.one_edge:
        return _NONE, _NO_ROWS
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


def _away_from_zero(value: Float64[Array, "n"]) -> Float64[Array, "n"]:
    return np.where(np.abs(value) < 1e-9, 1e-9, value)
