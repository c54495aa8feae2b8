"""A camera that is turned about its axis sees turned points at turned pixels."""

from dataclasses import replace

import numpy as np
import pytest
from ring_scenes import make_scene

from ringpose.geometry.quarter_turn import to_columns, to_rows
from ringpose.geometry.rays import project
from ringpose.types.rig import ParameterCovariance, camera_parameters


def camera_with(coefficients):
    camera = make_scene("B").rig.camera
    return replace(camera, distortion_coefficients=np.array(coefficients))


def clockwise(camera):
    return to_columns(replace(camera, image_width=camera.image_height, image_height=camera.image_width))


@pytest.mark.parametrize(
    "coefficients", [[-0.1, 0.1, 0.004, -0.002, 0.01], [0.1, 0.02, -0.003, 0.005, 0.01, 0.2, 0.03, 0.01]]
)
@pytest.mark.parametrize("turn_of", [to_rows, clockwise])
def test_turned_points_are_at_turned_pixels(rng, coefficients, turn_of):
    camera = camera_with(coefficients)
    points = np.column_stack([rng.uniform(-0.3, 0.3, (50, 2)), np.ones(50)])
    turn = turn_of(camera)

    pixels = project(turn.vectors(points), turn.camera(camera))

    np.testing.assert_allclose(pixels, turn.points(project(points, camera)), atol=1e-9)


def test_pixels_of_a_turned_image_have_the_values_of_the_given_one(rng):
    camera = replace(camera_with([0.0] * 5), image_width=7, image_height=5)
    image = rng.integers(0, 255, (5, 7), dtype=np.uint8)
    y, x = np.mgrid[:5, :7]

    turned_x, turned_y = to_rows(camera).points(np.stack([x, y], axis=-1).astype(float)).astype(int).transpose(2, 0, 1)

    np.testing.assert_array_equal(to_rows(camera).image(image)[turned_y, turned_x], image)


def test_turning_back_restores_a_rig(rng):
    rig = make_scene("B").rig
    names = camera_parameters(5)
    root = rng.normal(size=(len(names), len(names)))
    rig = replace(rig, covariance=ParameterCovariance(parameters=names, data=root @ root.T))

    again = to_columns(rig.camera).rig(to_rows(rig.camera).rig(rig))

    np.testing.assert_allclose(again.camera.camera_matrix, rig.camera.camera_matrix)
    np.testing.assert_allclose(again.camera.distortion_coefficients, rig.camera.distortion_coefficients)
    np.testing.assert_allclose(again.lasers.normal, rig.lasers.normal)
    np.testing.assert_allclose(again.covariance.of(names), rig.covariance.data)


def test_the_covariance_of_a_turned_camera_gives_the_turned_errors_of_pixels(rng):
    """By differences: what an error of the camera moves, the same error of the turned camera moves, turned."""
    camera, point = camera_with([-0.1, 0.1, 0.004, -0.002, 0.01]), np.array([0.2, -0.1, 1.0])
    names, turn, step = camera_parameters(5), to_rows(camera), 1e-4

    def moved(one, index):
        matrix, coefficients = one.camera_matrix.copy(), one.distortion_coefficients.copy()
        if index < 4:
            matrix[[0, 1, 0, 1][index], [0, 1, 2, 2][index]] += step
        else:
            coefficients[index - 4] += step
        return replace(one, camera_matrix=matrix, distortion_coefficients=coefficients)

    def jacobian(one, at):
        return np.stack([(project(at, moved(one, i)) - project(at, one)) / step for i in range(9)], axis=-1)

    root = rng.normal(size=(9, 9))
    given = replace(camera, covariance=ParameterCovariance(parameters=names, data=root @ root.T))
    turned = turn.camera(given)
    of_pixel = jacobian(camera, point) @ given.covariance.data @ jacobian(camera, point).T
    of_turned = jacobian(turned, turn.vectors(point))

    found = of_turned @ turned.covariance.of(names) @ of_turned.T

    np.testing.assert_allclose(found, turn.matrix @ of_pixel @ turn.matrix.T, rtol=1e-6)
