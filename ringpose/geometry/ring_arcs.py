"""The two edges of a ring's face as arcs on a plane, and how they move when the ring does.

Seven numbers as in method(7), section 5, but about a point of the band between the stripes instead of the centre:
they stay regular where the arcs look straight, and a few stripes determine most of them at once.
"""

from dataclasses import dataclass

import numpy as np

from ringpose.types.arrays import Array, Float64

STATE = ("tilt_x", "tilt_y", "lift_m", "shift_m", "turn_rad", "curvature", "half_band_m")
"""Order of a step of `RingArcs`: the plane's tilts and offset, place and direction of the band, its shape."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingArcs:
    """Two arcs about one centre in a plane, in the camera frame.

    The middle of the band passes through `origin`, the centre lies in the direction of the first of `axes`,
    the third is the plane's normal.
    """

    origin: Float64[Array, "xyz=3"]
    axes: Float64[Array, "3 xyz=3"]
    curvature: float
    """One over the mean radius; negative if the centre is on the other side."""
    half_band_m: float


def arc_points(
    arcs: RingArcs, along_m: Float64[Array, "n"], side: Float64[Array, "n"]
) -> tuple[Float64[Array, "n xyz=3"], Float64[Array, "n xyz=3"]]:
    """Points on the edges (`side` 1: the inner, -1: the outer) and there the unit vectors that lead off the face.

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
    """How far beyond its edge (out of the face) each ray meets the ring's plane, and the derivatives by the state."""
    across, along, normal = arcs.axes
    denominator = rays @ normal
    scale = (arcs.origin @ normal) / denominator
    offset = rays * scale[:, None] - arcs.origin
    x, y = offset @ across, offset @ along

    bend = arcs.curvature
    to_center = np.hypot(1 - bend * x, bend * y)
    slope_x, slope_y = (1 - bend * x) / to_center, -bend * y / to_center
    height = (2 * x - bend * (x**2 + y**2)) / (1 + to_center)
    by_bend = (-(x**2 + y**2) + height * (slope_x * x + slope_y * y)) / (1 + to_center)

    by_lift = (slope_x * (rays @ across) + slope_y * (rays @ along)) / denominator
    derivatives = np.stack(
        [-x * by_lift, -y * by_lift, by_lift, -slope_x, slope_x * y - slope_y * x, by_bend, -side], axis=-1
    )
    return side * height - arcs.half_band_m, side[:, None] * derivatives


def moved(arcs: RingArcs, step: Float64[Array, "state=7"]) -> RingArcs:
    """The arcs after a step of their state; Cayley's transform keeps the axes at right angles."""
    tilt_x, tilt_y, lift_m, shift_m, turn_rad = step[:5].tolist()
    skew = np.array([[0.0, turn_rad, -tilt_x], [-turn_rad, 0.0, -tilt_y], [tilt_x, tilt_y, 0.0]])
    turn: Float64[Array, "3 3"] = np.linalg.solve(np.eye(3) - skew / 2, np.eye(3) + skew / 2)
    return RingArcs(
        origin=arcs.origin + lift_m * arcs.axes[2] + shift_m * arcs.axes[0],
        axes=turn @ arcs.axes,
        curvature=arcs.curvature + float(step[5]),
        half_band_m=arcs.half_band_m + float(step[6]),
    )
