import numpy as np

from ringpose.geometry.rays import rays
from ringpose.simulate.renderer import pixel_rays


def test_rays_through_pixel_centres_agree_with_the_lens_model(small_rig):
    row, column = np.mgrid[0:240, 0:320]
    exact = rays(np.stack([column, row], axis=-1).astype(float).reshape(-1, 2), small_rig.camera)

    cached = pixel_rays(small_rig.camera).direction

    assert np.abs(cached.T - exact[:, :2]).max() * 356 < 1e-4


def test_derivatives_of_rays_are_those_of_the_lens_model(small_rig):
    step_px = np.array([[0.5, 0.0], [0.0, 0.5]])
    place_px = np.array([200.0, 100.0])
    exact = rays(place_px + step_px, small_rig.camera) - rays(place_px - step_px, small_rig.camera)

    per_px = pixel_rays(small_rig.camera).per_px[:, :, 100 * 320 + 200]

    np.testing.assert_allclose(per_px, exact[:, :2], atol=1e-7)
