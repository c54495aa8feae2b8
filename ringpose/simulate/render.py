"""Light in the camera's pixels, source by source: cast once, light as often as needed.

Light adds up, so one cast gives a layer for the ambient light and one for each laser; every frame of a shot is
a sum of layers. A pixel takes one ray; near a stripe, and with ambient light also along visible edges, sixteen.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8, UInt16

from ringpose.simulate.lighting import Hits, Stand, ambient_radiance, laser_radiance, settled_hits
from ringpose.simulate.pixel_rays import SAMPLES, PixelRays, centre_directions, sample_directions
from ringpose.simulate.sheets import half_thickness_m, in_sheet
from ringpose.simulate.target import EMPTY
from ringpose.types.arrays import Array

_BLOCK = 1 << 15
"""Rays worked on at a time, so that they stay in the processor's cache."""

_COARSEST_SIGMA = 1.25
"""A stripe is thin where a pixel covers more sigmas than this; the alias of one ray shifts a wider one by < 1e-5 px."""

_SLACK = 0.002
"""Of the depth: about three pixels of an 8 mm lens, so that the neighbours of a stripe are cast as well."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layers:
    """Radiance in W/(m2 sr), averaged over each pixel."""

    ambient: Float32[Array, "row column"]
    laser: Float32[Array, "laser row column"]


def layers(stand: Stand, rays: PixelRays) -> Layers:
    """What each source of light sends into each pixel."""
    radiance, refine = _one_ray_a_pixel(stand, rays)
    refined = np.flatnonzero(refine)
    for block in _blocks(len(refined), _BLOCK // SAMPLES):
        radiance[:, refined[block]] = _sampled(stand, rays, refined[block])
    ambient, *laser = radiance.reshape(-1, rays.height, rays.width)
    return Layers(ambient=ambient, laser=np.stack(laser))


def _one_ray_a_pixel(stand: Stand, rays: PixelRays) -> tuple[Float32[Array, "source pixel"], Bool[Array, "pixel"]]:
    """Radiance by one ray a pixel, ambient light first, and the pixels for which one ray does not do."""
    pixels, lasers = rays.height * rays.width, len(stand.sheets.distance_m)
    radiance, thin = np.zeros((1 + lasers, pixels), np.float32), np.zeros(pixels, np.uint8)
    code = np.zeros(pixels, np.uint16)
    for block in _blocks(pixels, _BLOCK):
        direction = stand.placement.vectors_target(centre_directions(rays, block))
        hit, hits, depth_m = _cast(stand, direction)
        radiance[0, block][hit], shadowed = ambient_radiance(stand, hits)
        code[block][hit] = ((hits.surface.astype(np.uint16) + 1) << (lasers + 1)) | shadowed
        footprint_m = rays.angle_per_px * depth_m
        for laser in range(lasers):
            near = np.flatnonzero(in_sheet(stand.sheets, laser, hits.point, footprint_m))
            radiance[1 + laser, block][hit[near]], shadowed = laser_radiance(stand, hits.at(near), laser)
            code[block][hit[near]] |= shadowed.astype(np.uint16) << (laser + 1)
            thin[block][hit[near]] |= footprint_m[near] > _COARSEST_SIGMA * half_thickness_m(
                stand.sheets.light, depth_m[near]
            )
    return radiance, _refined(code, thin, rays)


def _cast(
    stand: Stand, direction: Float64[Array, "xyz=3 ray"]
) -> tuple[Int64[Array, "hit"], Hits, Float64[Array, "hit"]]:
    """The rays that meet something (if only lasers shine, something near a sheet), where, and how deep."""
    eye = stand.placement.eye_m
    parameter, surface = stand.target.first_hits(eye, direction)
    hit = np.flatnonzero(surface != EMPTY)
    if not stand.is_lit:
        flat = eye[:, None] + parameter[hit] * direction[:, hit]
        slack_m = stand.target.relief_m + _SLACK * parameter[hit]
        near = [in_sheet(stand.sheets, laser, flat, slack_m) for laser in range(len(stand.sheets.distance_m))]
        hit = hit[np.any(near, axis=0)]
    hits = settled_hits(stand, direction[:, hit], parameter[hit], surface[hit])
    return hit, hits, parameter[hit]


def _refined(code: UInt16[Array, "pixel"], thin: UInt8[Array, "pixel"], rays: PixelRays) -> Bool[Array, "pixel"]:
    """Pixels on or beside a thin stripe, and those whose neighbours show another surface or side of a shadow."""
    around, shape = np.ones((3, 3), np.uint8), (rays.height, rays.width)
    picture = code.reshape(shape)
    refined = (cv2.dilate(thin.reshape(shape), around) > 0) | (
        cv2.dilate(picture, around) != cv2.erode(picture, around)
    )
    return np.asarray(refined.ravel())


def _sampled(stand: Stand, rays: PixelRays, pixels: Int64[Array, "n"]) -> list[Float64[Array, "n"]]:
    """Mean over each pixel's samples: ambient light, then laser by laser."""
    hit, hits, _ = _cast(stand, stand.placement.vectors_target(sample_directions(rays, pixels)))
    radiance = [ambient_radiance(stand, hits)[0]]
    radiance += [laser_radiance(stand, hits, laser)[0] for laser in range(len(stand.sheets.distance_m))]
    return [_pixel_means(of_source, hit, len(pixels)) for of_source in radiance]


def _pixel_means(radiance: Float64[Array, "hit"], hit: Int64[Array, "hit"], pixels: int) -> Float64[Array, "pixel"]:
    of_rays = np.zeros(SAMPLES * pixels)
    of_rays[hit] = radiance
    means: Float64[Array, "pixel"] = of_rays.reshape(SAMPLES, pixels).mean(axis=0)
    return means


def _blocks(length: int, block: int) -> Iterator[slice]:
    for start in range(0, length, block):
        yield slice(start, min(start + block, length))
