import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ring_scenes import make_camera

from ringpose.geometry.rays import intersect, project, rays, undistort, undistorted_pixels

DISTORTIONS = {
    "plumb_bob": [-0.105, 0.118, 0.00055, -0.0004, 0.01],
    "rational_polynomial": [-0.1, 0.11, 0.0005, -0.0004, 0.02, 0.01, -0.02, 0.005],
}
X, Y = st.floats(-0.4, 0.4), st.floats(-0.3, 0.3)


@pytest.fixture(scope="module", params=list(DISTORTIONS))
def camera(request):
    return make_camera((1600, 1200), (1781.3, 1780.6), (803.7, 596.2), DISTORTIONS[request.param])


def by_the_book(camera, x, y):
    """Pixel of a normalised image point, by the formula of OpenCV's manual."""
    k1, k2, p1, p2, k3, k4, k5, k6 = np.pad(camera.distortion_coefficients, (0, 8))[:8]
    r2 = x * x + y * y
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    distorted_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    distorted_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.array([1781.3 * distorted_x + 803.7, 1780.6 * distorted_y + 596.2])


@given(x=X, y=Y, depth=st.floats(0.1, 3.0))
def test_projection_follows_the_manuals_formula(camera, x, y, depth):
    pixel = project(depth * np.array([x, y, 1.0]), camera)

    np.testing.assert_allclose(pixel, by_the_book(camera, x, y), rtol=0, atol=1e-9)


@given(x=X, y=Y)
def test_undistortion_undoes_distortion_to_a_billionth_of_a_pixel(camera, x, y):
    found = undistort(by_the_book(camera, x, y), camera)

    np.testing.assert_allclose(found * 1781.0, np.array([x, y]) * 1781.0, rtol=0, atol=1e-9)


@given(x=X, y=Y)
def test_undistorted_pixels_are_those_of_the_camera_without_distortion(camera, x, y):
    found = undistorted_pixels(by_the_book(camera, x, y), camera)

    np.testing.assert_allclose(found, [1781.3 * x + 803.7, 1780.6 * y + 596.2], rtol=0, atol=1e-9)


@pytest.mark.parametrize("depth", [0.0, -1.0, np.nan])
def test_points_behind_the_camera_have_no_pixel(camera, depth):
    assert np.isnan(project(np.array([0.1, 0.1, depth]), camera)).all()


@pytest.mark.parametrize("shape", [(2,), (0, 2), (3, 2, 2)])
def test_rays_keep_the_shape_of_their_pixels(camera, shape):
    assert rays(np.full(shape, 600.0), camera).shape == (*shape[:-1], 3)


@pytest.mark.parametrize("shape", [(3,), (0, 3), (3, 2, 3)])
def test_pixels_keep_the_shape_of_their_points(camera, shape):
    assert project(np.ones(shape), camera).shape == (*shape[:-1], 2)


def test_a_point_not_seen_stays_not_seen_and_alone(camera):
    pixels = np.array([[np.nan, np.nan], [800.0, 600.0]])

    assert np.isnan(rays(pixels, camera)[:, 0]).tolist() == [True, False]


@given(x=X, y=Y, depth=st.floats(0.1, 3.0), tilt=st.floats(-0.9, 0.9))
def test_a_ray_meets_the_plane_through_its_point_there(x, y, depth, tilt):
    point = depth * np.array([x, y, 1.0])
    normal = cv2.Rodrigues(np.array([tilt, 0.2, 0.0]))[0][:, 2]

    found = intersect(np.array([[x, y, 1.0]]), normal[None], np.array([normal @ point]))

    np.testing.assert_allclose(found[0], point, rtol=1e-9)


@pytest.mark.parametrize("ray", [[1.0, 0.0, 1.0], [0.0, -1.0, 1.0]], ids=["along", "behind"])
def test_a_ray_along_the_plane_or_away_from_it_meets_nothing(ray):
    found = intersect(np.array([ray]), np.array([[0.0, 1.0, 0.0]]), np.array([0.5]))

    assert np.isnan(found).all()
