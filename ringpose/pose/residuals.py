"""How far the break points are from where a pose predicts them."""

import math

import numpy as np

from ringpose.geometry.circles import nearest_crossing
from ringpose.geometry.rays import GRAZING, project
from ringpose.kernels.forms import ClosedForm
from ringpose.types.arrays import Array, Float64
from ringpose.types.break_points import BreakPoints
from ringpose.types.rig import Rig
from ringpose.types.ring_points import RingPoints


def prediction_rms_px(form: ClosedForm, points: RingPoints, break_points: BreakPoints, rig: Rig) -> float:
    """Root mean square distance between seen and predicted break points, in (distorted) pixels.

    A predicted one is where ring plane, light plane and the sphere of the edge's radius about the centre meet (the
    ring's circle itself where the centre lies in the plane); where the light plane misses the sphere, the line's
    point nearest to the centre. NaN if that does not exist in front of the camera. `form` is a batch of one.
    """
    laser, edge = np.nonzero(points.seen)
    light_normal = rig.lasers.normal[laser]
    on_line = stripe_points(points.position_m[laser, edge], light_normal, form.normal[0], form.offset_m[0])
    along = light_normal @ crossing_with(form.normal[0])
    direction = along / _positive(np.sqrt((along * along).sum(axis=1)))[:, None]
    predicted = nearest_crossing(on_line, direction, form.center_m[0], form.radius_m[0, edge])
    difference = project(predicted, rig.camera) - break_points.position_px[laser, edge]
    return math.sqrt(float((difference * difference).sum()) / len(difference))


def crossing_with(vector: Float64[Array, "3"]) -> Float64[Array, "3 3"]:
    """The C with `others @ C = np.cross(vector, others)`, at a tenth of its time."""
    x, y, z = vector.tolist()
    return np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])


def stripe_points(
    points: Float64[Array, "n xyz=3"],
    light_normal: Float64[Array, "n xyz=3"],
    normal: Float64[Array, "3"],
    offset_m: float,
) -> Float64[Array, "n xyz=3"]:
    """Points of light planes, moved within them the shortest way onto the ring's plane `normal . P = offset_m`.

    NaN for a light plane along the ring's plane.
    """
    uphill = normal - (light_normal @ normal)[:, None] * light_normal
    step = (offset_m - points @ normal) / _positive(uphill @ normal)
    moved: Float64[Array, "n xyz=3"] = points + step[:, None] * uphill
    return moved


def _positive(length: Float64[Array, "n"]) -> Float64[Array, "n"]:
    return np.where(length > GRAZING, length, np.nan)
