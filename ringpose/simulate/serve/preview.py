"""A scene with smaller images of the same view, which are faster to render."""

from dataclasses import replace

import numpy as np

from ringpose.types.scene import Scene


def preview(scene: Scene, width: int) -> Scene:
    """The scene with images of this width: same field of view and sensor size, larger pixels.

    The pixel (0, 0) is the centre of a pixel, so that positions scale about (-0.5, -0.5). Pixels of the preview collect
    more light; the gain is lowered by as much, so that grey values remain.
    """
    camera = scene.rig.camera
    factor = width / camera.image_width
    if factor >= 1.0:
        return scene
    height = max(1, round(factor * camera.image_height))
    matrix = camera.camera_matrix * np.array([[factor], [factor], [1.0]])
    matrix[:2, 2] += (factor - 1.0) / 2.0
    sensor = replace(
        scene.sensor,
        pixel_m=scene.sensor.pixel_m / factor,
        saturation_capacity_e=scene.sensor.saturation_capacity_e / factor**2,
        overall_system_gain_dn_per_e=scene.sensor.overall_system_gain_dn_per_e * factor**2,
    )
    smaller = replace(camera, image_width=width, image_height=height, camera_matrix=matrix)
    return replace(
        scene,
        rig=replace(scene.rig, camera=smaller),
        sensor=sensor,
        lens=replace(scene.lens, blur_px=scene.lens.blur_px * factor),
    )
