"""The two edges of a ring's face as concentric arcs in a plane, with derivatives with respect to their parameters.

The seven parameters are those of ringpose-method(7), section 5, but relative to a point of the band between the stripes
instead of the centre: they are regular where the arcs are nearly straight, and a few stripes determine most of them.
"""

from dataclasses import dataclass

import numpy as np

from ringpose.types.arrays import Array, Float64

STATE = ("tilt_x", "tilt_y", "lift_m", "shift_m", "turn_rad", "curvature", "half_band_m")
"""Components of a step of `RingArcs`: tilts and offset of the plane, position and direction of the band, its shape."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingArcs:
    """Two arcs about one centre in a plane, in the camera frame.

    The middle of the band passes through `origin`, the centre lies in the direction of the first of `axes`,
    the third is the plane's normal.
    """

    origin: Float64[Array, "xyz=3"]
    axes: Float64[Array, "3 xyz=3"]
    curvature: float
    """Inverse of the mean radius in 1/m; negative if the centre is on the other side."""
    half_band_m: float


def arc_points(
    arcs: RingArcs, along_m: Float64[Array, "n"], side: Float64[Array, "n"]
) -> tuple[Float64[Array, "n xyz=3"], Float64[Array, "n xyz=3"]]:
    """Points on the edges (`side` 1: inner, -1: outer) and the unit vectors there that point off the face.

    `along_m` is the distance from the origin along the middle of the band.
    """
    angle = arcs.curvature * along_m
    toward = np.stack([np.cos(angle), -np.sin(angle)], axis=-1)
    middle = np.stack(
        [angle * along_m / 2 * np.sinc(angle / (2 * np.pi)) ** 2, along_m * np.sinc(angle / np.pi)], axis=-1
    )
    flat = middle + (side * arcs.half_band_m)[:, None] * toward
    return arcs.origin + flat @ arcs.axes[:2], (side[:, None] * toward) @ arcs.axes[:2]


def off_face_m(
    arcs: RingArcs, rays: Float64[Array, "n xyz=3"], side: Float64[Array, "n"]
) -> tuple[Float64[Array, "n"], Float64[Array, "n state=7"]]:
    """Distance off the face, from its edge, at which each ray meets the ring's plane; derivatives w.r.t. the state."""
    across, along, normal = arcs.axes
    denominator = rays @ normal
    scale = (arcs.origin @ normal) / denominator
    offset = rays * scale[:, None] - arcs.origin
    x, y = offset @ across, offset @ along

    # Signed distance inside the mean circle, (1 - to_center) / curvature, in the form that is regular at curvature 0
    curvature = arcs.curvature
    to_center = np.hypot(1 - curvature * x, curvature * y)
    slope_x, slope_y = (1 - curvature * x) / to_center, -curvature * y / to_center
    height = (2 * x - curvature * (x**2 + y**2)) / (1 + to_center)
    height_wrt_curvature = (-(x**2 + y**2) + height * (slope_x * x + slope_y * y)) / (1 + to_center)

    height_wrt_lift = (slope_x * (rays @ across) + slope_y * (rays @ along)) / denominator
    height_wrt_turn = slope_x * y - slope_y * x
    derivatives = np.stack(
        [
            -x * height_wrt_lift,
            -y * height_wrt_lift,
            height_wrt_lift,
            -slope_x,
            height_wrt_turn,
            height_wrt_curvature,
            -side,
        ],
        axis=-1,
    )
    return side * height - arcs.half_band_m, side[:, None] * derivatives


def moved(arcs: RingArcs, step: Float64[Array, "state=7"]) -> RingArcs:
    """The arcs after a step of their state; Cayley's transform keeps the axes orthonormal."""
    tilt_x, tilt_y, lift_m, shift_m, turn_rad = step[:5].tolist()
    skew = np.array([[0.0, turn_rad, -tilt_x], [-turn_rad, 0.0, -tilt_y], [tilt_x, tilt_y, 0.0]])
    turn: Float64[Array, "3 3"] = np.linalg.solve(np.eye(3) - skew / 2, np.eye(3) + skew / 2)
    return RingArcs(
        origin=arcs.origin + lift_m * arcs.axes[2] + shift_m * arcs.axes[0],
        axes=turn @ arcs.axes,
        curvature=arcs.curvature + float(step[5]),
        half_band_m=arcs.half_band_m + float(step[6]),
    )
