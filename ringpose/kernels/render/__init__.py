"""Ray casting of targets and their radiance (the sources are shapes.c, shading.c and render.c).

Rays are intersected with boxes and surfaces of revolution in closed form; light is reflected once.
"""

from typing import NamedTuple

import numpy as np

from ringpose.kernels import _kernels
from ringpose.types.arrays import Array, Bool, Float32, Float64, Int32, Int64, UInt8

BOX, REVOLUTION = 0, 1
"""Kinds of parts."""

NONE = -1
"""No surface, no form, no relief."""

TEXELS = 512
"""Side of a relief."""

MAX_PARTS, MAX_POINTS, MAX_LASERS = 128, 64, 8
"""Of a target, of a profile, of a rig."""


class TargetTables(NamedTuple):
    """A target as the kernels take it; the columns are the members of the structs in target.h."""

    parts: Float64[Array, "part column=30"]
    points: Float64[Array, "point 2"]
    gaps: Float64[Array, "gap 4"]
    forms: Float64[Array, "form column=20"]
    material_of: Int32[Array, "surface"]
    materials: Float64[Array, "material column=10"]
    print_x: Float64[Array, "line_x"]
    """Lines along which a print changes its coating."""
    print_y: Float64[Array, "line_y"]
    print_cells: UInt8[Array, "cell_y cell_x"]
    """1 where the print has the material's second coating."""
    texels_m: Float64[Array, "relief 2"]
    """Side of a texel, and the largest height."""
    heights_m: Float32[Array, "relief texel_y texel_x"]
    slopes: Float32[Array, "relief texel_y texel_x uv=2"]


class View(NamedTuple):
    """A lit target, and the pixels of an image of it; rows are the members of the structs in render.c."""

    target: TargetTables
    poses: Float64[Array, "time column=12"]
    """camera_from_target (rotation in rows, translation) at equal steps of the exposure."""
    lamps: Float64[Array, "lamp=4 column=5"]
    lasers: Float64[Array, "laser column=11"]
    light: tuple[float, ...]
    """Of the struct Light: other light, and properties that all lasers have in common."""
    xy: Float64[Array, "xy=2 pixel"]
    """Rays (x, y, 1) of the pixels."""
    per_px: Float64[Array, "axis=2 xy=2 pixel"] | None
    """Their derivatives; only several samples of a pixel need them."""
    width: int

    def blank_image(self) -> "PixelImage":
        """An image without light."""
        pixels = self.xy.shape[1]
        radiance = np.zeros((1 + len(self.lasers), pixels), np.float32)
        return PixelImage(radiance, np.zeros(pixels, np.int32), np.zeros(pixels, np.uint8))


class PixelImage(NamedTuple):
    """What `render` fills for the chosen pixels."""

    radiance: Float32[Array, "source pixel"]
    """W/(m2 sr): ambient light first, then each laser."""
    code: Int32[Array, "pixel"]
    """Equal where two pixels show the same surface, sunlit or not."""
    stripe: UInt8[Array, "pixel"]
    """Bits `WIDE` and `THIN` near a stripe that is wider or thinner than about a pixel."""


WIDE, THIN = 1, 2


def render(
    view: View, image: PixelImage, pixels: Int64[Array, "chosen"] | None = None, samples: int = 1, step: int = 1
) -> None:
    """Fill the image of the chosen pixels, or of all, with the mean over their samples.

    A single sample has the middle pose. The code and the stripe of several samples are those of the last one. All
    samples are cast; of those of each surface in a pixel, one in `step` is shaded for all.
    """
    _kernels.render(*view.target, *view[1:], pixels, samples, step, *image)


def crossed(view: View, code: Int32[Array, "pixel"], pixels: Int64[Array, "chosen"]) -> Bool[Array, "chosen"]:
    """Which of the chosen pixels an edge of a surface or of a laser's shadow may cross.

    Those whose four corners, at the first and the last pose, and middle do not all have the code of the image.
    """
    result = np.empty(len(pixels), np.uint8)
    _kernels.crossed(*view.target, *view[1:], pixels, code, result)
    return result.astype(np.bool_)


def code_edges(code: Int32[Array, "row column"]) -> UInt8[Array, "row column"]:
    """Where a neighbour of the eight shows another surface (2), or another side of the shadow of sun or Earth (1)."""
    edge = np.empty(code.shape, np.uint8)
    _kernels.code_edges(np.pad(code, 1, mode="edge"), edge)
    return edge


class Hits(NamedTuple):
    """First intersections of rays."""

    parameter: Float64[Array, "ray"]
    """Without crinkles of foil; inf without an intersection."""
    surface: Int32[Array, "ray"]
    """`NONE` without an intersection."""
    point_m: Float64[Array, "xyz=3 ray"]
    normal: Float64[Array, "xyz=3 ray"]
    """Unit normals towards the viewer."""


def first_hits(
    target: TargetTables, origin: Float64[Array, "xyz=3 #ray"], direction: Float64[Array, "xyz=3 ray"]
) -> Hits:
    """The first intersections of the rays, in the target frame, at 1 nm or more from their origins."""
    rays = direction.shape[1]
    hits = Hits(np.empty(rays), np.empty(rays, np.int32), np.empty((3, rays)), np.empty((3, rays)))
    origin = np.ascontiguousarray(np.broadcast_to(origin, direction.shape))
    _kernels.hits(*target, origin, np.ascontiguousarray(direction), *hits)
    return hits


def blocked(
    target: TargetTables, point: Float64[Array, "xyz=3 ray"], towards: Float64[Array, "xyz=3 ray"]
) -> Bool[Array, "ray"]:
    """Whether a part intersects the segments between the points and the points + towards."""
    return np.asarray(first_hits(target, point, towards).parameter < 1.0)
