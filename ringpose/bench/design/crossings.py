"""Where a rig's stripes cross the face of a ring, and where the step behind it is resolved (method(7), section 14).

These limits follow from rig and ring alone: at a distance at which no stripe crosses the face inside the image, or the
step to what lies behind is narrower than the stripe, no detector measures the ring.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ringpose.geometry.rays import project
from ringpose.geometry.rotations import cross, facing_normal
from ringpose.optics.feature_errors import BORDER_PX, FULL_WIDTH_SIGMAS, row_offset_px_m
from ringpose.simulate.light import half_thickness_m
from ringpose.simulate.placement import image_ray, ring_rotation
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.rig import Rig
from ringpose.types.scene import Scene
from ringpose.types.table import Table

NEAREST_M, FARTHEST_M, STEP = 0.05, 5.0, 1.01
"""Distances that are searched for limits, each farther than the one before by this factor."""

IN_WORDS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Crossings:
    """What a ring at one distance, facing the camera, shows of the stripes."""

    distance_m: float
    arc: Bool[Array, "laser"]
    """Lasers whose stripe shows two ends of one piece if an arc of the ring is in the middle of the image."""
    whole: Bool[Array, "laser"]
    """Lasers whose stripe shows all of its ends if the centre of the ring is in the middle of the image."""
    step_px: float
    """Smallest offset across a stripe between the face and what lies behind it."""
    width_px: float
    """Full width of the stripe's section at half of its maximum."""

    @property
    def is_resolved(self) -> bool:
        """Whether the step is at least as large as the stripe is wide."""
        return self.step_px >= self.width_px


def ends_in_view(
    rig: Rig,
    center_m: Float64[Array, "xyz=3"],
    normal: Float64[Array, "xyz=3"],
    radius_m: Float64[Array, "edge=2"],
) -> list[list[bool]]:
    """For each laser the pieces of its stripe on the face, and whether both ends of each lie in the image.

    A stripe at the distance u from the centre has two pieces (u below the inner radius), one with two outer ends, or
    none (u beyond the outer radius), method(7), section 14.
    """
    pieces: list[list[bool]] = []
    for light, distance_m in zip(rig.lasers.normal, rig.lasers.distance_m.tolist(), strict=True):
        along = cross(light, normal)
        along /= np.linalg.norm(along)
        aside = cross(normal, along)
        foot_m = center_m + aside * (distance_m - light @ center_m) / (light @ aside)
        inner, outer = np.sqrt(np.maximum(radius_m**2 - ((foot_m - center_m) ** 2).sum(), 0.0)).tolist()
        places = [] if outer == 0.0 else [[-outer, outer]] if inner == 0.0 else [[-outer, -inner], [inner, outer]]
        ends_px = project(foot_m + np.array(places).reshape(-1, 2, 1) * along, rig.camera)
        size_px = np.array([rig.camera.image_width, rig.camera.image_height]) - 1.0
        inside: Bool[Array, "piece end=2 xy=2"] = (ends_px > BORDER_PX) & (ends_px < size_px - BORDER_PX)
        pieces.append(np.asarray(inside.all(axis=(1, 2))).tolist())
    return pieces


def crossings(scene: Scene, distance_m: float, pitch_rad: float = 0.0, yaw_rad: float = 0.0) -> Crossings:
    """What the scene's ring shows at a distance; the arc is the one left of the ring's centre, as in the maps."""
    rig, radius_m = scene.rig, np.array([scene.ring.radius_inner_m, scene.ring.radius_outer_m])
    normal, middle_m = facing_normal(pitch_rad, yaw_rad), distance_m * image_ray(scene.rig.camera, np.zeros(2))
    arc_m = middle_m + radius_m.mean() * ring_rotation(normal, 0.0)[:, 0]
    focal = float(rig.camera.camera_matrix[0, 0] if rig.stripes_along_columns else rig.camera.camera_matrix[1, 1])
    behind_m = distance_m + scene.ring.height_m
    section_px = focal / distance_m * half_thickness_m(scene.lasers, np.array([distance_m]))[0]
    return Crossings(
        distance_m=distance_m,
        arc=np.array([any(pieces) for pieces in ends_in_view(rig, arc_m, normal, radius_m)]),
        whole=np.array([bool(pieces) and all(pieces) for pieces in ends_in_view(rig, middle_m, normal, radius_m)]),
        step_px=float(row_offset_px_m(rig).min() * (1.0 / distance_m - 1.0 / behind_m)),
        width_px=float(FULL_WIDTH_SIGMAS * np.hypot(section_px, scene.lens.blur_px)),
    )


def crossing_table(of_distances: Sequence[Crossings]) -> Table:
    """A row of text for each distance."""
    rows = [
        [
            f"{1e3 * crossing.distance_m:.0f} mm",
            str(int(crossing.arc.sum())),
            str(int(crossing.whole.sum())),
            f"{crossing.step_px:.1f}",
            f"{crossing.width_px:.1f}",
            "yes" if crossing.is_resolved else "no",
        ]
        for crossing in of_distances
    ]
    headings = ["distance", "stripes on an arc", "on the whole ring", "step px", "stripe px", "step resolved"]
    return Table(headings=headings, rows=rows)


def limit_lines(scene: Scene, pitch_rad: float = 0.0, yaw_rad: float = 0.0) -> list[str]:
    """From where to where the face shows how many stripes, and the step is resolved, in words."""
    count = int(np.log(FARTHEST_M / NEAREST_M) / np.log(STEP)) + 1
    every = [crossings(scene, NEAREST_M * STEP**number, pitch_rad, yaw_rad) for number in range(count)]
    lasers, ring = len(scene.rig.lasers.names), scene.ring
    numbers = [*range(lasers, 0, -1)]
    arcs = [f"{_stripes(number)} {_range(every, lambda each, n=number: each.arc.sum() >= n)}" for number in numbers]  # type: ignore[misc]
    whole = [f"{_stripes(number)} {_range(every, lambda each, n=number: each.whole.sum() >= n)}" for number in numbers]  # type: ignore[misc]
    width_mm = 1e3 * (ring.radius_outer_m - ring.radius_inner_m)
    return [
        f"a ring of {ring.radius_outer_m:g} m, its face {width_mm:.0f} mm wide and {1e3 * ring.height_m:.0f} mm before "
        "what lies behind it, facing the camera:",
        f"  an arc in the middle of the image: {', '.join(arcs)}",
        f"  the whole ring in the middle of the image: {', '.join(whole)}",
        f"  the step behind the face is wider than the stripe: {_range(every, lambda each: each.is_resolved)}",
    ]


def _stripes(number: int) -> str:
    return f"{IN_WORDS[number]} stripe{'s' * (number > 1)}"


def _range(every: Sequence[Crossings], holds: Callable[[Crossings], bool]) -> str:
    """The ranges of distances at which something holds, such as `from 310 to 1020 mm`."""
    held = [False, *(bool(holds(each)) for each in every), False]
    changes = [number for number, (before, after) in enumerate(pairwise(held)) if before != after]
    ranges = []
    for start, end in zip(changes[::2], changes[1::2], strict=True):
        first, last = 1e3 * every[start].distance_m, 1e3 * every[end - 1].distance_m
        since, until = f"from {first:.0f}" if start else "", f"to {last:.0f}" if end < len(every) else ""
        ranges.append(" ".join(filter(None, [since, until, "mm"])) if since or until else "at all distances")
    return " and ".join(ranges) or "never"
