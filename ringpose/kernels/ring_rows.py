"""What a ring predicts of stripes and break points, behind a typed function."""

from typing import NamedTuple

import numpy as np

from ringpose.kernels import _forms
from ringpose.types.arrays import Array, Float64


class Predicted(NamedTuple):
    """Residuals in standard deviations, and what they were made of; names as in `ringpose.pose.ring_model`."""

    residual: Float64[Array, "row"]
    """Of the lines' ends, then of the break points along their lines."""
    by_state: Float64[Array, "row 7"]
    slope: Float64[Array, "sight"]
    steepness: Float64[Array, "sight"]
    y_by_plane: Float64[Array, "sight 3"]
    rays: Float64[Array, "sight 3"]
    distance_m: Float64[Array, "point"]
    by_ray: Float64[Array, "point 2"]
    distance_by_state: Float64[Array, "point 7"]
    """By way of the predicted ordinate, too."""
    by_x: Float64[Array, "point"]
    along_scale: Float64[Array, "point"]
    origin_m: Float64[Array, "3"]
    origin_by_plane: Float64[Array, "3 3"]
    origin_by_ray: Float64[Array, "3 2"]


def predicted(
    state: Float64[Array, "9"],
    rays: Float64[Array, "sight xyz=3"],
    light: Float64[Array, "sight 4"],
    whitening: Float64[Array, "end end"],
    points: Float64[Array, "point 2"],
) -> Predicted:
    """Prediction of a state: plane 3, outward 3, shift_m, curvature, band_m.

    `light` is normal and distance of each sight's light plane, `points` the sign of each point's edge and the standard
    deviation of its abscissa; `whitening` is made of blocks of two.
    """
    found = np.frombuffer(_forms.rows(state, rays, light, whitening, points), dtype=np.float64)
    return prediction_in(found, len(rays), len(points))


def prediction_in(numbers: Float64[Array, "n"], sights: int, points: int) -> Predicted:
    """The prediction that is laid out in a row of numbers."""
    head, tail = numbers[: 16 * sights], numbers[16 * sights :]
    return Predicted(
        residual=head[:sights],
        by_state=head[sights : 8 * sights].reshape(-1, 7),
        slope=head[8 * sights : 9 * sights],
        steepness=head[9 * sights : 10 * sights],
        y_by_plane=head[10 * sights : 13 * sights].reshape(-1, 3),
        rays=head[13 * sights :].reshape(-1, 3),
        distance_m=tail[:points],
        by_ray=tail[points : 3 * points].reshape(-1, 2),
        distance_by_state=tail[3 * points : 10 * points].reshape(-1, 7),
        by_x=tail[10 * points : 11 * points],
        along_scale=tail[11 * points : 12 * points],
        origin_m=tail[-18:-15],
        origin_by_plane=tail[-15:-6].reshape(3, 3),
        origin_by_ray=tail[-6:].reshape(3, 2),
    )
