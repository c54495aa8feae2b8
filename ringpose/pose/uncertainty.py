"""Covariance of a pose, to first order.

J Sigma J^T, with Sigma the joint covariance of the triangulated points and J by central differences of the same
closed form that gave the pose.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from ringpose.geometry.rotations import tilt_basis
from ringpose.kernels.forms import ClosedForm
from ringpose.types.arrays import Array, Float64, Int64

STEP = 1e-6
"""Of the central differences, in units of the points' largest distance from their mean.

Small against the arc's height even for points that are nearly in line (1e-3 of their extent), large against
rounding (1e-16 of their distance).
"""

Solve = Callable[[Float64[Array, "batch point xyz=3"], Int64[Array, "point"]], ClosedForm]
"""A closed form: points in metres and the edge of each -> solutions."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseCovariance:
    """Covariances of one pose; NaN where the quantity itself is NaN."""

    parameters: Float64[Array, "7 7"]
    """Of tilt_1, tilt_2, offset_m, center_1_m, center_2_m, radius_inner_m, radius_outer_m."""
    center_m2: Float64[Array, "3 3"]
    grasp_m2: Float64[Array, "3 3"]


class Differentiated(NamedTuple):
    """A solution, and how it moves with its points."""

    form: ClosedForm
    """A batch of one."""
    jacobian: Float64[Array, "13 coordinate"]
    """Of the seven parameters, the centre and the grasp point by the points' coordinates x1 y1 z1 x2 ..."""


def pose_covariance(
    jacobian: Float64[Array, "13 coordinate"], covariance_m2: Float64[Array, "coordinate coordinate"]
) -> PoseCovariance:
    """Covariance of a solution at points whose joint covariance is given.

    First order is enough while the centre's standard deviation is a few percent of the radius. Beyond that (flag
    CENTER_WEAK) the centre's distribution is skew: it is the arc's height that is measured, the centre's
    distance goes with its inverse, and the true centre may lie many of these standard deviations away.
    """
    joint = jacobian @ covariance_m2 @ jacobian.T
    return PoseCovariance(parameters=joint[:7, :7], center_m2=joint[7:10, 7:10], grasp_m2=joint[10:, 10:])


def differentiated(solve: Solve, points: Float64[Array, "point xyz=3"], edges: Int64[Array, "point"]) -> Differentiated:
    """The closed form's solution at these points, and its derivatives by central differences."""
    count = points.size
    apart = points - points.sum(axis=0) / len(points)
    step = STEP * math.sqrt(float((apart * apart).sum(axis=1).max()))
    batch = np.empty((2 * count + 1, *points.shape))
    batch[:] = points
    flat = batch.reshape(len(batch), count)
    place = np.arange(count)
    flat[place, place] += step
    flat[count + place, place] -= step
    form = solve(batch, edges)
    values = solution_values(form, form.normal[-1])
    own = ClosedForm(**{field.name: getattr(form, field.name)[-1:] for field in fields(ClosedForm)})
    return Differentiated(own, (values[:count] - values[count:-1]).T / (2.0 * step))


def solution_values(form: ClosedForm, normal: Float64[Array, "3"]) -> Float64[Array, "batch 13"]:
    """The seven parameters about a given unit normal, then the centre and the grasp point.

    The tilts are those of `geometry.rotations.tilted`; center_1 and center_2 are the centre's coordinates along
    the two vectors of that normal's tilt basis, which stays where it is while the ring tilts.
    """
    basis = tilt_basis(normal)
    tilt = form.normal @ basis.T / (form.normal @ normal)[:, None]
    return np.concatenate(
        [tilt, form.offset_m[:, None], form.center_m @ basis.T, form.radius_m, form.center_m, form.grasp_m], axis=-1
    )
