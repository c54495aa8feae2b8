"""Exposure time of a view: that of the scene, or the one that gives the stripes the requested grey value."""

from dataclasses import replace

import numpy as np

from ringpose.geometry.rays import project
from ringpose.simulate.break_points import crossings, in_image
from ringpose.simulate.laser_planes import half_thickness_m, irradiance_w_m2
from ringpose.simulate.lighting import IlluminatedTarget, reflectance_per_sr, surfaces
from ringpose.simulate.placement import MAX_DURATION_S, MIN_DURATION_S
from ringpose.simulate.renderer import pixel_rays
from ringpose.simulate.sensor import electrons_per_radiance
from ringpose.simulate.target import ring_target
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.scene import Scene


def view_exposure_s(scene: Scene, illuminated: IlluminatedTarget) -> float:
    """The exposure of the scene, or the one that gives the stripes on the rim the grey value `stripe_dn`.

    Computed from the brightest stripe at the mean circle of the rim, rounded to microseconds. A view without the ring
    has the same exposure as one with it.
    """
    if scene.stripe_dn is None:
        return scene.exposure_s
    with_ring = replace(illuminated, target=ring_target(scene.ring, scene.body))
    brightest = float(np.max(_stripe_radiances(scene, with_ring), initial=0.0))
    if brightest == 0.0:
        return scene.exposure_s
    rate_e = brightest * electrons_per_radiance(scene.sensor, scene.lens)
    stripe_e = (scene.stripe_dn - scene.sensor.black_level_dn) / scene.sensor.overall_system_gain_dn_per_e
    return float(np.clip(np.round(stripe_e / rate_e, 6), MIN_DURATION_S, MAX_DURATION_S))


def _stripe_radiances(scene: Scene, illuminated: IlluminatedTarget) -> Float64[Array, "crossing"]:
    """Peak radiance, after the blur of the lens, of each visible stripe at the mean circle of the rim."""
    middle_m = np.array([(scene.ring.radius_inner_m + scene.ring.radius_outer_m) / 2])
    points = np.concatenate(
        [crossings(illuminated, scene.ring.height_m, middle_m, side) for side in (-1.0, 1.0)], axis=1
    )
    lasers, sides = np.nonzero(
        in_image(project(illuminated.placement.points_camera(points), scene.rig.camera), scene.rig.camera)
    )
    point = points[lasers, sides]
    depth_m = illuminated.placement.points_camera(point)[:, 2]
    per_px_m = depth_m * pixel_rays(scene.rig.camera).angle_per_px
    sigma_px = half_thickness_m(scene.lasers, depth_m) / per_px_m
    blurred = sigma_px / np.sqrt(sigma_px**2 + scene.lens.blur_px**2 + 1 / 12)
    radiances: Float64[Array, "crossing"] = blurred * face_stripe_radiance(
        illuminated, scene.ring.face_piece, point.T, lasers
    )
    return radiances


def face_stripe_radiance(
    illuminated: IlluminatedTarget, face_piece: int, point: Float64[Array, "xyz=3 n"], lasers: Int64[Array, "n"]
) -> Float64[Array, "n"]:
    """Peak radiance towards the camera of stripes on the ring's face, at points on their light planes, target frame.

    The face is the highest flat piece of the ring and taken as not occluded.
    """
    normal = np.zeros_like(point)
    normal[2] = 1.0
    to_projector, to_eye = (
        vector / np.sqrt((vector * vector).sum(axis=0))
        for vector in (illuminated.sheets.projector_m[lasers].T - point, illuminated.placement.eye_m[:, None] - point)
    )
    material = surfaces(illuminated.target.materials, np.full(len(lasers), face_piece, dtype=np.int8))
    irradiance = np.array(
        [irradiance_w_m2(illuminated.sheets, int(laser), point[:, [k]])[0] for k, laser in enumerate(lasers)]
    )
    cosine = np.maximum(to_projector[2], 0.0)
    radiance: Float64[Array, "n"] = irradiance * cosine * reflectance_per_sr(material, normal, to_projector, to_eye)
    return radiance
