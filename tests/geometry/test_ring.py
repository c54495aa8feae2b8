"""The ring model: on the circles that it describes, with derivatives that are central differences."""

import cv2
import numpy as np
import pytest
from ring_scenes import make_scene, turn_between

from ringpose.geometry.ring import (
    STEP,
    RingArcs,
    edge_distances,
    edge_points,
    normal_and_center,
    plane_and_center,
    predicted_break_points,
    predicted_stripes,
    public_wrt_rates,
    public_wrt_step,
    ring_arcs,
    rotation_by,
)
from ringpose.geometry.rotations import tilt_basis

EDGE_SIGN = np.where(np.arange(12) % 2, 1.0, -1.0)
ALONG_M = np.linspace(-0.3, 0.3, 12)
DIFFERENCE = 1e-6
CURVATURES = pytest.mark.parametrize("curvature", [1.7, 0.0, -0.8])
EACH_STEP = pytest.mark.parametrize("number", range(7), ids=STEP)


def some_arcs(curvature=1.7):
    normal = np.array([0.2, -0.1, -0.97])
    normal /= np.linalg.norm(normal)
    inward = np.cross([0.0, 1.0, 0.0], normal)
    inward /= np.linalg.norm(inward)
    return RingArcs(
        origin=np.array([0.05, 0.02, 0.5]),
        axes=np.stack([inward, np.cross(normal, inward), normal]),
        curvature=curvature,
        half_band_m=0.015,
    )


def some_rays(arcs, rng):
    """Rays (x, y, 1) near the edges."""
    points = edge_points(arcs, ALONG_M, EDGE_SIGN)[0] + 0.002 * rng.normal(size=(12, 3))
    return points / points[:, 2:]


def some_light_planes(rng):
    """Twelve planes roughly along the rows of the image."""
    normal = np.array([0.0, 1.0, 0.0]) + 0.2 * rng.normal(size=(12, 3))
    return normal / np.linalg.norm(normal, axis=1, keepdims=True), rng.uniform(-0.1, -0.05, 12)


def moved(arcs, number, size):
    return arcs.retract(size * np.eye(7)[number])


def difference(function):
    """Central difference of a function of a small number."""
    return (function(DIFFERENCE) - function(-DIFFERENCE)) / (2.0 * DIFFERENCE)


# The arcs


@pytest.mark.parametrize("curvature", [1.7, -0.8])
def test_points_of_the_edges_lie_on_two_circles_about_the_center(curvature):
    arcs = some_arcs(curvature)

    points, outward = edge_points(arcs, ALONG_M, EDGE_SIGN)

    from_center = points - arcs.center
    radius = np.where(EDGE_SIGN < 0, *arcs.radius_m)
    np.testing.assert_allclose(np.linalg.norm(from_center, axis=-1), np.abs(radius), rtol=1e-12)
    np.testing.assert_allclose(outward, from_center / radius[:, None], atol=1e-12)
    np.testing.assert_allclose(from_center @ arcs.normal, 0.0, atol=1e-14)


def test_straight_arcs_are_two_parallel_lines():
    arcs = some_arcs(0.0)

    points, outward = edge_points(arcs, ALONG_M, EDGE_SIGN)

    expected = arcs.origin + ALONG_M[:, None] * arcs.axes[1] - 0.015 * EDGE_SIGN[:, None] * arcs.axes[0]
    np.testing.assert_allclose(points, expected, atol=1e-15)
    np.testing.assert_allclose(outward, np.tile(-arcs.axes[0], (12, 1)), atol=1e-15)


@pytest.mark.parametrize("near_m", [(0.1, 0.2, 0.6), (-2.0, 1.0, 3.0)])
def test_arcs_of_a_ring_have_its_center_normal_and_radii(near_m):
    arcs = some_arcs()

    again = ring_arcs(arcs.center, arcs.normal, arcs.radius_m, np.array(near_m))

    np.testing.assert_allclose(again.center, arcs.center, atol=1e-14)
    np.testing.assert_allclose(again.radius_m, arcs.radius_m, rtol=1e-14)
    np.testing.assert_allclose(again.axes @ again.axes.T, np.eye(3), atol=1e-14)
    # the origin is the point of the middle of the face that is nearest to the given one
    beside = np.cross(again.origin - again.center, np.array(near_m) - again.center) @ again.normal
    assert beside == pytest.approx(0.0, abs=1e-12)


def test_axes_stay_at_right_angles_after_large_steps():
    axes = some_arcs().retract(np.array([0.5, -0.4, 0.01, 0.02, 0.6, 0.1, 0.001])).axes

    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(axes) > 0


@CURVATURES
def test_a_center_on_the_other_side_describes_the_same_points_with_the_edges_exchanged(rng, curvature):
    arcs = some_arcs(curvature)
    opposite, rays = arcs.with_center_opposite(), some_rays(arcs, rng)

    points, outward = edge_points(arcs, ALONG_M, EDGE_SIGN)
    same, inward = edge_points(opposite, -ALONG_M, -EDGE_SIGN)

    np.testing.assert_allclose(same, points, atol=1e-15)
    np.testing.assert_allclose(inward, -outward, atol=1e-15)
    outside = edge_distances(arcs, rays, EDGE_SIGN).distance_m
    np.testing.assert_allclose(edge_distances(opposite, rays, -EDGE_SIGN).distance_m, -outside, atol=1e-15)


# Motion


def test_motion_keeps_distances_and_radii(rng):
    arcs = some_arcs()
    velocity_m_s, rate_rad_s = rng.normal(size=3), rng.normal(size=3)

    after = arcs.predict(0.3, velocity_m_s, rate_rad_s)

    before_m, after_m = (edge_points(each, ALONG_M, EDGE_SIGN)[0] for each in (arcs, after))
    turn = cv2.Rodrigues(0.3 * rate_rad_s)[0]
    np.testing.assert_allclose(after_m, after.center + (before_m - arcs.center) @ turn.T, atol=1e-14)
    np.testing.assert_allclose(after.center, arcs.center + 0.3 * velocity_m_s, atol=1e-14)
    np.testing.assert_allclose(after.radius_m, arcs.radius_m, rtol=1e-15)


def test_a_rotation_about_the_normal_changes_nothing(rng):
    arcs = some_arcs()
    rays = some_rays(arcs, rng)

    after = arcs.predict(0.3, np.zeros(3), 0.7 * arcs.normal)

    distances = [edge_distances(each, rays, EDGE_SIGN).distance_m for each in (arcs, after)]
    np.testing.assert_allclose(distances[1], distances[0], atol=1e-14)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 1e-3, 1.0, 3.1])
def test_rotations_are_those_of_opencv(rng, angle_rad):
    axis = rng.normal(size=3)
    vector = angle_rad * axis / np.linalg.norm(axis)

    np.testing.assert_allclose(rotation_by(vector), cv2.Rodrigues(vector)[0], atol=1e-14)


# Stripes and break points


@EACH_STEP
def test_stripes_have_the_derivatives_of_central_differences(rng, number):
    arcs, (light, distance_m) = some_arcs(), some_light_planes(rng)
    x = rng.uniform(-0.4, 0.4, 12)

    found = predicted_stripes(arcs, x, light, distance_m).y_wrt_step[:, number]

    expected = difference(lambda h: predicted_stripes(moved(arcs, number, h), x, light, distance_m).rays[:, 1])
    np.testing.assert_allclose(found, expected, atol=1e-8 * max(1.0, np.abs(expected).max()))


def test_stripes_have_the_derivatives_of_central_differences_in_x_and_light_planes(rng):
    arcs, (light, distance_m) = some_arcs(), some_light_planes(rng)
    x = rng.uniform(-0.4, 0.4, 12)

    found = predicted_stripes(arcs, x, light, distance_m)

    def ordinate(x, light, distance_m):
        return predicted_stripes(arcs, x, light, distance_m).rays[:, 1]

    wrt_x = difference(lambda h: ordinate(x + h, light, distance_m))
    wrt_distance = difference(lambda h: ordinate(x, light, distance_m + h))
    wrt_light = [difference(lambda h, axis=axis: ordinate(x, light + h * axis, distance_m)) for axis in np.eye(3)]
    np.testing.assert_allclose(found.slope, wrt_x, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(-found.y_wrt_cosine / found.depth, wrt_distance, rtol=1e-6, atol=1e-8)
    expected = np.stack(wrt_light, axis=-1)
    np.testing.assert_allclose(found.y_wrt_cosine[:, None] * found.rays, expected, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("rig", ["A", "B"])
@pytest.mark.parametrize("side", [-1, 1])
def test_break_points_are_those_of_the_quadratic_equation(rig, side):
    scene = make_scene(rig, distance_m=0.5, tilt_rad=(0.2, -0.15), turn_rad=0.2, side=side)
    ring, lasers = scene.ring, scene.rig.lasers
    arcs = ring_arcs(ring.center_m, ring.normal, ring.radius_m, scene.points_m[1].mean(axis=0))

    points = predicted_break_points(arcs, lasers.normal, lasers.distance_m)

    np.testing.assert_allclose(points, scene.points_m, atol=1e-12)


def test_break_points_lie_on_the_predicted_stripes_and_edges(rng):
    arcs, (light, distance_m) = some_arcs(), some_light_planes(rng)

    points = predicted_break_points(arcs, light, distance_m)

    rays = (points / points[..., 2:]).reshape(-1, 3)
    stripes = predicted_stripes(arcs, rays[:, 0], np.repeat(light, 2, axis=0), np.repeat(distance_m, 2))
    np.testing.assert_allclose(stripes.rays, rays, atol=1e-12)
    distances = edge_distances(arcs, rays, np.tile([-1.0, 1.0], 12)).distance_m
    np.testing.assert_allclose(distances, 0.0, atol=1e-12)


def test_a_light_plane_that_misses_the_ring_or_is_parallel_to_it_has_no_break_points():
    arcs = some_arcs()
    beyond_m = float(arcs.axes[1] @ arcs.center) + 2.0

    points = predicted_break_points(arcs, arcs.axes[[1, 2]], np.array([beyond_m, float(arcs.normal @ arcs.origin) + 1]))

    assert np.isnan(points).all()


# Edges


@pytest.mark.parametrize("curvature", [1.7, -0.8])
def test_distances_are_those_from_the_center_less_the_radius(rng, curvature):
    arcs = some_arcs(curvature)
    rays = 3.0 * some_rays(arcs, rng)  # of any length

    found = edge_distances(arcs, rays, EDGE_SIGN).distance_m

    points = rays * (arcs.normal @ arcs.origin / (rays @ arcs.normal))[:, None]
    from_center = np.sign(curvature) * np.linalg.norm(points - arcs.center, axis=-1)
    np.testing.assert_allclose(found, from_center - np.where(EDGE_SIGN < 0, *arcs.radius_m), atol=1e-12)


@CURVATURES
def test_distance_from_an_edge_is_the_step_made_outward(curvature):
    arcs = some_arcs(curvature)
    points, outward = edge_points(arcs, ALONG_M, EDGE_SIGN)
    step_m = np.linspace(-0.01, 0.02, 12)

    found = edge_distances(arcs, points + step_m[:, None] * outward, EDGE_SIGN).distance_m

    np.testing.assert_allclose(found, step_m, atol=1e-14)


@EACH_STEP
@CURVATURES
def test_distances_have_the_derivatives_of_central_differences(rng, number, curvature):
    arcs = some_arcs(curvature)
    rays = some_rays(arcs, rng)

    found = edge_distances(arcs, rays, EDGE_SIGN).wrt_step[:, number]

    expected = difference(lambda h: edge_distances(moved(arcs, number, h), rays, EDGE_SIGN).distance_m)
    np.testing.assert_allclose(found, expected, atol=1e-8)


@pytest.mark.parametrize("axis", [0, 1])
@CURVATURES
def test_distances_have_the_derivatives_of_central_differences_by_ray(rng, axis, curvature):
    arcs = some_arcs(curvature)
    rays = some_rays(arcs, rng)

    found = edge_distances(arcs, rays, EDGE_SIGN).wrt_ray[:, axis]

    expected = difference(lambda h: edge_distances(arcs, rays + h * np.eye(3)[axis], EDGE_SIGN).distance_m)
    np.testing.assert_allclose(found, expected, atol=1e-8)


def test_nothing_jumps_where_the_curvature_changes_its_sign(rng):
    straight, (light, distance_m) = some_arcs(0.0), some_light_planes(rng)
    rays = some_rays(straight, rng)

    def values(curvature):
        arcs = some_arcs(curvature)
        distances = edge_distances(arcs, rays, EDGE_SIGN)
        parts = [*edge_points(arcs, ALONG_M, EDGE_SIGN), *distances, predicted_break_points(arcs, light, distance_m)]
        return np.concatenate([part.ravel() for part in parts])

    found = values(0.0)

    assert np.isfinite(found).all()
    np.testing.assert_allclose(values(1e-9), found, atol=1e-8)
    np.testing.assert_allclose(values(-1e-9), found, atol=1e-8)


# Parameters of the records


def parameters_of(arcs, normal):
    """The seven parameters about a unit normal: its tilt basis turns with the ring's, the shortest way."""
    basis = tilt_basis(normal)
    tilt = basis @ arcs.normal / (arcs.normal @ normal)
    turn = turn_between(normal, arcs.normal)
    return np.concatenate([tilt, [arcs.normal @ arcs.center], basis @ turn.T @ arcs.center, arcs.radius_m])


@EACH_STEP
@pytest.mark.parametrize("curvature", [1.7, -0.8])
def test_parameters_have_the_derivatives_of_central_differences(number, curvature):
    arcs = some_arcs(curvature)

    found = public_wrt_step(arcs, tilt_basis(arcs.normal))[:, number]

    expected = difference(lambda h: parameters_of(moved(arcs, number, h), arcs.normal))
    np.testing.assert_allclose(found, expected, atol=1e-8)


@pytest.mark.parametrize("number", range(5), ids=["x", "y", "z", "rate 1", "rate 2"])
def test_parameters_change_with_time_as_the_motion_says(number):
    arcs = some_arcs()
    velocity_m_s = np.append(np.eye(3), np.zeros((2, 3)), axis=0)[number]
    rate_rad_s = np.append(np.zeros((3, 3)), tilt_basis(arcs.normal), axis=0)[number]

    found = public_wrt_rates(arcs.normal, arcs.center, tilt_basis(arcs.normal))[:, number]

    expected = difference(lambda time_s: parameters_of(arcs.predict(time_s, velocity_m_s, rate_rad_s), arcs.normal))
    np.testing.assert_allclose(found, expected, atol=1e-8)


def test_normal_and_center_follow_from_the_parameters_and_the_reverse():
    arcs = some_arcs()

    normal_wrt, center_wrt = normal_and_center(arcs.normal, arcs.center)

    again = plane_and_center(arcs.normal, arcs.center, normal_wrt, center_wrt, tilt_basis(arcs.normal))
    np.testing.assert_allclose(again, np.eye(5), atol=1e-15)
