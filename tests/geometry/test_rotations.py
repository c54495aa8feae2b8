import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ringpose.geometry.rotations import rotation_vector, rotation_vectors, tilt_basis, tilted

TURNS = st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0))


def turned_axis(turn):
    return cv2.Rodrigues(np.array([*turn, 0.0]))[0][:, 2]


@given(turn=TURNS)
def test_normal_and_tilt_basis_are_a_right_handed_frame(turn):
    normal = turned_axis(turn)

    frame = np.vstack([tilt_basis(normal), normal])

    np.testing.assert_allclose([*(frame @ frame.T).ravel(), np.linalg.det(frame)], [*np.eye(3).ravel(), 1], atol=1e-9)


@given(turn=TURNS)
def test_the_first_tilt_axis_is_level(turn):
    assert tilt_basis(turned_axis(turn))[0, 2] == 0.0


@pytest.mark.parametrize("z", [1.0, -1.0])
def test_a_normal_along_z_tilts_first_along_x(z):
    assert tilt_basis(np.array([0.0, 0.0, z]))[0].tolist() == [1.0, 0.0, 0.0]


@given(turn=TURNS, tilt=st.floats(-1.0, 1.0))
def test_a_tilt_is_the_tangent_of_the_angle_that_the_normal_turns(turn, tilt):
    normal = turned_axis(turn)

    moved = tilted(normal, np.array([0.6 * tilt, 0.8 * tilt]))

    assert np.linalg.norm(np.cross(normal, moved)) / (normal @ moved) == pytest.approx(abs(tilt), abs=1e-9)


@pytest.mark.parametrize("angle_rad", [1e-9, 3e-6, 9e-5, 1.1e-4, 0.3, 3.0, 3.1415])
def test_a_rotation_vector_is_exact_at_small_angles_too(angle_rad):
    axis = np.array([0.6, -0.64, 0.48])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])

    turn = np.eye(3) + np.sin(angle_rad) * cross + 2 * np.sin(angle_rad / 2) ** 2 * cross @ cross

    assert rotation_vector(turn) == pytest.approx(angle_rad * axis, rel=1e-8)
    assert rotation_vectors(np.array([[turn, turn.T]]))[0] == pytest.approx(
        np.outer([1, -1], angle_rad * axis), rel=1e-8
    )
