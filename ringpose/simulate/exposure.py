"""Exposure time of a view: that of the scene, or the one that gives the stripes the requested grey value."""

from dataclasses import replace

import numpy as np

from ringpose.geometry.rays import project
from ringpose.optics.sensor import electrons_per_radiance
from ringpose.simulate.break_points import inside_image, ring_crossings_m
from ringpose.simulate.light import IlluminatedTarget, half_thickness_m, radiance_along
from ringpose.simulate.placement import MAX_DURATION_S, MIN_DURATION_S
from ringpose.simulate.renderer import angle_per_px
from ringpose.simulate.target.parts import face_part, target_tables
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.scene import Scene
from ringpose.types.target import RingShape


def view_exposure_s(scene: Scene, illuminated: IlluminatedTarget) -> float:
    """The exposure of the scene, or the one that gives the stripes on the rim the grey value `stripe_dn`.

    Computed from the brightest stripe at the mean circle of the rim, rounded to microseconds. A view without the ring
    has the same exposure as one with it.
    """
    if scene.stripe_dn is None:
        return scene.exposure_s
    brightest = float(np.max(_stripe_radiances(scene, illuminated), initial=0.0))
    if brightest == 0.0:
        return scene.exposure_s
    rate_e = brightest * electrons_per_radiance(scene.sensor, scene.lens)
    stripe_e = (scene.stripe_dn - scene.sensor.black_level_dn) / scene.sensor.overall_system_gain_dn_per_e
    return float(np.clip(np.round(stripe_e / rate_e, 6), MIN_DURATION_S, MAX_DURATION_S))


def _stripe_radiances(scene: Scene, illuminated: IlluminatedTarget) -> Float64[Array, "crossing"]:
    """Peak radiance, after the blur of the lens, of each visible stripe at the mean circle of the rim."""
    camera, planes = scene.rig.camera, scene.rig.lasers
    middle_m = np.full(2, (scene.ring.radius_inner_m + scene.ring.radius_outer_m) / 2)
    points = np.stack([ring_crossings_m(illuminated, scene.ring, middle_m, side)[:, 0] for side in (-1.0, 1.0)], axis=1)
    lasers, sides = np.nonzero(inside_image(project(points, camera), -0.5, camera))
    point_m = points[lasers, sides]
    per_px_m = point_m[:, 2] * angle_per_px(camera)
    range_m = np.linalg.norm(point_m - planes.projector_m[lasers], axis=1)
    sigma_px = half_thickness_m(scene.lasers, range_m) / per_px_m
    blurred = sigma_px / np.sqrt(sigma_px**2 + scene.lens.blur_px**2 + 1 / 12)
    radiances: Float64[Array, "crossing"] = blurred * face_stripe_radiance(illuminated, scene.ring, point_m, lasers)
    return radiances


def face_stripe_radiance(
    illuminated: IlluminatedTarget, ring: RingShape, point_m: Float64[Array, "n xyz=3"], lasers: Int64[Array, "n"]
) -> Float64[Array, "n"]:
    """Peak radiance towards the camera of stripes on the ring's face, at points on their light planes, camera frame.

    The face is taken as not occluded and lit by every laser.
    """
    alone = replace(
        illuminated,
        target=target_tables([face_part(ring)]),
        lasers=tuple(range(len(illuminated.planes.distance_m))),
    )
    radiance: Float64[Array, "n"] = radiance_along(alone, point_m)[1 + lasers, np.arange(len(point_m))].astype(float)
    return radiance
