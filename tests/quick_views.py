"""A stand-in for the renderer: views in which each laser lights one row, for tests of what happens to the frames."""

import numpy as np

from ringpose.simulate.renderer import RenderedView


def quick_view(scene, view, number):
    """Electron rates of a view; all views look alike."""
    camera = scene.rig.camera
    shape = (camera.image_height, camera.image_width)
    lasers = np.zeros((len(scene.rig.lasers.names), *shape), np.float32)
    for laser in range(len(lasers)):
        lasers[laser, 10 * (laser + 1)] = 2e6
    return RenderedView(
        sensor=scene.sensor,
        ambient=np.full(shape, 2e5, np.float32),
        laser=lasers,
        generator=np.random.default_rng([scene.seed, number]),
    )
