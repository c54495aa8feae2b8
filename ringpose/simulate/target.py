"""What the rays meet: the body with its ring, in the target's own frame.

Target frame: origin on the ring's axis in the plane of the body's front face, z along the face's normal
(towards the camera). Surfaces are numbered: the pieces of the ring's profile, then the front face, then the
box's other faces; -1 is empty space.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from ringpose.simulate import revolution
from ringpose.simulate.foil import Relief, relief
from ringpose.types.arrays import Array, Bool, Float64, Int8
from ringpose.types.scene import MATERIALS, Body, Material, RingShape

EMPTY = -1

_SETTLING_STEPS = 2
"""Newton steps from the flat face to the foil, each to the plane that touches it; 10 micrometres at most remain."""


@runtime_checkable
class Target(Protocol):
    """Surfaces that rays meet, each of one material."""

    @property
    def materials(self) -> tuple[Material, ...]:
        """By number of the surface."""

    @property
    def relief_m(self) -> float:
        """The farthest that a surface's relief moves a point of it along a ray."""

    def first_hits(
        self, eye: Float64[Array, "xyz=3"], direction: Float64[Array, "xyz=3 ray"]
    ) -> tuple[Float64[Array, "ray"], Int8[Array, "ray"]]:
        """Parameter of each ray's first hit, and the surface; inf and -1 without one."""

    def settled(
        self,
        eye: Float64[Array, "xyz=3"],
        direction: Float64[Array, "xyz=3 ray"],
        parameter: Float64[Array, "ray"],
        surface: Int8[Array, "ray"],
    ) -> tuple[Float64[Array, "xyz=3 ray"], Float64[Array, "xyz=3 ray"]]:
        """Points of the hits on the surfaces' fine relief, and unit normals towards the eye."""

    def blocked(self, point: Float64[Array, "xyz=3 ray"], towards: Float64[Array, "xyz=3 ray"]) -> Bool[Array, "ray"]:
        """Whether something stands between the points and the points + towards."""


@dataclass(frozen=True, slots=True, eq=False)
class RingTarget:
    """Body and ring."""

    ring: RingShape | None
    body: Body
    materials: tuple[Material, ...]
    pieces: int
    """Number of the ring's pieces; the front face is the next surface."""
    foil: Relief | None

    @property
    def relief_m(self) -> float:
        """See `Target`; rays up to 60 degrees from the front face's normal."""
        return 0.0 if self.foil is None else 2.0 * float(np.abs(self.foil.height_m).max())

    def first_hits(
        self, eye: Float64[Array, "xyz=3"], direction: Float64[Array, "xyz=3 ray"]
    ) -> tuple[Float64[Array, "ray"], Int8[Array, "ray"]]:
        """See `Target`."""
        parameter, surface = _box_hits(self.body, self.pieces, eye[:, None], direction)
        if self.ring is not None:
            ring_parameter, piece = revolution.first_hits(self.ring.profile_m, eye[:, None], direction)
            nearer = ring_parameter < parameter
            parameter, surface = np.where(nearer, ring_parameter, parameter), np.where(nearer, piece, surface)
        return parameter, surface.astype(np.int8)

    def settled(
        self,
        eye: Float64[Array, "xyz=3"],
        direction: Float64[Array, "xyz=3 ray"],
        parameter: Float64[Array, "ray"],
        surface: Int8[Array, "ray"],
    ) -> tuple[Float64[Array, "xyz=3 ray"], Float64[Array, "xyz=3 ray"]]:
        """See `Target`."""
        point = eye[:, None] + parameter * direction
        normal = np.zeros_like(point)
        on_ring = np.flatnonzero(surface < self.pieces)
        if self.ring is not None and len(on_ring):
            normal[:, on_ring] = revolution.normals(self.ring.profile_m, point[:, on_ring], surface[on_ring])
        side = surface - self.pieces
        normal[2, side == 0] = 1.0
        for axis in range(3):
            normal[axis, (side + 1) // 2 == axis + 1] = 1.0
        if self.foil is not None:
            front = np.flatnonzero(side == 0)
            point[:, front], normal[:, front] = _on_foil(self.foil, eye, direction[:, front], parameter[front])
        away = np.einsum("ij,ij->j", normal, direction) > 0
        normal[:, away & (side != 0)] *= -1
        return point, normal

    def blocked(self, point: Float64[Array, "xyz=3 ray"], towards: Float64[Array, "xyz=3 ray"]) -> Bool[Array, "ray"]:
        """See `Target`; light from behind the front face does not reach what stands on it."""
        from_behind: Bool[Array, "ray"] = (point[2] + towards[2] < 0) & (point[2] > 0)
        if self.ring is None:
            return from_behind
        lifted = point.copy()
        lifted[2] = np.maximum(point[2], 0.0)
        by_ring = revolution.blocked(self.ring.profile_m, lifted, towards + (point - lifted))
        return np.logical_or(from_behind, by_ring)


@dataclass(frozen=True, slots=True, eq=False)
class EmptySpace:
    """Nothing to meet."""

    materials: tuple[Material, ...] = (MATERIALS["black"],)
    relief_m: float = 0.0

    def first_hits(
        self, eye: Float64[Array, "xyz=3"], direction: Float64[Array, "xyz=3 ray"]
    ) -> tuple[Float64[Array, "ray"], Int8[Array, "ray"]]:
        """See `Target`."""
        return np.full(direction.shape[1], np.inf), np.full(direction.shape[1], EMPTY, dtype=np.int8)

    def settled(
        self,
        eye: Float64[Array, "xyz=3"],
        direction: Float64[Array, "xyz=3 ray"],
        parameter: Float64[Array, "ray"],
        surface: Int8[Array, "ray"],
    ) -> tuple[Float64[Array, "xyz=3 ray"], Float64[Array, "xyz=3 ray"]]:
        """See `Target`; there is no hit to settle."""
        return eye[:, None] + parameter * direction, -direction

    def blocked(self, point: Float64[Array, "xyz=3 ray"], towards: Float64[Array, "xyz=3 ray"]) -> Bool[Array, "ray"]:
        """See `Target`."""
        return np.zeros(point.shape[1], dtype=np.bool_)


def ring_target(ring: RingShape | None, body: Body) -> RingTarget:
    """The body, with a ring or bare."""
    pieces = len(ring.profile_m) - 1 if ring is not None else 0
    of_ring = [] if ring is None else [ring.face if k == ring.face_piece else ring.wall for k in range(pieces)]
    foil = relief(body.foil) if body.foil is not None else None
    return RingTarget(ring, body, (*of_ring, *[body.material] * 6), pieces, foil)


def _box_hits(
    body: Body, front: int, eye: Float64[Array, "xyz=3 1"], direction: Float64[Array, "xyz=3 ray"]
) -> tuple[Float64[Array, "ray"], Int8[Array, "ray"]]:
    """Where rays enter the box (slab by slab); front face `front`, then x-, x+, y-, y+, z- as front + 1 to 5.

    The number's half, (surface - front + 1) // 2, is the axis of the face's normal, counted from 1.
    """
    half = np.array([body.size_m[0] / 2, body.size_m[1] / 2])
    low = np.array([*(body.offset_m - half), -body.size_m[2]])
    high = np.array([*(body.offset_m + half), 0.0])
    with np.errstate(divide="ignore", invalid="ignore"):
        first = (low[:, None] - eye) / direction
        second = (high[:, None] - eye) / direction
        entries, leave = np.minimum(first, second), np.maximum(first, second).min(axis=0)
    enter = entries.max(axis=0)
    hit = (enter <= leave) & (enter > 0)
    side = np.where(entries[0] == enter, np.where(direction[0] > 0, 1, 2), np.where(direction[1] > 0, 3, 4))
    side = np.where(entries[2] == enter, np.where(direction[2] > 0, 5, 0), side)
    return np.where(hit, enter, np.inf), np.where(hit, front + side, EMPTY).astype(np.int8)


def _on_foil(
    foil: Relief,
    eye: Float64[Array, "xyz=3"],
    direction: Float64[Array, "xyz=3 ray"],
    flat: Float64[Array, "ray"],
) -> tuple[Float64[Array, "xyz=3 ray"], Float64[Array, "xyz=3 ray"]]:
    """Points on the foil, and its normals, for rays that meet the flat face under it."""
    parameter = flat
    for _ in range(_SETTLING_STEPS):
        x, y, z = eye[:, None] + parameter * direction
        height_m, slope = foil.tangent(x, y)
        parameter = parameter + (height_m - z) / (direction[2] - slope.real * direction[0] - slope.imag * direction[1])
    point = eye[:, None] + parameter * direction
    slope = foil.slopes(point[0], point[1])
    normal = np.stack([-slope.real, -slope.imag, np.ones(len(flat))])
    return point, normal / np.sqrt(np.einsum("ij,ij->j", normal, normal))
