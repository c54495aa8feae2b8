"""Pixels that an edge may cross, which are the only ones with many samples."""

import numpy as np
import pytest

from ringpose.kernels import render
from ringpose.simulate.light import IlluminatedTarget, caster_view
from ringpose.simulate.placement import Placement
from ringpose.simulate.renderer import pixel_rays
from ringpose.simulate.target.parts import body_part, target_tables
from ringpose.types.rig import Camera
from ringpose.types.scene import LaserLight, Light
from ringpose.types.target import Body

CAMERA = Camera(
    camera_name="pinhole",
    image_width=80,
    image_height=60,
    camera_matrix=np.array([[100.0, 0.0, 39.5], [0.0, 100.0, 29.5], [0.0, 0.0, 1.0]]),
    distortion_model="plumb_bob",
    distortion_coefficients=np.zeros(5),
)


@pytest.mark.parametrize("moved_px", [0.0, 3.0])
def test_pixels_that_the_outline_of_a_box_crosses_during_the_exposure_are_found(scene, moved_px):
    """A box that faces the camera 1 m away, from 20.3 to 60.3 px and from 10.3 to 50.3 px, moves along the rows."""
    body = Body(size_m=np.array([0.4, 0.4, 0.1]))
    center_m = np.array([0.008, 0.008, 1.0])
    during = tuple(
        Placement(rotation=np.diag([1.0, -1.0, -1.0]), translation_m=center_m + np.array([0.01 * shift, 0.0, 0.0]))
        for shift in ((0.0,) if moved_px == 0.0 else (-moved_px / 2, 0.0, moved_px / 2))
    )
    illuminated = IlluminatedTarget(
        target=target_tables([body_part(body)]), placement=during[len(during) // 2], during=during,
        planes=scene.rig.lasers, laser_light=LaserLight(), light=Light(name="lamp", ambient_w_m2=1.0), lasers=(),
    )  # fmt: skip
    rays = pixel_rays(CAMERA)
    view = caster_view(illuminated, rays.angle_per_px, rays.direction, rays.per_px, rays.width)
    image = view.blank_image()
    render.render(view, image)

    crossed = render.crossed(view, image.code, np.arange(80 * 60)).reshape(60, 80)

    column, row = np.meshgrid(np.arange(80), np.arange(60))
    left, right, top, bottom = 20.3, 60.3, 10.3, 50.3
    outer = (column + 0.5 > left - moved_px / 2) & (column - 0.5 < right + moved_px / 2)
    outer &= (row + 0.5 > top) & (row - 0.5 < bottom)
    inner = (column - 0.5 > left + moved_px / 2) & (column + 0.5 < right - moved_px / 2)
    inner &= (row - 0.5 > top) & (row + 0.5 < bottom)
    np.testing.assert_array_equal(crossed, outer & ~inner)
