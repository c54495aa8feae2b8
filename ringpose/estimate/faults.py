"""What may be wrong in a shot without showing, with its prior probability (ringpose-method(7), section 15).

Each fault adds errors to the whitened residuals: r becomes r + E f, f ~ N(0, 1), with the columns E of the fault. One
linear step from the solved problem gives the ring, its covariance and the evidence under each of them
(`ringpose.estimate.separation`); `ringpose.estimate.hypotheses` solves anew for what does show.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ringpose.estimate.factors.prior import Prior
from ringpose.estimate.hypotheses import (
    END_PROBABILITY,
    MIN_DEVIATION_M,
    PLANE_PROBABILITY,
    RADIUS_PROBABILITY,
    STRIPE_PROBABILITY,
    WIDER_BY,
)
from ringpose.estimate.linearization import FixedColumns, Residuals
from ringpose.estimate.measurements import Measurements
from ringpose.estimate.nuisance import form_amplitude_m, rig_errors, rig_jacobian
from ringpose.geometry.ring import LIFT, TILT_ALONG, TILT_INWARD
from ringpose.types.arrays import Array, Float64
from ringpose.types.assumptions import TYPICAL_STABILITY
from ringpose.types.detection import UNLABELLED
from ringpose.types.rig import laser_parameters

PRIOR_PROBABILITY = 1e-2
"""Probability that the target moves more, or the ring is less round or flat, than the prior admits. These priors are
statements of the user; a normal distribution is exceeded by 2.6 standard deviations as often."""

END_SD_PX = 10.0
"""Displacement of a wrong end along its stripe; small ones are dangerous, as large ones contradict the rest."""

BOTH_ENDS_SD_PX = 30.0
"""Displacement of the ends of a stripe on another surface."""

SURFACE_TILT_SD_RAD = 0.05
"""Angle between that surface and the face: what is built is mostly parallel."""

LAYERS = {"near": 0.008, "far": 0.05}
"""Distances of a parallel layer, metres (standard deviations, one for each order of magnitude): its ends are those of
the face's shadow, which looks like the face there. The farther one is also that of a surface that is not parallel."""

PLANE_TILT_SD_RAD, PLANE_DISTANCE_SD_M = 5e-3, 5e-4
"""Change of a light plane that has moved: its projector was knocked, 0.1 m beside the camera."""

RADIUS_SD_SHARE = 0.3
"""Difference between the radii of rings, as a share of the radius."""

EDGE_SD_PX = 5.0
"""Displacement of visible points of something else: they lie on a curve along the edge."""

MAX_COLUMNS = 8
"""Columns of a fault that are kept; of the form's 18 no more are visible."""


class Fault(NamedTuple):
    """Something that may be wrong in a shot."""

    name: str
    probability: float
    columns: Float64[Array, "row error"]
    """Derivatives of the whitened residuals by its errors, of unit variance."""
    laser: int = UNLABELLED
    """The laser whose stripe or plane it concerns; `UNLABELLED` for none."""


def faults_of(measured: Measurements, residuals: Residuals, prior: Prior, fixed: FixedColumns) -> list[Fault]:
    """All faults of a shot, at the ring at which the problem is linearised."""
    return [
        *_wrong_ends(measured, residuals),
        *_wrong_stripes(measured, residuals),
        *_moved_planes(measured, residuals, prior, fixed),
        *_wider_priors(residuals, prior, fixed.form),
        *_wrong_edges(measured, residuals),
    ]


def _wrong_ends(measured: Measurements, residuals: Residuals) -> Iterator[Fault]:
    points = measured.points
    for end in sorted(set(points.ends.tolist())):
        columns = np.zeros((len(residuals.residual), 1))
        columns[_point_rows(measured), 0] = np.where(points.ends == end, _per_sigma(measured, END_SD_PX), 0.0)
        yield Fault(f"end {end}", END_PROBABILITY, columns, end // 4)


def _wrong_stripes(measured: Measurements, residuals: Residuals) -> Iterator[Fault]:
    """Both ends of each stripe, and the stripe as a whole: its line is that of another surface, its ends anywhere.

    A surface that is parallel to the face at some distance shows a line that is parallel to the right one: that two
    stripes lie in one plane then proves nothing. On a parallel layer with the face's outline the ends are consistent
    with the line: one unknown instead of five, and a far larger posterior probability.
    """
    points, lines = measured.points, measured.lines
    per_sigma = _per_sigma(measured, BOTH_ENDS_SD_PX)
    sds = np.array([LAYERS["far"], SURFACE_TILT_SD_RAD, SURFACE_TILT_SD_RAD])
    for laser in measured.lasers:
        ends = np.array(sorted(set(points.ends[points.laser == laser].tolist())))
        columns = np.zeros((len(residuals.residual), len(ends) + 3))
        columns[_point_rows(measured), : len(ends)] = np.where(points.ends[:, None] == ends, per_sigma[:, None], 0.0)
        if len(ends) > 1:
            yield Fault(f"ends {laser}", END_PROBABILITY, columns[:, : len(ends)], laser)
        of_line = np.flatnonzero(np.repeat(lines.laser == laser, 2))
        columns[of_line, len(ends) :] = residuals.jacobian[of_line][:, [LIFT, TILT_INWARD, TILT_ALONG]] * sds
        yield Fault(f"stripe {laser}", STRIPE_PROBABILITY / 2.0, columns, laser)
        of_points = 2 * len(lines.laser) + np.flatnonzero(points.laser == laser)
        rows = np.concatenate([of_line, of_points])
        for name, distance_sd_m in LAYERS.items():
            layer = np.zeros((len(residuals.residual), 1))
            layer[rows, 0] = residuals.jacobian[rows, LIFT] * distance_sd_m
            yield Fault(f"{name} layer {laser}", STRIPE_PROBABILITY / 4.0, layer, laser)


def _moved_planes(measured: Measurements, residuals: Residuals, prior: Prior, fixed: FixedColumns) -> Iterator[Fault]:
    errors, wrt_rig = rig_errors(measured.rig, prior.assumptions.stability), fixed.rig
    planes = laser_parameters([measured.rig.lasers.names[laser] for laser in measured.lasers])
    if errors is None or wrt_rig is None or not set(planes) <= set(errors.parameters):  # of planes that count as exact
        errors = rig_errors(measured.rig, TYPICAL_STABILITY)
        assert errors is not None  # as this stability is not zero
        wrt_rig, _ = rig_jacobian(residuals, errors)
    sds = np.array([PLANE_TILT_SD_RAD, PLANE_TILT_SD_RAD, PLANE_DISTANCE_SD_M])
    for laser in measured.lasers:
        own = [errors.parameters.index(name) for name in laser_parameters([measured.rig.lasers.names[laser]])]
        yield Fault(f"plane {laser}", PLANE_PROBABILITY, wrt_rig[:, own] * sds, laser)


def _wider_priors(residuals: Residuals, prior: Prior, form: Float64[Array, "row amplitude"] | None) -> Iterator[Fault]:
    """A faster target, a ring of another form, and one of other radii, than assumed."""
    if len(residuals.rate_sds):
        yield Fault("motion", PRIOR_PROBABILITY, residuals.wrt_rates * (WIDER_BY * residuals.rate_sds))
    if form is not None:
        yield Fault("form", PRIOR_PROBABILITY, _visible(form_amplitude_m(MIN_DEVIATION_M) * form))
    if prior.radii is not None:
        sd_m = prior.radii.sd_m[np.isfinite(prior.radii.radius_m)]
        rows = residuals.data_rows + np.arange(len(sd_m))
        columns = np.zeros((len(residuals.residual), len(sd_m)))
        columns[rows, range(len(sd_m))] = RADIUS_SD_SHARE * residuals.arcs.mean_radius_m / sd_m
        yield Fault("radius", RADIUS_PROBABILITY, columns)


def _wrong_edges(measured: Measurements, residuals: Residuals) -> Iterator[Fault]:
    """The points of each visible edge lie on another curve: shifted, inclined and bent against the edge."""
    edges, many = measured.edges, np.flatnonzero(residuals.observations.many)
    if not len(many):
        return
    focal = float(measured.rig.camera.camera_matrix[0, 0])
    per_sigma = EDGE_SD_PX / focal / np.maximum(np.hypot(*edges.step.T), 1e-12)
    for edge in sorted(set(edges.edge.tolist())):
        of_edge = edges.edge == edge
        along = edges.ray[:, 0]
        middle, half = along[of_edge].mean(), np.ptp(along[of_edge]) / 2.0 + 1e-12
        shape = np.vander((along - middle) / half, 3) * (of_edge * per_sigma)[:, None]
        columns = np.zeros((len(residuals.residual), shape.shape[1]))
        columns[many] = shape
        yield Fault(f"edge {edge}", END_PROBABILITY, columns)


def _point_rows(measured: Measurements) -> slice:
    """Rows of the break points along their stripes, which follow those of the lines."""
    first = 2 * len(measured.lines.laser)
    return slice(first, first + len(measured.points.x))


def _per_sigma(measured: Measurements, shift_px: float) -> Float64[Array, "point"]:
    """A displacement along the stripes in standard deviations of each break point."""
    shift: Float64[Array, "point"] = shift_px / measured.rig.camera.camera_matrix[0, 0] / measured.points.sigma_x
    return shift


def _visible(columns: Float64[Array, "row error"]) -> Float64[Array, "row kept"]:
    """The combinations of errors that change the residuals most, which are as many as can be told apart."""
    size, axes = np.linalg.eigh(columns.T @ columns)
    kept: Float64[Array, "row kept"] = columns @ axes[:, np.argsort(size)[-MAX_COLUMNS:]]
    return kept
