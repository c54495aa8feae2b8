"""Readable NumPy twin of the kernel that compares break points with a pose's: the oracle of its tests."""

import math

import numpy as np

from ringpose.geometry.circles import nearest_crossing
from ringpose.geometry.rays import GRAZING, project
from ringpose.kernels.forms import ClosedForm
from ringpose.kernels.misfit import Sights
from ringpose.types.arrays import Array, Float64
from ringpose.types.camera import Camera


def misfit_px(sights: Sights, form: ClosedForm, camera: Camera) -> float:
    """Root mean square distance between seen and predicted break points."""
    light_normal = sights.light_normal
    on_line = stripe_points(sights.point_m, light_normal, form.normal[0], form.offset_m[0])
    along = np.cross(form.normal[0], light_normal)
    direction = along / _positive(np.sqrt((along * along).sum(axis=1)))[:, None]
    predicted = nearest_crossing(on_line, direction, form.center_m[0], form.radius_m[0, sights.edge])
    difference = project(predicted, camera) - sights.position_px
    return math.sqrt(float((difference * difference).sum()) / len(difference))


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
