"""Synthetic images of three laser stripes on a ring with exact ground truth, in kinds that are difficult to detect.

A flat ring stands 60 mm in front of a flat body; each light plane draws a straight piece on the rim of the ring and
one on the body at each side of it. Stripes have Gaussian cross-sections with a standard deviation of 2 to 3 px, pieces
end in an edge blurred by 1 px, and pixels are noisy (`noise_variance`). The truth is computed in closed form.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import cv2
import numpy as np
from recorded_shots import make_shot
from ring_scenes import break_points_of, make_camera, with_lines

from ringpose.geometry.rays import project, undistorted_pixels
from ringpose.types.arrays import Array, Float64, UInt8
from ringpose.types.detection import BreakPoints
from ringpose.types.image import Shot
from ringpose.types.rig import LaserPlanes, Rig

RADII_M = (0.567, 0.597)
BODY_BEHIND_M = 0.06
EDGE_SIGMA_PX = 1.0
PIXEL_SIGMA_PX = 12**-0.5
"""Blur of a sharp edge by the extent of a pixel: standard deviation of a uniform distribution."""

SPECKLE_CONTRAST = 0.25
"""Standard deviation of speckle behind the lens, relative to its mean."""

SHADOW_PX = 12
"""Columns between the rim and the pieces on the body, which lie in the shadow of the ring or behind its wall."""


class Kind(StrEnum):
    """Brightness, noise and background of the stripes."""

    DARK = "dark"
    """Peaks of 140 to 200 on black."""
    DIM = "dim"
    """Peaks of 32 to 45 on black."""
    SPECKLE = "speckle"
    """As dark, with speckle of 25 % contrast and grains of 3 px: those of a rough surface, blurred by the lens."""
    SATURATED = "saturated"
    """Peaks of 350 to 500, clipped at 255."""
    FOIL = "foil"
    """In front of crinkled foil of mean 32."""
    BRIGHT_FOIL = "foilbright"
    """In front of crinkled foil of mean 78, 2 % of it saturated."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StripeImage:
    """An image with all lasers on, and its ground truth."""

    image: UInt8[Array, "row column"]
    rig: Rig
    break_points_px: Float64[Array, "laser edge=2 xy=2"]
    pieces_px: Float64[Array, "piece end=2 xy=2"]
    """Ends of the centre line of each piece in distorted pixels; of the three pieces of a laser the second lies on the
    rim."""
    stripe_sigma_px: float
    peak_dn: Float64[Array, "laser"]


def noise_variance(value_dn: Float64[Array, "*shape"]) -> Float64[Array, "*shape"]:
    """Variance of a pixel with this mean: read noise of 1.5 DN, and shot noise at 20 electrons per grey value."""
    return 1.5**2 + 0.05 * np.maximum(value_dn, 0)


def stripe_rig(scale: float = 1.0, lens: bool = True) -> Rig:
    """The paper's physical rig: lasers at +-10 degrees above an 8 mm lens with pixels of 4.5 um.

    `scale` changes the resolution of the same view; without `lens` there is no distortion, so that pieces are straight.
    """
    tilt = math.radians(10)
    normal = np.array([[0.0, math.cos(tilt), -math.sin(tilt)], [0.0, 1.0, 0.0], [0.0, math.cos(tilt), math.sin(tilt)]])
    return Rig(
        camera=make_camera(
            (round(1600 * scale), round(1200 * scale)),
            (1778.0 * scale, 1778.0 * scale),
            (800.0 * scale, 600.0 * scale),
            np.array([-0.1, 0.1, 0.0, 0.0, 0.0]) * lens,
        ),
        lasers=LaserPlanes(
            names=("left", "middle", "right"),
            normal=normal,
            distance_m=np.array([-0.0394, -0.07, -0.0394]),
            projector_m=np.full((3, 3), np.nan),
        ),
    )


@functools.lru_cache(maxsize=16)
def stripe_image(kind: Kind, seed: int, rig: Rig | None = None) -> StripeImage:
    """One image of a kind with all lasers on; the same seed gives the same ring for every kind."""
    return _image_and_frames(kind, seed, rig, ((0, 1, 2),))[0]


def switched_frames(
    kind: Kind, seed: int, rig: Rig | None = None
) -> tuple[StripeImage, UInt8[Array, "frame=5 row column"]]:
    """The image with all lasers on, and frames of the same view: all lasers, none, then each laser alone."""
    return _image_and_frames(kind, seed, rig, ((0, 1, 2), (), (0,), (1,), (2,)))


def shot_of(image: StripeImage) -> Shot:
    """The image as a shot of one frame with all lasers on."""
    return make_shot(image.image[None], [2 ** len(image.rig.lasers.names) - 1], exposure_s=1e-3)


def switched_shot(frames: UInt8[Array, "frame row column"]) -> Shot:
    """A frame without lasers and one with each laser alone, as a shot."""
    masks = [0, *(1 << laser for laser in range(len(frames) - 1))]
    return make_shot(frames, masks, period_s=0.1, exposure_s=1e-3)


def exact_break_points(image: StripeImage) -> BreakPoints:
    """The true break points, with the standard deviations that detection reports on dark images."""
    ends = np.stack([undistorted_pixels(edges, image.rig.camera) for edges in image.break_points_px])
    covariance_px2 = np.tile(np.diag([0.05**2, 0.01**2]), (3, 2, 1, 1))
    return replace(with_lines(break_points_of(image.break_points_px), ends, 0.01), covariance_px2=covariance_px2)


def moved(points: BreakPoints, shift_px: float = 6.0) -> BreakPoints:
    """Break points shifted right and down, such as a prediction for a ring that has moved since."""
    return replace(
        points,
        position_px=points.position_px + shift_px,
        face_start_undistorted_px=points.face_start_undistorted_px + shift_px,
        face_end_undistorted_px=points.face_end_undistorted_px + shift_px,
    )


def true_row(image: StripeImage, piece: int, x: Float64[Array, "n"]) -> Float64[Array, "n"]:
    """Distorted row of a piece's centre line at distorted columns."""
    ends = undistorted_pixels(image.pieces_px[piece], image.rig.camera)
    steps = np.linspace(-0.02, 1.02, 200)[:, None]
    straight = ends[0] + steps * (ends[1] - ends[0])
    camera = image.rig.camera
    focal = camera.camera_matrix[[0, 1], [0, 1]]
    normalised = (straight - camera.camera_matrix[:2, 2]) / focal
    distorted = project(np.column_stack([normalised, np.ones(len(normalised))]), camera)
    return np.interp(x, distorted[:, 0], distorted[:, 1])


def _image_and_frames(
    kind: Kind, seed: int, rig: Rig | None, lit: Sequence[Sequence[int]]
) -> tuple[StripeImage, UInt8[Array, "frame row column"]]:
    """The image with its truth, and a frame for each choice of lasers; the first frame is that of the image."""
    rng = np.random.default_rng(seed)
    rig = stripe_rig() if rig is None else rig
    center, normal = _ring(rng)
    sigma = float(rng.uniform(2.0, 3.0))
    peak = _peaks(kind, rng)
    pieces = np.array([_pieces(laser, center, normal, rig) for laser in range(3)])
    curves = [_curve_pair(laser, center, normal, rig) for laser in range(3)]
    shape = (rig.camera.image_height, rig.camera.image_width)
    # the lens blurs the stripe and, with it, the grains of the surface
    blur_px = math.sqrt(EDGE_SIGMA_PX**2 - PIXEL_SIGMA_PX**2) if kind is Kind.SPECKLE else 0.0
    own = math.sqrt(sigma**2 - blur_px**2)
    edge_px = PIXEL_SIGMA_PX if blur_px else EDGE_SIGMA_PX
    sections = [(float(each) * sigma / own, own) for each in peak]
    stripes = [_stripe(shape, curves[laser], pieces[laser], sections[laser], edge_px) for laser in range(3)]
    if blur_px:
        grains = _speckle(shape, blur_px, rng)
        stripes = [cv2.GaussianBlur(stripe * grains, (0, 0), blur_px) for stripe in stripes]
    background = _background(kind, shape, rng)
    frames = [_exposed(sum((stripes[i] for i in lasers), np.zeros(shape)) + background, rng) for lasers in lit]
    image = StripeImage(
        image=frames[0],
        rig=rig,
        break_points_px=pieces[:, 1, ::-1],
        pieces_px=pieces.reshape(9, 2, 2),
        stripe_sigma_px=sigma,
        peak_dn=peak,
    )
    return image, np.stack(frames)


def _exposed(light: Float64[Array, "row column"], rng: np.random.Generator) -> UInt8[Array, "row column"]:
    noisy = light + rng.normal(size=light.shape) * np.sqrt(noise_variance(light))
    values: UInt8[Array, "row column"] = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return values


def _ring(rng: np.random.Generator) -> tuple[Float64[Array, "3"], Float64[Array, "3"]]:
    """Centre and normal of a ring whose left arc crosses the image at 0.35 to 0.9 m."""
    depth = rng.uniform(0.35, 0.9)
    normal = np.array([rng.uniform(-0.15, 0.15), rng.uniform(-0.15, 0.15), -1.0])
    center = np.array([RADII_M[1] + rng.uniform(-0.15, 0.05) * depth, rng.uniform(-0.08, 0.08) * depth, depth])
    return center, normal / np.linalg.norm(normal)


def _peaks(kind: Kind, rng: np.random.Generator) -> Float64[Array, "3"]:
    low, high = {Kind.DIM: (32.0, 45.0), Kind.SATURATED: (350.0, 500.0)}.get(kind, (140.0, 200.0))
    return rng.uniform(low, high, 3)


def _line(laser: int, normal: Float64[Array, "3"], distance: float, rig: Rig) -> tuple[Array, Array]:
    """Intersection of a light plane with a plane: a point and the direction towards +x."""
    direction = np.cross(rig.lasers.normal[laser], normal)
    direction *= np.sign(direction[0]) / np.linalg.norm(direction)
    rows = np.stack([rig.lasers.normal[laser], normal, direction])
    return np.linalg.solve(rows, np.array([rig.lasers.distance_m[laser], distance, 0.0])), direction


def _pieces(laser: int, center: Array, normal: Array, rig: Rig) -> Float64[Array, "piece=3 end=2 xy=2"]:
    """The pieces left of, on and right of the rim, each from its left to its right end, in distorted pixels."""
    point, direction = _line(laser, normal, float(normal @ center), rig)
    along = direction @ (point - center)
    beside = (point - center) @ (point - center)
    outer, inner = (-along - math.sqrt(along**2 - beside + radius**2) for radius in RADII_M[::-1])
    face = project(np.array([point + outer * direction, point + inner * direction]), rig.camera)
    curve = _curve(laser, normal, float(normal @ center) - BODY_BEHIND_M, rig)
    edges = np.array([10.0, face[0, 0] - SHADOW_PX, face[1, 0] + SHADOW_PX, rig.camera.image_width - 11.0])
    body = np.stack([edges, np.interp(edges, curve[:, 0], curve[:, 1])], axis=-1)
    return np.stack([body[:2], face, body[2:]])


def _curve(laser: int, normal: Array, distance: float, rig: Rig) -> Float64[Array, "n xy=2"]:
    """Projection of the intersection of a light plane with a plane, in distorted pixels."""
    point, direction = _line(laser, normal, distance, rig)
    reach = np.linspace(-0.75, 0.75, 600) * abs(point[2])
    return project(point + reach[:, None] * direction, rig.camera)


def _curve_pair(laser: int, center: Array, normal: Array, rig: Rig) -> list[Float64[Array, "n xy=2"]]:
    """The laser's curve on the rim and that on the body."""
    distance = float(normal @ center)
    return [_curve(laser, normal, distance - behind, rig) for behind in (0.0, BODY_BEHIND_M)]


def _stripe(
    shape: tuple[int, int], curves: list[Array], pieces: Array, section: tuple[float, float], edge_px: float
) -> Float64[Array, "row column"]:
    """The light of one laser."""
    light = np.zeros(shape)
    for part, (start, end) in enumerate(pieces):
        _draw(light, curves[0 if part == 1 else 1], (float(start[0]), float(end[0])), section, edge_px)
    return light


def _draw(light: Array, curve: Array, ends: tuple[float, float], section: tuple[float, float], edge_px: float) -> None:
    """Add a stripe with a Gaussian section to the light, faded in and out at its ends."""
    peak, sigma = section
    x = np.arange(max(int(ends[0]) - 6, 0), min(int(ends[1]) + 7, light.shape[1]))
    y = np.interp(x, curve[:, 0], curve[:, 1])
    fade = _normal_cdf((x - ends[0]) / edge_px) * _normal_cdf((ends[1] - x) / edge_px)
    reach = math.ceil(5 * sigma)
    rows = np.rint(y).astype(np.int64) + np.arange(-reach, reach + 1)[:, None]
    inside = (rows >= 0) & (rows < light.shape[0])
    value = peak * fade * np.exp(-0.5 * ((rows - y) / sigma) ** 2)
    np.add.at(light, (rows[inside], np.broadcast_to(x, rows.shape)[inside]), value[inside])


def _normal_cdf(values: Float64[Array, "n"]) -> Float64[Array, "n"]:
    return np.array([0.5 * (1 + math.erf(value / math.sqrt(2))) for value in values])


def _speckle(shape: tuple[int, ...], blur_px: float, rng: np.random.Generator) -> Float64[Array, "row column"]:
    """Independent factors of mean one, of `SPECKLE_CONTRAST` when blurred."""
    variance = (SPECKLE_CONTRAST * 2 * math.sqrt(math.pi) * blur_px) ** 2
    return rng.gamma(1 / variance, variance, shape)


def _background(kind: Kind, shape: tuple[int, ...], rng: np.random.Generator) -> Float64[Array, "row column"]:
    """Black, or crinkled foil: facets of a Voronoi pattern with ridges, most of them dull, some specular."""
    if kind not in (Kind.FOIL, Kind.BRIGHT_FOIL):
        return np.zeros(shape)
    count = 1500 * shape[0] * shape[1] // (1600 * 1200)
    seeds = np.full(shape, 255, dtype=np.uint8)
    seeds[rng.integers(0, shape[0], count), rng.integers(0, shape[1], count)] = 0
    _, cells = cv2.distanceTransformWithLabels(seeds, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    facets = rng.normal(size=(int(cells.max()) + 1, 2))[cells]
    ridges = cv2.GaussianBlur(rng.normal(size=(*shape, 2)), (0, 0), 6.0)
    slope = cv2.GaussianBlur(facets + 0.5 * ridges / ridges.std(), (0, 0), 0.8)
    dull = np.maximum(1 + 0.4 * slope[..., 0], 0.1)
    glint = np.exp(-np.sum((slope - 1.2) ** 2, axis=-1) / 0.1)
    foil = dull + 6 * glint
    mean = 32.0 if kind is Kind.FOIL else 78.0
    brightness: Float64[Array, "row column"] = foil * mean / foil.mean()
    return brightness
