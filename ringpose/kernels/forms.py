"""The paper's two closed forms (ringpose-method(7), section 4) behind typed functions.

Points come in batches, so that one call serves a pose and all the small displacements that its covariance asks for.
Within a batch all points stand on the same edges.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ringpose.kernels import _forms
from ringpose.types.arrays import Array, Bool, Float64, Int64

SINGULAR_BELOW = 1e-3
"""q0: where smallest over largest singular value of the centre's equations falls below it, they are damped.

Three points with spacing a on a ring of radius R give about a / (2 R): the narrowest rig (1.5 degrees between
lasers, 0.2 m away) sees the largest ring of the launcher manuals (1.3 m) at 2e-3 and stays exact. Damped are points
on a straighter arc than any ring's, and stripes that nearly coincide (light planes that cross, at 0.19 m in the
paper's physical rig).
"""

LARGEST_DAMPING = SINGULAR_BELOW
"""lambda_max, in units of the largest singular value.

Equal to q0, so that the weakest direction keeps the share (q / q0)^2 of its undamped step from the mean of
the points: all of it at q0, nothing where the equations are singular.
"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClosedForm:
    """Solutions of a batch of points; lengths in metres, camera frame."""

    normal: Float64[Array, "batch xyz=3"]
    offset_m: Float64[Array, "batch"]
    """The ring's plane is `normal . point = offset_m`."""
    center_m: Float64[Array, "batch xyz=3"]
    radius_m: Float64[Array, "batch edge=2"]
    grasp_m: Float64[Array, "batch xyz=3"]
    condition: Float64[Array, "batch"]
    damped: Bool[Array, "batch"]


class Differentiated(NamedTuple):
    """A solution, and how it moves with its points."""

    form: ClosedForm
    """A batch of one."""
    jacobian: Float64[Array, "13 coordinate"]
    """Of the seven parameters, the centre and the grasp point by the points' coordinates x1 y1 z1 x2 ..."""


STEP = 1e-6
"""Of the central differences, in units of the points' largest distance from their mean.

Small against the arc's height even for points that are nearly in line (1e-3 of their extent), large against
rounding (1e-16 of their distance).
"""


def paper_form(points_m: Float64[Array, "batch point xyz=3"], edges: Int64[Array, "point"]) -> ClosedForm:
    """Method `paper`, read literally: plane, centre, radii and the mean of the points as the grasp point.

    It works in millimetres, as the paper does: the plane row, of size 1e-3, then hardly counts beside rows of size 1e2,
    so the centre is free to leave the ring's plane: exact on true points, decimetres off along the normal with the
    noise of any real image. Kept as a baseline.
    """
    return _closed_form(points_m, edges, constrained=False)


def constrained_form(points_m: Float64[Array, "batch point xyz=3"], edges: Int64[Array, "point"]) -> ClosedForm:
    """Method `paper-constrained`: the same equations in the ring's plane; radii, and the mid-band grasp point."""
    return _closed_form(points_m, edges, constrained=True)


def nearest_plane(points_m: Float64[Array, "n xyz=3"]) -> tuple[Float64[Array, "3"], float, Float64[Array, "3"]]:
    """`geometry.planes.nearest_plane` of up to 64 points without weights: normal, distance, singular values."""
    found = np.frombuffer(_forms.plane(np.ascontiguousarray(points_m)), dtype=np.float64)
    return found[:3], float(found[3]), found[4:]


def differentiated(
    points_m: Float64[Array, "point xyz=3"], edges: Int64[Array, "point"], constrained: bool
) -> Differentiated:
    """One of the two closed forms, and its derivatives by central differences."""
    found = _forms.derivatives(
        np.ascontiguousarray(points_m), np.ascontiguousarray(edges), constrained, SINGULAR_BELOW, STEP
    )
    numbers = np.frombuffer(found, dtype=np.float64)
    return Differentiated(_form_of(numbers[:13].reshape(1, 13)), numbers[13:].reshape(13, -1))


def _closed_form(
    points_m: Float64[Array, "batch point xyz=3"], edges: Int64[Array, "point"], constrained: bool
) -> ClosedForm:
    found = _forms.forms(np.ascontiguousarray(points_m), np.ascontiguousarray(edges), constrained, SINGULAR_BELOW)
    return _form_of(np.frombuffer(found, dtype=np.float64).reshape(-1, 13))


def _form_of(form: Float64[Array, "batch 13"]) -> ClosedForm:
    quotient = form[:, 12]
    return ClosedForm(
        normal=form[:, 0:3],
        offset_m=form[:, 3],
        center_m=form[:, 4:7],
        radius_m=form[:, 7:9],
        grasp_m=form[:, 9:12],
        condition=1.0 / np.maximum(quotient, np.finfo(float).tiny),
        damped=quotient < SINGULAR_BELOW,
    )
