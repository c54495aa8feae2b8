import numpy as np

from ringpose.geometry.rays import rays
from ringpose.simulate.renderer import SAMPLES, centre_directions, pixel_rays, sample_directions


def test_rays_through_pixel_centres_agree_with_the_lens_model(small_rig):
    row, column = np.mgrid[0:240, 0:320]
    exact = rays(np.stack([column, row], axis=-1).astype(float).reshape(-1, 2), small_rig.camera)

    cached = centre_directions(pixel_rays(small_rig.camera), slice(0, 240 * 320))

    assert np.abs(cached.T - exact).max() * 356 < 1e-4


def test_samples_fill_their_pixel_evenly(small_rig):
    """Sixteen different rows and columns within half a pixel, with the pixel centre as their mean."""
    camera = small_rig.camera
    pixel = 100 * 320 + 200
    sampled = sample_directions(pixel_rays(camera), np.array([pixel]))

    centre = centre_directions(pixel_rays(camera), slice(pixel, pixel + 1))
    off_px = (sampled - centre)[:2] * 356.0
    assert len(np.unique(off_px.round(3)[0])) == len(np.unique(off_px.round(3)[1])) == SAMPLES
    assert np.abs(off_px).max() < 0.52
    assert np.abs(off_px.mean(axis=1)).max() < 0.04


def test_neighbours_sample_different_columns(small_rig):
    rays_of_camera = pixel_rays(small_rig.camera)
    first, second = (sample_directions(rays_of_camera, np.array([pixel])) for pixel in (5000, 5001))

    centres = [centre_directions(rays_of_camera, slice(pixel, pixel + 1)) for pixel in (5000, 5001)]

    shift_px = 356.0 * np.abs((first - centres[0])[0] - (second - centres[1])[0])
    assert shift_px.max() > 0.1
