"""The target that rays intersect: the body of the satellite with its ring, in the target frame.

Target frame: origin on the ring's axis in the plane of the body's front face, z along the face's normal
(towards the camera). Surfaces are numbered: the pieces of the ring's profile, then the front face, then the
box's other faces; -1 is empty space.

Crinkled foil is a periodic height field with its slopes, computed once from its seed.
"""

import functools
from dataclasses import dataclass
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np

from ringpose.simulate import surface_of_revolution as revolution
from ringpose.types.arrays import Array, Bool, Complex64, Float32, Float64, Int8, Int64
from ringpose.types.scene import MATERIALS, Body, Foil, Material, RingShape

EMPTY = -1
"""Surface number of empty space."""

Vectors: TypeAlias = Float64[Array, "xyz=3 ray"]

Numbers: TypeAlias = Int8[Array, "ray"]
"""Surface numbers."""

Hits: TypeAlias = tuple[Float64[Array, "ray"], Numbers]
"""Ray parameter and surface number of the intersections of rays."""

_NEWTON_STEPS = 2
"""Newton steps from the flat face to the foil; the remaining error is at most 10 micrometres."""


@runtime_checkable
class Target(Protocol):
    """Surfaces that rays intersect, each of one material."""

    @property
    def materials(self) -> tuple[Material, ...]:
        """The material of each surface number."""

    @property
    def relief_m(self) -> float:
        """Maximum displacement of an intersection along the ray by the relief of a surface."""

    def first_hits(self, eye: Float64[Array, "xyz=3"], direction: Vectors) -> Hits:
        """Parameter and surface number of the first intersection of each ray; inf and -1 without one."""

    def on_relief(
        self, eye: Float64[Array, "xyz=3"], direction: Vectors, parameter: Float64[Array, "ray"], surface: Numbers
    ) -> tuple[Vectors, Vectors]:
        """Points of the surfaces that the rays hit, wrinkles of the foil included, and unit normals towards the camera.

        `parameter` and `surface` are those of `first_hits`, which takes the foil as flat.
        """

    def blocked(self, point: Vectors, towards: Vectors) -> Bool[Array, "ray"]:
        """Whether a surface intersects the segments between the points and the points + towards."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeightField:
    """Height and slopes on a periodic grid over the body's front face, row by row."""

    texel_m: float
    height_m: Float32[Array, "texel"]
    slope: Complex64[Array, "texel"]
    """Slope along x as the real part, along y as the imaginary one: so that one look-up returns both."""

    def tangent(
        self, x: Float64[Array, "ray"], y: Float64[Array, "ray"]
    ) -> tuple[Float64[Array, "ray"], Complex64[Array, "ray"]]:
        """Height and slope of the tangent plane of the relief at the nearest grid point."""
        column, row = np.rint(x / self.texel_m), np.rint(y / self.texel_m)
        index = _index(column.astype(np.int64), row.astype(np.int64))
        slope = self.slope.take(index)
        off_x, off_y = x - column * self.texel_m, y - row * self.texel_m
        return self.height_m.take(index) + slope.real * off_x + slope.imag * off_y, slope

    def slopes(self, x: Float64[Array, "ray"], y: Float64[Array, "ray"]) -> Complex64[Array, "ray"]:
        """Slope, bilinear between grid points, so that specular reflections do not show the grid."""
        column, share_x = _split(x / self.texel_m)
        row, share_y = _split(y / self.texel_m)
        corners = ((column, row), (column + 1, row), (column, row + 1), (column + 1, row + 1))
        near, right, below, far = (self.slope.take(_index(*corner)) for corner in corners)
        top, bottom = near + (right - near) * share_x, below + (far - below) * share_x
        slope: Complex64[Array, "ray"] = top + (bottom - top) * share_y
        return slope


@dataclass(frozen=True, slots=True, eq=False)
class RingTarget:
    """Body and ring."""

    ring: RingShape | None
    body: Body
    materials: tuple[Material, ...]
    pieces: int
    """Number of the ring's pieces; the front face is the next surface."""
    foil: HeightField | None

    @property
    def relief_m(self) -> float:
        """See `Target`; rays up to 60 degrees from the front face's normal."""
        return 0.0 if self.foil is None else 2.0 * float(np.abs(self.foil.height_m).max())

    def first_hits(self, eye: Float64[Array, "xyz=3"], direction: Vectors) -> Hits:
        """See `Target`."""
        parameter, surface = _box_hits(self.body, self.pieces, eye[:, None], direction)
        if self.ring is not None:
            ring_parameter, piece = revolution.first_hits(self.ring.profile_m, eye[:, None], direction)
            nearer = ring_parameter < parameter
            parameter, surface = np.where(nearer, ring_parameter, parameter), np.where(nearer, piece, surface)
        return parameter, surface.astype(np.int8)

    def on_relief(
        self, eye: Float64[Array, "xyz=3"], direction: Vectors, parameter: Float64[Array, "ray"], surface: Numbers
    ) -> tuple[Vectors, Vectors]:
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

    def blocked(self, point: Vectors, towards: Vectors) -> Bool[Array, "ray"]:
        """See `Target`; light from behind the front face does not reach points in front of it."""
        from_behind: Bool[Array, "ray"] = (point[2] + towards[2] < 0) & (point[2] > 0)
        if self.ring is None:
            return from_behind
        lifted = point.copy()
        lifted[2] = np.maximum(point[2], 0.0)
        by_ring = revolution.blocked(self.ring.profile_m, lifted, towards + (point - lifted))
        return np.logical_or(from_behind, by_ring)


@dataclass(frozen=True, slots=True, eq=False)
class EmptySpace:
    """A target without surfaces."""

    materials: tuple[Material, ...] = (MATERIALS["black"],)
    relief_m: float = 0.0

    def first_hits(self, eye: Float64[Array, "xyz=3"], direction: Vectors) -> Hits:
        """See `Target`."""
        return np.full(direction.shape[1], np.inf), np.full(direction.shape[1], EMPTY, dtype=np.int8)

    def on_relief(
        self, eye: Float64[Array, "xyz=3"], direction: Vectors, parameter: Float64[Array, "ray"], surface: Numbers
    ) -> tuple[Vectors, Vectors]:
        """See `Target`; there are no intersections."""
        return eye[:, None] + parameter * direction, -direction

    def blocked(self, point: Vectors, towards: Vectors) -> Bool[Array, "ray"]:
        """See `Target`."""
        return np.zeros(point.shape[1], dtype=np.bool_)


def ring_target(ring: RingShape | None, body: Body) -> RingTarget:
    """The body with or without a ring."""
    pieces = len(ring.profile_m) - 1 if ring is not None else 0
    of_ring = [] if ring is None else [ring.face if k == ring.face_piece else ring.wall for k in range(pieces)]
    foil = relief(body.foil) if body.foil is not None else None
    return RingTarget(ring, body, (*of_ring, *[body.material] * 6), pieces, foil)


def _box_hits(body: Body, front: int, eye: Float64[Array, "xyz=3 1"], direction: Vectors) -> Hits:
    """Intersections of rays with the box (slab method); front face `front`, then x-, x+, y-, y+, z- as front + 1 to 5.

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
    foil: HeightField,
    eye: Float64[Array, "xyz=3"],
    direction: Vectors,
    flat: Float64[Array, "ray"],
) -> tuple[Vectors, Vectors]:
    """Points on the foil, and its normals, for rays that intersect the flat face below it."""
    parameter = flat
    for _ in range(_NEWTON_STEPS):
        x, y, z = eye[:, None] + parameter * direction
        height_m, slope = foil.tangent(x, y)
        parameter = parameter + (height_m - z) / (direction[2] - slope.real * direction[0] - slope.imag * direction[1])
    point = eye[:, None] + parameter * direction
    slope = foil.slopes(point[0], point[1])
    normal = np.stack([-slope.real, -slope.imag, np.ones(len(flat))])
    return point, normal / np.sqrt(np.einsum("ij,ij->j", normal, normal))


_TEXELS = 512

_CRINKLES = 16
"""Number of the largest crinkles along one period."""

_OCTAVES = 3


@functools.lru_cache(maxsize=4)
def relief(foil: Foil) -> HeightField:
    """The height field of a foil: ridged noise, each octave finer and lower than the one before.

    Folding smooth noise at zero gives the sharp creases between smooth facets that crinkled foil has.
    """
    texel_m = foil.crinkle_m * _CRINKLES / _TEXELS
    generator = np.random.default_rng(foil.seed)
    height = sum(_ridges(generator, _CRINKLES * 2**octave) / 2.2**octave for octave in range(_OCTAVES))
    height = np.asarray(height - np.mean(height))
    height *= foil.rms_m / height.std()
    slopes = [(np.roll(height, -1, axis) - np.roll(height, 1, axis)) / (2 * texel_m) for axis in (1, 0)]
    slope = (slopes[0] + 1j * slopes[1]).astype(np.complex64)
    return HeightField(texel_m=texel_m, height_m=height.astype(np.float32).ravel(), slope=slope.ravel())


def _ridges(generator: np.random.Generator, crinkles: int) -> Float64[Array, "row column"]:
    """Smooth periodic noise with about this number of bumps along a side, folded at zero."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(_TEXELS, 1 / _TEXELS), np.fft.fftfreq(_TEXELS, 1 / _TEXELS)))
    band = np.exp(-(((frequency - crinkles / 2) / (crinkles / 4)) ** 2))
    noise = np.fft.ifft2(band * np.fft.fft2(generator.standard_normal((_TEXELS, _TEXELS)))).real
    noise /= noise.std()
    ridges: Float64[Array, "row column"] = -np.sqrt(noise**2 + 0.02)
    return ridges


def _index(column: Int64[Array, "ray"], row: Int64[Array, "ray"]) -> Int64[Array, "ray"]:
    index: Int64[Array, "ray"] = (row % _TEXELS) * _TEXELS + column % _TEXELS
    return index


def _split(position: Float64[Array, "ray"]) -> tuple[Int64[Array, "ray"], Float32[Array, "ray"]]:
    whole = np.floor(position)
    return whole.astype(np.int64), (position - whole).astype(np.float32)
