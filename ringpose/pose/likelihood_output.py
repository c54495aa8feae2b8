"""From the fitted state to centre, radii and grasp point, with their covariances (ringpose-method(7), section 5)."""

from collections.abc import Sequence
from math import hypot, sqrt
from typing import NamedTuple

import numpy as np

from ringpose.geometry.rotations import tilt_basis
from ringpose.pose.likelihood import Fit
from ringpose.pose.measurements import Measurements
from ringpose.pose.ring_model import BAND, CURVATURE, PARAMETERS, PLANE, SHIFT, TURN, cross
from ringpose.types.arrays import Array, Float64

TILTS, RADII, CENTER, GRASP, BEND, WIDTH = slice(0, 2), slice(5, 7), slice(7, 10), slice(10, 13), 13, 14
"""Rows of what is derived from a state."""

STRAIGHTEST = 1e-4
"""One over metres: a band straighter than this has a radius of ten kilometres for our purposes."""


class Quantities(NamedTuple):
    """What a state says, and its derivatives by the state."""

    center_m: Float64[Array, "3"]
    radius_m: Float64[Array, "2"]
    grasp_m: Float64[Array, "3"]
    by_state: Float64[Array, "15 7"]
    """Of the seven parameters of a pose, the centre, the grasp point, the curvature and the band's width."""


def quantities(fit: Fit) -> Quantities:
    """Centre c = o + (s - 1/k) u, radii 1/k -+ band/2, grasp point o + s u.

    The mean of the break points o lies in the direction u from the centre by construction, so the grasp point is the
    mid-band point there, whatever the centre's distance.
    """
    state, origin = fit.state, fit.rows.origin
    normal, along, outward = state.normal, state.along, state.outward
    inverse_length = 1.0 / float(np.sqrt(state.plane @ state.plane))
    basis = tilt_basis(normal)
    radius_m = 1.0 / (state.curvature if abs(state.curvature) > STRAIGHTEST else STRAIGHTEST)
    normal_by_plane = -inverse_length * (np.eye(3) - normal[:, None] * normal)

    by_state = np.zeros((15, PARAMETERS))
    by_state[0:2, PLANE] = -inverse_length * basis
    by_state[2, PLANE] = -(inverse_length**2) * normal
    by_state[5:7, CURVATURE] = -(radius_m**2)
    by_state[5:7, BAND] = (-0.5, 0.5)
    leaning = normal[:, None] * (outward @ normal_by_plane)  # the outward direction stays in the plane
    for first, reach_m in ((7, state.shift_m - radius_m), (10, state.shift_m)):
        rows = by_state[first : first + 3]
        rows[:, PLANE] = origin.by_plane - reach_m * leaning
        rows[:, SHIFT] = outward
        rows[:, TURN] = reach_m * along
    by_state[7:10, CURVATURE] = radius_m**2 * outward
    by_state[3:5] = basis @ by_state[CENTER]
    by_state[BEND, CURVATURE] = by_state[WIDTH, BAND] = 1.0
    return Quantities(
        center_m=origin.position_m + (state.shift_m - radius_m) * outward,
        radius_m=np.array([radius_m - 0.5 * state.band_m, radius_m + 0.5 * state.band_m]),
        grasp_m=origin.position_m + state.shift_m * outward,
        by_state=by_state,
    )


def covariance_of(fit: Fit, found: Quantities, measured: Measurements) -> Float64[Array, "15 15"]:
    """Joint covariance of the quantities: every residual errs by one, beyond the robust limit by that limit.

    With the gain G of the residuals on the state it is G G^T: the inverse normal matrix where no robust weight is
    active, its sandwich form where one is. The rig's errors, which are common to all residuals, pass the same gain.
    The grasp point also goes along the band with the mean of the break points.
    """
    inverse = fit.inverse
    gain = inverse @ (fit.rows.by_state.T * fit.weight)
    if fit.by_rig is not None:
        weighted = fit.by_rig.T * fit.weight
        own = weighted @ fit.by_rig
        own.flat[:: len(own) + 1] += 1.0
        from_ring = np.linalg.solve(own, weighted @ fit.rows.by_state)
        gain -= inverse @ from_ring.T @ weighted
    by_residual = -found.by_state @ gain
    joint = np.zeros((len(by_residual), len(by_residual)))
    if fit.by_rig is not None and fit.mean_by_rig is not None:
        by_rig = by_residual @ fit.by_rig
        by_rig[GRASP] += fit.state.along[:, None] * fit.mean_by_rig
        joint += by_rig @ by_rig.T
    first = 2 * len(measured.lines.laser)
    by_residual[GRASP, first : first + len(measured.points.laser)] += fit.state.along[:, None] * _mean_shift(
        fit, measured
    )
    spread = by_residual * np.where(fit.weight < 1.0, np.abs(fit.residual), 1.0)
    joint += spread @ spread.T
    return joint


def spread_of(rivals: Sequence[Fit], best: Fit, found: Quantities) -> Float64[Array, "15 15"]:
    """Squares of what rivals say instead of the best fit, summed: nobody knows which of them are true."""
    normal = best.state.normal
    basis, own = tilt_basis(normal), np.concatenate([found.center_m, found.grasp_m, found.radius_m])
    apart = np.zeros((len(rivals), 15))
    for row, fit in zip(apart, rivals, strict=True):
        said = quantities(fit)
        other = np.concatenate([said.center_m, said.grasp_m, said.radius_m]) - own
        row[TILTS] = basis @ fit.state.normal / float(fit.state.normal @ normal)
        row[2] = fit.state.normal @ said.center_m - normal @ found.center_m
        row[3:5], row[RADII], row[CENTER], row[GRASP] = basis @ other[:3], other[6:], other[:3], other[3:6]
        row[BEND] = fit.state.curvature - best.state.curvature
        row[WIDTH] = fit.state.band_m - best.state.band_m
    spread: Float64[Array, "15 15"] = apart.T @ apart
    return spread


def bow_m(joint: Float64[Array, "15 15"], fit: Fit) -> float:
    """How far the centre nears the band to second order when the ring errs by a sigma in the directions that turn it.

    For an observer at the band the centre is somewhere on a sphere: with the ring's tilt along `outward` and its turn
    about the normal it leaves the tangent plane by R / 2 times their squares.
    """
    normal, outward = fit.state.normal, fit.state.outward
    tilt, along = tilt_basis(normal) @ outward, cross(normal, outward)
    reach_m = 1.0 / max(abs(fit.state.curvature), STRAIGHTEST) - fit.state.shift_m
    by_tilt, by_turn = tilt @ joint[TILTS, TILTS] @ tilt, along @ joint[CENTER, CENTER] @ along / reach_m**2
    return 0.5 * reach_m * hypot(by_tilt, by_turn)


def with_second_order(joint: Float64[Array, "15 15"], bow: float, fit: Fit) -> Float64[Array, "15 15"]:
    """With the second moment of the bow, which goes with the squares of Gaussians: 3 bow^2."""
    by_bow = np.zeros(len(joint))
    by_bow[CENTER] = sqrt(3.0) * bow * fit.state.outward
    by_bow[3:5] = tilt_basis(fit.state.normal) @ by_bow[CENTER]
    more: Float64[Array, "15 15"] = joint + by_bow[:, None] * by_bow
    return more


def _mean_shift(fit: Fit, measured: Measurements) -> Float64[Array, "point"]:
    """How far the mean of the break points goes along the band when one of them errs by its standard deviation."""
    sigma = measured.points.sigma_x * np.sign(fit.rows.by_x)
    by_x, by_y = fit.state.along @ fit.rows.origin.by_ray
    shift: Float64[Array, "point"] = (by_x + fit.rows.slope * by_y) * sigma / len(sigma)
    return shift
