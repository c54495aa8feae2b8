"""Displacement between the projections of two cameras, against formulas for simple changes."""

from dataclasses import replace

import numpy as np
import pytest
from known_views import TRUE_CAMERA

from ringpose.calibrate.camera.validation import displacement_px, map_points_px


def test_a_rotation_of_the_camera_frame_displaces_nothing():
    moved = TRUE_CAMERA.camera_matrix.copy()
    moved[0, 2] += 0.5  # at 1781 px, a turn by a sixth of a minute of arc, but for its second order
    other = replace(TRUE_CAMERA, camera_matrix=moved, distortion_coefficients=np.zeros(5))
    one = replace(TRUE_CAMERA, distortion_coefficients=np.zeros(5))

    assert np.median(displacement_px(one, other)) < 0.05


def test_a_longer_focal_length_displaces_pixels_by_their_distance_from_the_middle():
    one = replace(TRUE_CAMERA, distortion_coefficients=np.zeros(5))
    other = replace(one, camera_matrix=one.camera_matrix @ np.diag([1.001, 1.001, 1.0]))
    where = map_points_px(one)

    expected = 0.001 * np.linalg.norm(where - one.camera_matrix[:2, 2], axis=-1)
    assert displacement_px(one, other) == pytest.approx(expected, abs=0.01)
