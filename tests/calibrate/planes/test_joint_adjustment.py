"""Standard deviations of stripe centres in the joint adjustment."""

from dataclasses import replace

import numpy as np
import pytest
from known_views import TRUE_CAMERA, projected_px, stripe_views

from ringpose.calibrate.planes.joint_adjustment import joint_data

NOISE_PX = 0.03


def distorted_px(straight_px: np.ndarray, camera) -> np.ndarray:
    rays = np.column_stack([straight_px, np.ones(len(straight_px))]) @ np.linalg.inv(camera.camera_matrix).T
    return projected_px(rays, camera)


@pytest.fixture
def wide_camera():
    return replace(TRUE_CAMERA, distortion_coefficients=np.array([-0.3, 0.4, 0.0, 0.0, 0.3]))


@pytest.fixture
def independent_view(wide_camera, rng):
    """A view with lines across the image, above and below its middle, whose centres have independent errors."""
    turn, place = np.eye(3), np.array([-0.15, -0.12, 0.5])
    (view,) = stripe_views([(turn, place)], rng)
    abscissa = np.arange(100.0, 1500.0)
    lines = [np.column_stack([abscissa, 0.05 * abscissa + offset]) for offset in (150.0, 500.0, 1000.0)]
    noise = [NOISE_PX * rng.standard_normal((len(abscissa), 1)) * [[0.0, 1.0]] for _ in lines]
    seen = [distorted_px(line, wide_camera) + own for line, own in zip(lines, noise, strict=True)]
    return replace(view, stripes_px=tuple(seen))


def test_distortion_is_not_taken_for_correlated_errors(independent_view, wide_camera):
    data = joint_data([independent_view], wide_camera, corner_px=np.array([0.02]))

    assert data.center_px[0] == pytest.approx(NOISE_PX, rel=0.15)
