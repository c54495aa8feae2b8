"""Derivatives of the triangulated points against central differences of the triangulation."""

from dataclasses import replace

import numpy as np
import pytest
from ring_scenes import axes_across, make_scene, moved_rig

from ringpose.estimate.nuisance import point_covariance, point_jacobians, points_wrt_plane
from ringpose.pose.closed_form import triangulated
from ringpose.types.rig import CAMERA_PARAMETERS, PLANE_PARAMETERS

LASER = np.repeat([0, 1, 2], 2)
RATIONAL = np.array([-0.105, 0.118, 0.00055, -0.0004, 0.02, 0.01, -0.02, 0.005])
CAMERAS = pytest.mark.parametrize("distortion", [None, RATIONAL], ids=["plumb_bob", "rational_polynomial"])


@pytest.fixture
def scene(distortion):
    rig = make_scene("B").rig
    if distortion is None:
        return make_scene(rig)
    camera = replace(rig.camera, distortion_model="rational_polynomial", distortion_coefficients=distortion)
    return make_scene(replace(rig, camera=camera))


def points_of(scene, rig=None, offset_px=0.0):
    break_points = replace(scene.break_points(), position_px=scene.position_px + offset_px)
    return triangulated(break_points, scene.rig if rig is None else rig).position_m.reshape(-1, 3)


@CAMERAS
@pytest.mark.parametrize("axis", [0, 1])
def test_points_move_with_their_pixels(scene, axis):
    step_px = 1e-3 * np.eye(2)[axis]
    jacobians = point_jacobians(points_of(scene), scene.rig.lasers.normal[LASER], scene.rig.camera)

    numeric = (points_of(scene, offset_px=step_px) - points_of(scene, offset_px=-step_px)) / 2e-3

    np.testing.assert_allclose(jacobians.wrt_pixel[:, :, axis], numeric, rtol=1e-5, atol=1e-10)


@pytest.mark.parametrize(
    ("distortion", "name"),
    [(None, name) for name in CAMERA_PARAMETERS[:9]] + [(RATIONAL, name) for name in CAMERA_PARAMETERS],
)
def test_points_move_with_the_camera(scene, name):
    step = 1e-3 if name in ("fx", "fy", "cx", "cy") else 1e-6
    jacobians = point_jacobians(points_of(scene), scene.rig.lasers.normal[LASER], scene.rig.camera)

    there, back = (points_of(scene, moved_rig(scene.rig, (name,), (sign * step,))) for sign in (1, -1))

    analytic = jacobians.wrt_camera[:, :, CAMERA_PARAMETERS.index(name)]
    np.testing.assert_allclose(analytic, (there - back) / (2 * step), rtol=1e-4, atol=1e-8)


@CAMERAS
@pytest.mark.parametrize("parameter", PLANE_PARAMETERS)
def test_points_move_with_their_light_plane(scene, parameter):
    step, normal = 1e-6, scene.rig.lasers.normal[0]

    moved = [points_of(scene, moved_rig(scene.rig, (f"left.{parameter}",), (sign * step,)))[:2] for sign in (1, -1)]

    found = points_wrt_plane(points_of(scene)[:2], np.stack([normal] * 2), np.stack([axes_across(normal)] * 2))
    analytic = found[:, :, PLANE_PARAMETERS.index(parameter)]
    np.testing.assert_allclose(analytic, (moved[0] - moved[1]) / (2 * step), rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("distortion", [None])
def test_break_points_alone_leave_the_points_independent(scene):
    covariance_px2 = np.broadcast_to(0.09 * np.eye(2), (6, 2, 2))

    joint = point_covariance(points_of(scene), covariance_px2, LASER, scene.rig).reshape(6, 3, 6, 3)

    assert not joint[0, :, 1:].any()


@pytest.mark.parametrize("distortion", [None])
def test_a_point_is_as_uncertain_in_its_light_plane_as_in_the_image_and_not_across(scene):
    covariance_px2 = np.broadcast_to(0.09 * np.eye(2), (6, 2, 2))

    joint = point_covariance(points_of(scene), covariance_px2, LASER, scene.rig).reshape(6, 3, 6, 3)

    across = [scene.rig.lasers.normal[laser] @ joint[k, :, k] for k, laser in enumerate(LASER)]
    np.testing.assert_allclose(across, 0.0, atol=1e-18)
