"""Readable NumPy twin of the kernel that differentiates the paper's closed forms: the oracle of its tests."""

import math
from dataclasses import fields

import numpy as np

from ringpose.geometry.rotations import tilt_basis
from ringpose.kernels.forms import STEP, ClosedForm, Differentiated
from ringpose.kernels.reference_forms import constrained_form, paper_form
from ringpose.types.arrays import Array, Float64, Int64


def differentiated(
    points: Float64[Array, "point xyz=3"], edges: Int64[Array, "point"], constrained: bool
) -> Differentiated:
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
    form = (constrained_form if constrained else paper_form)(batch, edges)
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
