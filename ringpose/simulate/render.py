"""Light in the camera's pixels, source by source: cast once, light as often as needed.

Light adds up, so one cast gives a layer for the ambient light and one for each laser; every frame of a shot is
a sum of layers. A pixel takes one ray; on a thin stripe, and with ambient light also along visible edges, sixteen;
where an edge cuts a stripe, 256.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from ringpose.simulate.lighting import Hits, Stand, ambient_radiance, laser_radiance, settled_hits
from ringpose.simulate.pixel_rays import FINE_SAMPLES, SAMPLES, PixelRays, centre_directions, sample_directions
from ringpose.simulate.sheets import half_thickness_m, in_sheet
from ringpose.simulate.target import EMPTY
from ringpose.types.arrays import Array, Float32, Float64, Int64, UInt8, UInt16

_BLOCK = 1 << 15
"""Rays worked on at a time, so that they stay in the processor's cache."""

_COARSEST_SIGMA = 1.25
"""A stripe is thin where a pixel covers more sigmas than this; the alias of one ray shifts a wider one by < 1e-5 px."""

_WIDE, _THIN = np.uint8(1), np.uint8(2)
"""Marks of pixels near a stripe."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layers:
    """Radiance in W/(m2 sr), averaged over each pixel."""

    ambient: Float32[Array, "row column"]
    laser: Float32[Array, "laser row column"]


def layers(stand: Stand, rays: PixelRays) -> Layers:
    """What each source of light sends into each pixel."""
    radiance, coarse, fine = _one_ray_a_pixel(stand, rays)
    for refined, samples in ((coarse, SAMPLES), (fine, FINE_SAMPLES)):
        for block in _blocks(len(refined), _BLOCK // samples):
            radiance[:, refined[block]] = _sampled(stand, rays, refined[block], samples)
    ambient, *laser = radiance.reshape(-1, rays.height, rays.width)
    return Layers(ambient=ambient, laser=np.stack(laser))


def _one_ray_a_pixel(
    stand: Stand, rays: PixelRays
) -> tuple[Float32[Array, "source pixel"], Int64[Array, "coarse"], Int64[Array, "fine"]]:
    """Radiance by one ray a pixel, ambient light first, and the pixels that need more rays."""
    pixels, lasers = rays.height * rays.width, len(stand.sheets.distance_m)
    radiance, stripe = np.zeros((1 + lasers, pixels), np.float32), np.zeros(pixels, np.uint8)
    code = np.zeros(pixels, np.uint16)
    for block in _blocks(pixels, _BLOCK):
        direction = stand.placement.vectors_target(centre_directions(rays, block))
        hit, hits, footprint_m = _cast(stand, direction, rays.angle_per_px)
        radiance[0, block][hit], shadowed = ambient_radiance(stand, hits)
        code[block][hit] = ((hits.surface.astype(np.uint16) + 1) << (lasers + 1)) | shadowed
        for laser in stand.lasers:
            near = np.flatnonzero(in_sheet(stand.sheets, laser, hits.point, footprint_m))
            radiance[1 + laser, block][hit[near]], shadowed = laser_radiance(stand, hits.at(near), laser)
            code[block][hit[near]] |= shadowed.astype(np.uint16) << (laser + 1)
            sigma_m = half_thickness_m(stand.sheets.light, footprint_m[near] / rays.angle_per_px)
            stripe[block][hit[near]] |= np.where(footprint_m[near] > _COARSEST_SIGMA * sigma_m, _THIN, _WIDE)
    return radiance, *_to_refine(code, stripe, rays, everywhere=stand.is_lit)


def _to_refine(
    code: UInt16[Array, "pixel"], stripe: UInt8[Array, "pixel"], rays: PixelRays, *, everywhere: bool
) -> tuple[Int64[Array, "coarse"], Int64[Array, "fine"]]:
    """Pixels for some rays and for many.

    Some: on a thin stripe, and, if ambient light shows them, on edges, where neighbours show another surface or
    another side of a shadow. Many: where an edge cuts a stripe, which is what break points are measured from.
    """
    around, shape = np.ones((3, 3), np.uint8), (rays.height, rays.width)
    picture = code.reshape(shape)
    edge = cv2.dilate(picture, around) != cv2.erode(picture, around)
    fine = edge & (cv2.dilate(stripe.reshape(shape), around) > 0)
    coarse = cv2.dilate(stripe.reshape(shape) & _THIN, around) > 0
    if everywhere:
        coarse |= edge
    return np.flatnonzero(coarse & ~fine), np.flatnonzero(fine)


def _cast(
    stand: Stand, direction: Float64[Array, "xyz=3 ray"], angle_per_px: float
) -> tuple[Int64[Array, "hit"], Hits, Float64[Array, "hit"]]:
    """The rays that meet something, where, and what a pixel covers there.

    If only lasers shine, only what is near a sheet counts: four pixels, so that the neighbours of a stripe are known.
    """
    eye = stand.placement.eye_m
    parameter, surface = stand.target.first_hits(eye, direction)
    hit = np.flatnonzero(surface != EMPTY)
    if not stand.is_lit:
        flat = eye[:, None] + parameter[hit] * direction[:, hit]
        slack_m = stand.target.relief_m + 4.0 * angle_per_px * parameter[hit]
        near = [in_sheet(stand.sheets, laser, flat, slack_m) for laser in stand.lasers]
        hit = hit[np.any(near, axis=0)] if near else hit[:0]
    hits = settled_hits(stand, direction[:, hit], parameter[hit], surface[hit])
    return hit, hits, angle_per_px * parameter[hit]


def _sampled(stand: Stand, rays: PixelRays, pixels: Int64[Array, "n"], samples: int) -> Float64[Array, "source n"]:
    """Mean over each pixel's samples: ambient light, then laser by laser."""
    direction = stand.placement.vectors_target(sample_directions(rays, pixels, samples))
    hit, hits, _ = _cast(stand, direction, rays.angle_per_px)
    of_sources = [(0, ambient_radiance(stand, hits)[0])]
    of_sources += [(1 + laser, laser_radiance(stand, hits, laser)[0]) for laser in stand.lasers]
    means = np.zeros((1 + len(stand.sheets.distance_m), len(pixels)))
    for source, radiance in of_sources:
        of_rays = np.zeros(samples * len(pixels))
        of_rays[hit] = radiance
        means[source] = of_rays.reshape(samples, -1).mean(axis=0)
    return means


def _blocks(length: int, block: int) -> Iterator[slice]:
    for start in range(0, length, block):
        yield slice(start, min(start + block, length))
