import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ringpose.geometry.rays import nearest_plane, towards_camera
from ringpose.geometry.rotations import angle_between

TILTS = st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))


@given(tilt=TILTS, distance=st.floats(-2.0, 2.0))
def test_points_of_a_plane_give_the_plane(tilt, distance):
    axes = cv2.Rodrigues(np.array(tilt))[0]
    in_plane = np.array([[0.0, 0.0], [0.3, 0.1], [-0.2, 0.4], [0.1, -0.5], [0.6, 0.2]])
    points = in_plane @ axes[:, :2].T + distance * axes[:, 2]

    normal, found, singular = nearest_plane(points)

    sign = np.sign(normal @ axes[:, 2])
    np.testing.assert_allclose([*(sign * normal), sign * found], [*axes[:, 2], distance], atol=1e-12)
    assert singular[2] < 1e-12


def test_the_nearest_plane_leaves_the_least_squares():
    rng = np.random.default_rng(3)
    points = rng.normal(size=(20, 3)) * [1.0, 1.0, 0.1]
    normal, distance, singular = nearest_plane(points)

    left = np.sum((points @ normal - distance) ** 2)

    assert left == pytest.approx(singular[2] ** 2)
    others = rng.normal(size=(1000, 3))
    others /= np.linalg.norm(others, axis=-1, keepdims=True)
    centred = points - points.mean(axis=0)
    assert left <= np.min(np.sum((centred @ others.T) ** 2, axis=0))


def test_a_point_of_no_weight_does_not_count():
    points = np.array([[0.0, 0, 1], [1.0, 0, 1], [0.0, 1, 1], [5.0, 5, 9]])

    normal, distance, _ = nearest_plane(points, np.array([1.0, 1.0, 1.0, 0.0]))

    np.testing.assert_allclose(np.abs([*normal, distance]), [0, 0, 1, 1], atol=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_normal_towards_the_camera_points_against_the_view(sign):
    normal = towards_camera(sign * np.array([0.6, 0.0, 0.8]), np.array([0.0, 0.1, 1.0]))

    assert normal.tolist() == [-0.6, 0.0, -0.8]


@given(angle=st.floats(0.0, 3.14), about=TILTS)
def test_the_angle_between_a_vector_and_its_turn_is_the_turn(angle, about):
    axes = cv2.Rodrigues(np.array(about))[0]
    turned = cv2.Rodrigues(angle * axes[:, 2])[0] @ axes[:, 0]

    assert angle_between(axes[:, 0], turned) == pytest.approx(angle, abs=1e-12)
