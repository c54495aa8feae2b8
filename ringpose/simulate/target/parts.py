"""The parts of a target, with the height field of crinkled foil, or a board, as the tables of the ray caster."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ringpose.errors import DataError
from ringpose.geometry.board import board_print, outline_m
from ringpose.kernels.render import BOX, MAX_PARTS, MAX_POINTS, NONE, REVOLUTION, TEXELS, TargetTables
from ringpose.simulate.placement import Placement
from ringpose.types.arrays import Array, Float32, Float64
from ringpose.types.board import Board
from ringpose.types.obstacles import Obstacle
from ringpose.types.scene import RingView, Scene
from ringpose.types.target import MATERIALS, Body, Box, Foil, Material, Part, Revolution, RingShape

BODY, RING = "body", "ring"
"""Names of the parts that the keys `body` and `ring` of a scene describe."""


_CRINKLES = 16
"""Number of the largest crinkles along one period."""

_OCTAVES = 3


def view_target(scene: Scene, view: RingView, placement: Placement) -> TargetTables:
    """The parts that a view shows, as tables; a gripper before the camera is where it is at this placement."""
    described = _described(scene, view)
    if not scene.gripper:
        return _tables(*described)
    return target_tables((*_parts(*described), *(_before_camera(part, placement) for part in scene.gripper)))


def _before_camera(part: Part, placement: Placement) -> Part:
    """A part in the camera frame as one in the target frame."""
    return replace(
        part,
        rotation=placement.rotation.T @ part.rotation,
        translation_m=placement.points_target(part.translation_m[:, None])[:, 0],
    )


def part_around(scene: Scene, view: RingView, point_m: Float64[Array, "xyz=3"]) -> str | None:
    """Name of the part of a view that contains a point of the target frame; None if there is none."""
    return next((part.name for part in _parts(*_described(scene, view)) if _contains(part, point_m)), None)


_Described = tuple[Body | None, tuple[Part, ...], RingShape | None, tuple[Obstacle, ...]]


def _described(scene: Scene, view: RingView) -> _Described:
    if view.target == "none":
        return None, (), None, ()
    if view.target == "body":
        return scene.body, scene.parts, None, ()
    return scene.body, scene.parts, scene.ring, scene.obstacles


@lru_cache(maxsize=4)
def _parts(
    body: Body | None, parts: tuple[Part, ...], ring: RingShape | None, obstacles: tuple[Obstacle, ...]
) -> tuple[Part, ...]:
    bodies = () if body is None else (body_part(body),)
    rings = () if ring is None else (ring_part(ring), *(part for each in obstacles for part in each.parts(ring)))
    return (*bodies, *parts, *rings)


@lru_cache(maxsize=4)
def _tables(
    body: Body | None, parts: tuple[Part, ...], ring: RingShape | None, obstacles: tuple[Obstacle, ...]
) -> TargetTables:
    return target_tables(_parts(body, parts, ring, obstacles))


def _contains(part: Part, point_m: Float64[Array, "xyz=3"]) -> bool:
    """Whether a point is in a box, or within the closed profile of a surface of revolution (crossings of a ray)."""
    x, y, z = (point_m - part.translation_m) @ part.rotation
    if isinstance(part.shape, Box):
        return bool(((part.shape.low_m < (x, y, z)) & (part.shape.high_m > (x, y, z))).all())
    first, radius = part.shape.profile_m, float(np.hypot(x, y))
    second = np.roll(first, -1, axis=0)
    crossed = (first[:, 1] > z) != (second[:, 1] > z)
    (r_1, z_1), (r_2, z_2) = first[crossed].T, second[crossed].T
    return bool((radius < r_1 + (z - z_1) * (r_2 - r_1) / (z_2 - z_1)).sum() % 2)


def ring_part(ring: RingShape) -> Part:
    """The interface ring."""
    pieces = range(len(ring.profile_m) - 1)
    return Part(
        name=RING,
        shape=Revolution(profile_m=ring.profile_m),
        materials=(*(ring.face if piece == ring.face_piece else ring.wall for piece in pieces), ring.wall),
        gaps=ring.gaps,
        form=ring.form,
        mass_kg=ring.mass_kg,
    )


def face_part(ring: RingShape) -> Part:
    """The face of a ring alone."""
    piece = ring.face_piece
    shape = Revolution(profile_m=ring.profile_m[piece : piece + 2])
    return Part(name=RING, shape=shape, materials=(ring.face, ring.face))


def body_part(body: Body) -> Part:
    """The box that carries the ring; only its front face is crinkled."""
    half_m = body.size_m[:2] / 2
    shape = Box(
        low_m=np.array([*(body.offset_m - half_m), -body.size_m[2]]), high_m=np.array([*(body.offset_m + half_m), 0.0])
    )
    return Part(name=BODY, shape=shape, materials=(body.material,) * 6, foil=body.foil)


def target_tables(parts: Sequence[Part]) -> TargetTables:
    """The tables of the parts; a target without any is empty space."""
    if len(parts) > MAX_PARTS:
        raise DataError("the target", f"has {len(parts)} parts", f"give at most {MAX_PARTS}")
    rows, points = [], [np.empty((0, 2))]
    gaps: list[list[float]] = []
    forms: list[list[float]] = []
    material_of: list[int] = []
    materials: dict[Material, int] = {}
    foils: dict[Foil, int] = {}
    for part in parts:
        profile_m = part.shape.profile_m if isinstance(part.shape, Revolution) else np.empty((0, 2))
        if len(profile_m) > MAX_POINTS:
            raise DataError(f"part {part.name}", f"has {len(profile_m)} points", f"give at most {MAX_POINTS}")
        low, high, center, radius_m = _bounds(part)
        rows.append([
            BOX if isinstance(part.shape, Box) else REVOLUTION,
            *part.rotation.T.ravel(), *part.translation_m, *low, *high,
            len(material_of), sum(map(len, points)), len(profile_m), len(gaps), len(part.gaps),
            NONE if part.form is None else len(forms),
            NONE if part.foil is None else foils.setdefault(part.foil, len(foils)),
            *(part.rotation @ center + part.translation_m), radius_m,
        ])  # fmt: skip
        points.append(profile_m)
        for gap in part.gaps:
            top_m = profile_m[:, 1].max()
            gaps.append([np.cos(gap.angle_rad), np.sin(gap.angle_rad), gap.width_m / 2, top_m - gap.depth_m])
        if part.form is not None:  # deviations are interpolated between the least and the greatest radius
            radii_m = profile_m[:, 0].min(), profile_m[:, 0].max()
            forms.append([*part.form.radial_m.ravel(), *part.form.axial_m.ravel(), *radii_m])
        surfaces = len(profile_m) or 6  # a surface of revolution has one more than pieces: the walls of its gaps
        all_materials = (*part.materials, *[part.materials[-1]] * surfaces)[:surfaces]
        material_of += [materials.setdefault(material, len(materials)) for material in all_materials]
    reliefs = [relief(foil) for foil in foils]
    return TargetTables(
        parts=np.array(rows).reshape(-1, 30),
        points=np.concatenate(points),
        gaps=np.array(gaps).reshape(-1, 4),
        forms=np.array(forms).reshape(-1, 20),
        material_of=np.array(material_of, dtype=np.int32),
        materials=np.array([_material(material) for material in materials]).reshape(-1, 10),
        print_x=np.empty(0),
        print_y=np.empty(0),
        print_cells=np.zeros((1, 1), dtype=np.uint8),
        texels_m=np.array(
            [[foil_relief.texel_m, np.abs(foil_relief.height_m).max()] for foil_relief in reliefs]
        ).reshape(-1, 2),
        heights_m=np.array([foil_relief.height_m for foil_relief in reliefs], dtype=np.float32).reshape(
            -1, TEXELS, TEXELS
        ),
        slopes=np.array([foil_relief.slope for foil_relief in reliefs], dtype=np.float32).reshape(
            -1, TEXELS, TEXELS, 2
        ),
    )


def _bounds(part: Part) -> tuple[Float64[Array, "3"], Float64[Array, "3"], Float64[Array, "xyz=3"], float]:
    """Bounds of a part's shape in its own frame, as `Part` in target.h has them, and its bounding sphere."""
    if isinstance(part.shape, Box):
        low, high = part.shape.low_m, part.shape.high_m
        return low, high, (low + high) / 2, float(np.linalg.norm(high - low)) / 2 * (1 + 1e-9)
    margin_m = 0.0
    if part.form is not None:  # the largest deviation
        radial_m, axial_m = np.abs(part.form.radial_m), np.abs(part.form.axial_m)
        margin_m = float(max(radial_m.sum(axis=(1, 2)).max(), axial_m.sum()))
    (least, lowest), (greatest, highest) = part.shape.profile_m.min(axis=0), part.shape.profile_m.max(axis=0)
    low = np.array([max(least - margin_m, 0.0), lowest, lowest - margin_m])
    high = np.array([greatest + margin_m, highest, highest + margin_m])
    radius_m = float(np.hypot(high[0], (high[2] - low[2]) / 2)) * (1 + 1e-9)
    return low, high, np.array([0.0, 0.0, (lowest + highest) / 2]), radius_m


def _material(material: Material) -> list[float]:
    coating = [material.diffuse, material.specular, material.roughness]
    grid = material.grid
    if grid is None:
        return [*coating, *coating, 0.0, 0.0, 0.0, 0.0]
    return [*coating, grid.diffuse, grid.specular, grid.roughness, *grid.cell_m, grid.line_m, 0.0]


class Relief(NamedTuple):
    """Height and slopes on a periodic grid, in rows along the first axis of a face."""

    texel_m: float
    height_m: Float32[Array, "row column"]
    slope: Float32[Array, "row column uv=2"]


@lru_cache(maxsize=4)
def relief(foil: Foil) -> Relief:
    """The height field of a foil: ridged noise, each octave finer and lower than the one before.

    Folding smooth noise at zero gives the sharp creases between smooth facets that crinkled foil has.
    """
    texel_m = foil.crinkle_m * _CRINKLES / TEXELS
    generator = np.random.default_rng(foil.seed)
    height = sum(_ridges(generator, _CRINKLES * 2**octave) / 2.2**octave for octave in range(_OCTAVES))
    height = np.asarray(height - np.mean(height))
    height *= foil.rms_m / height.std()
    slopes = [(np.roll(height, -1, axis) - np.roll(height, 1, axis)) / (2 * texel_m) for axis in (1, 0)]
    return Relief(texel_m, height.astype(np.float32), np.stack(slopes, axis=-1).astype(np.float32))


def _ridges(generator: np.random.Generator, crinkles: int) -> Float64[Array, "row column"]:
    """Smooth periodic noise with about this number of bumps along a side, folded at zero."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(TEXELS, 1 / TEXELS), np.fft.fftfreq(TEXELS, 1 / TEXELS)))
    band = np.exp(-(((frequency - crinkles / 2) / (crinkles / 4)) ** 2))
    noise = np.fft.ifft2(band * np.fft.fft2(generator.standard_normal((TEXELS, TEXELS)))).real
    noise /= noise.std()
    ridges: Float64[Array, "row column"] = -np.sqrt(noise**2 + 0.02)
    return ridges


# A calibration board: a print on a flat white sheet, exact at any magnification

BOARD_BORDER_M = 0.012
"""White margin around the print, which markers at its edge require."""

BOARD_THICKNESS_M = 0.005


def board_target(board: Board) -> TargetTables:
    """The board of a board file: its print is the plane z = 0 of the board frame, seen from negative z."""
    width_m, height_m = outline_m(board)
    sheet = Part(
        name="board",
        shape=Box(
            low_m=np.array([-BOARD_BORDER_M, -BOARD_BORDER_M, 0.0]),
            high_m=np.array([width_m + BOARD_BORDER_M, height_m + BOARD_BORDER_M, BOARD_THICKNESS_M]),
        ),
        materials=(MATERIALS["white"],) * 6,
    )
    tables = target_tables([sheet])
    print_x, print_y, cells = board_print(board)
    black = MATERIALS["black"]
    tables.materials[0, 3:] = [black.diffuse, black.specular, black.roughness, 0.0, 0.0, 0.0, 1.0]
    return tables._replace(print_x=print_x, print_y=print_y, print_cells=cells)
