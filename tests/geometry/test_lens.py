"""The map of a lens from rays to pixels is one-to-one inside the image, or the first fold is found."""

import numpy as np
import pytest

from ringpose.geometry.rays import fold_px
from ringpose.types.rig import Camera

FOCAL, PRINCIPAL = 1000.0, (800.0, 600.0)


def camera(*coefficients, principal=PRINCIPAL):
    return Camera(
        camera_name="",
        image_width=1600,
        image_height=1200,
        camera_matrix=np.array([[FOCAL, 0, principal[0]], [0, FOCAL, principal[1]], [0, 0, 1.0]]),
        distortion_model="plumb_bob" if len(coefficients) == 5 else "rational_polynomial",
        distortion_coefficients=np.array(coefficients, dtype=np.float64),
    )


@pytest.mark.parametrize(
    "lens",
    [
        camera(0, 0, 0, 0, 0),
        camera(-0.105, 0.118, 0.00055, -0.0004, 0),
        camera(-0.3, 0.1, 0, 0, 0),  # barrel: monotonic up to any angle
        camera(-0.14, 0, 0, 0, 0),  # folds at a radius of 1028 px, outside the corners
        camera(10, 5, 0, 0, 1, 10.3, 8, 2),
        camera(0, 0, 0, 0, 0, -0.3, 0, 0),  # a pole outside the image
        camera(0.1, 0, 0, 0, 0, principal=(-400.0, 600.0)),  # a window beside the principal point
        camera(0.1, 0, 0, 0, 0, principal=(-0.5, -0.5)),
    ],
)
def test_one_to_one_lens_has_no_fold(lens):
    assert fold_px(lens) is None


@pytest.mark.parametrize("k1", [-0.5, -0.3, -0.2])
def test_fold_of_a_barrel_lens_is_where_the_distorted_radius_is_largest(k1):
    found = fold_px(camera(k1, 0, 0, 0, 0))

    largest = FOCAL * 2 / 3 * np.sqrt(1 / (-3 * k1))  # r (1 + k1 r^2) at its maximum, r^2 = -1 / (3 k1)
    assert found is not None
    assert np.linalg.norm(found - PRINCIPAL) == pytest.approx(largest, rel=0.01)


@pytest.mark.parametrize(
    "coefficients",
    [
        (-0.02, -0.37, 2.4, 3.3, 0),  # four radial coefficients in the places of k1, k2, p1, p2
        (1e6, 0, 0, 0, 0),
        (-1e12, 0, 0, 0, 0),
        (1e30, 1e30, 0, 0, 1e30),
        (0, 0, 0, 0, 0, 1e4, 0, 0),  # all rays end within a few pixels of the axis
    ],
)
def test_coefficients_of_no_lens_fold_the_image(coefficients):
    assert fold_px(camera(*coefficients)) is not None
