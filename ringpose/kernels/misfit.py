"""How far a pose's break points lie from those that were seen, behind a typed function."""

from typing import NamedTuple

import numpy as np

from ringpose.kernels import _forms
from ringpose.kernels.forms import ClosedForm
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.camera import Camera


class Sights(NamedTuple):
    """The break points that were seen."""

    point_m: Float64[Array, "n xyz=3"]
    """Triangulated, camera frame."""
    edge: Int64[Array, "n"]
    light_normal: Float64[Array, "n xyz=3"]
    """Of each one's light plane."""
    position_px: Float64[Array, "n xy=2"]


def misfit_px(sights: Sights, form: ClosedForm, camera: Camera) -> float:
    """Root mean square distance between seen and predicted break points, in (distorted) pixels.

    A predicted one is where ring plane, light plane and the sphere of the edge's radius about the centre meet (the
    ring's circle itself where the centre lies in the plane); where the light plane misses the sphere, the line's
    point nearest to the centre. NaN if that does not exist in front of the camera. `form` is a batch of one.
    """
    return _forms.misfit(
        np.ascontiguousarray(sights.point_m),
        np.ascontiguousarray(sights.edge),
        np.ascontiguousarray(sights.light_normal),
        np.ascontiguousarray(sights.position_px),
        np.ascontiguousarray(form.normal[0]),
        np.ascontiguousarray(form.center_m[0]),
        np.ascontiguousarray(form.radius_m[0]),
        np.ascontiguousarray(camera.camera_matrix),
        np.ascontiguousarray(camera.distortion_coefficients),
        float(form.offset_m[0]),
    )


def spread_m2(
    point_m: Float64[Array, "n xyz=3"],
    light_normal: Float64[Array, "n xyz=3"],
    covariance_px2: Float64[Array, "n xy=2 xy=2"],
    camera: Camera,
) -> Float64[Array, "coordinate coordinate"]:
    """Covariance of the coordinates x1 y1 z1 x2 ... of points in light planes whose break points err independently."""
    found = _forms.spread(
        np.ascontiguousarray(point_m),
        np.ascontiguousarray(light_normal),
        np.ascontiguousarray(covariance_px2),
        np.ascontiguousarray(camera.camera_matrix),
        np.ascontiguousarray(camera.distortion_coefficients),
    )
    return np.frombuffer(found, dtype=np.float64).reshape(3 * len(point_m), 3 * len(point_m))
