"""Ray casting of targets and their radiance (the sources are shapes.c, shading.c and render.c).

Rays are intersected with boxes and surfaces of revolution in closed form; light is reflected once.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ringpose.kernels import _kernels, kernel_record
from ringpose.types.arrays import Array, Bool, Float32, Float64, Int32, Int64, UInt8

BOX, REVOLUTION = _kernels.BOX, _kernels.REVOLUTION
"""Kinds of parts."""

NONE = _kernels.EMPTY
"""No surface, no form, no relief."""

TEXELS = _kernels.RELIEF_TEXELS
"""Side of a relief."""

MAX_PARTS, MAX_POINTS, MAX_LASERS = _kernels.MAX_PARTS, _kernels.MAX_POINTS, _kernels.MAX_LASERS
"""Maximum numbers of parts of a target, points of a profile, lasers of a rig."""


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


@kernel_record
@dataclass(frozen=True, slots=True, kw_only=True)
class SceneLight:
    """Other light than that of lamps, and properties that all lasers have in common.

    Directions are unit vectors towards the light, in the camera frame.
    """

    ambient_w_m2: float
    """Irradiance by a laboratory."""
    sun_w_m2: float
    """Irradiance across the rays."""
    sun_x: float
    sun_y: float
    sun_z: float
    sun_radius_rad: float
    earth_w_m2: float
    earth_x: float
    earth_y: float
    earth_z: float
    earth_radius_rad: float
    lit_x: float
    lit_y: float
    lit_z: float
    """The middle of the Earth's lit part."""
    earth_radiance: float
    """Where the sun is in the zenith, W/(m2 sr)."""
    power_w: float
    sigma_m: float
    divergence_rad: float
    fan_rad: float
    angle_per_px: float
    """Width of a pixel at depth 1."""


class View(NamedTuple):
    """A target, its light, and the rays of an image's pixels; columns are the members of the structs in render.c."""

    target: TargetTables
    poses: Float64[Array, "time column=12"]
    """camera_from_target (rotation in rows, translation) at equal steps of the exposure."""
    lamps: Float64[Array, "lamp=4 column=5"]
    lasers: Float64[Array, "laser column=12"]
    light: SceneLight
    xy: Float64[Array, "xy=2 pixel"]
    """Rays (x, y, 1) of the pixels."""
    per_px: Float64[Array, "axis=2 xy=2 pixel"] | None
    """Derivatives of the rays by column and row; needed for more than one sample of a pixel."""
    width: int

    def blank_image(self) -> "PixelImage":
        """An image without light."""
        pixels = self.xy.shape[1]
        radiance = np.zeros((1 + len(self.lasers), pixels), np.float32)
        return PixelImage(radiance, np.zeros(pixels, np.int32), np.zeros(pixels, np.uint8))


class PixelImage(NamedTuple):
    """The image that `render` fills."""

    radiance: Float32[Array, "source pixel"]
    """W/(m2 sr): ambient light first, then each laser."""
    code: Int32[Array, "pixel"]
    """Equal for two pixels that show the same surface in the same light (see `Code of a pixel` in render.c)."""
    stripe: UInt8[Array, "pixel"]
    """Not 0 near a stripe; the bit `THIN` near one that is thinner than about a pixel."""


THIN = _kernels.THIN
"""Bit of a pixel near a stripe that is thinner than about a pixel."""


def render(
    view: View, image: PixelImage, pixels: Int64[Array, "chosen"] | None = None, samples: int = 1, step: int = 1
) -> None:
    """Fill the chosen pixels of the image, or all, with the mean radiance of their samples.

    A single sample is cast at the middle pose. If a pixel has several samples, its code and stripe are those of the
    last one. A ray is cast for every sample, but of the samples in a pixel that hit the same surface only one in `step`
    is shaded.
    """
    _kernels.render(*view.target, *view[1:], pixels, samples, step, *image)


def code_edges(code: Int32[Array, "row column"]) -> UInt8[Array, "row column"]:
    """2 if one of the eight neighbours shows another surface, 1 if only the shadow of sun or Earth differs, else 0."""
    edge = np.empty(code.shape, np.uint8)
    _kernels.code_edges(np.pad(code, 1, mode="edge"), edge)
    return edge


class Hits(NamedTuple):
    """The first intersection of each ray with a target."""

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
