"""How long a view is exposed: the scene's time, or as long as its stripes need."""

import numpy as np
from jaxtyping import Float64

from ringpose.simulate.break_points import crossings
from ringpose.simulate.lighting import Hits, Stand, laser_radiance
from ringpose.simulate.pixel_rays import pixel_rays
from ringpose.simulate.sensor import electrons_per_radiance
from ringpose.types.arrays import Array
from ringpose.types.scene import Scene

SHORTEST_S, LONGEST_S = 2e-5, 0.1
"""What common cameras expose."""


def view_exposure_s(scene: Scene, stand: Stand) -> float:
    """The scene's exposure, or that which gives the stripes on the ring's face the wanted grey value.

    Taken from the brightest stripe in the middle of the band, rounded to microseconds.
    """
    if scene.stripe_dn is None:
        return scene.exposure_s
    brightest = float(np.max(_stripe_radiances(scene, stand), initial=0.0))
    if brightest == 0.0:
        return scene.exposure_s
    rate_e = brightest * electrons_per_radiance(scene.sensor, scene.lens)
    wanted_e = (scene.stripe_dn - scene.sensor.black_level_dn) / scene.sensor.overall_system_gain_dn_per_e
    return float(np.clip(np.round(wanted_e / rate_e, 6), SHORTEST_S, LONGEST_S))


def _stripe_radiances(scene: Scene, stand: Stand) -> Float64[Array, "crossing"]:
    """Peak radiance of each laser's stripe in the middle of the band, on both sides of the ring, behind the lens."""
    middle_m = np.array([(scene.ring.radius_inner_m + scene.ring.radius_outer_m) / 2])
    found = []
    for side in (-1.0, 1.0):
        for laser, point in enumerate(crossings(stand, scene.ring.height_m, middle_m, side)):
            if np.isfinite(point).all():
                found.append(_peak(scene, stand, laser, point[0]))
    return np.array(found)


def _peak(scene: Scene, stand: Stand, laser: int, point: Float64[Array, "3"]) -> float:
    to_eye = stand.placement.eye_m - point
    depth_m = float((stand.placement.rotation @ point + stand.placement.translation_m)[2])
    if depth_m <= 0:
        return 0.0
    hits = Hits(
        surface=np.array([scene.ring.face_piece], dtype=np.int8),
        point=point[:, None],
        normal=np.array([[0.0], [0.0], [1.0]]),
        to_eye=(to_eye / np.linalg.norm(to_eye))[:, None],
    )
    sigma_px = scene.lasers.sigma_m / (depth_m * pixel_rays(scene.rig.camera).angle_per_px)
    blurred = np.sqrt(sigma_px**2 / (sigma_px**2 + scene.lens.blur_px**2 + 1 / 12))
    return float(laser_radiance(stand, hits, laser)[0][0] * blurred)
