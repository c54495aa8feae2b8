"""The kernel that fits arcs to the ends of stripes, against NumPy's least squares and true rings."""

import math

import numpy as np
import pytest
from drawn_scene import DrawnScene, drawn_rig, true_break_points

from ringpose.detect.stripes import lens
from ringpose.geometry.rays import intersect, rays
from ringpose.kernels.lines import arc_fit


def seen_ring(rng, tilt):
    """Noisy ends on a ring to the right, their covariances, the light planes, and the lens."""
    rig = drawn_rig()
    scene = DrawnScene(normal=(tilt, -0.08, -math.sqrt(1 - tilt**2 - 0.08**2)))
    pixels = true_break_points(scene, rig) + rng.normal(0, 0.2, (3, 2, 2))
    planes = np.column_stack([rig.lasers.normal, rig.lasers.distance_m])
    return pixels, rng.uniform(0.05, 0.3, (3, 2, 1, 1)) ** 2 * np.eye(2), planes, lens(rig.camera)


def flat_ends(position_px, planes):
    """Ends in the plane nearest to them, in metres, with x along the image's rows; which arc; metres a pixel."""
    laser, arc = np.nonzero(~np.isnan(position_px[..., 0]))
    camera = drawn_rig().camera
    points = intersect(rays(position_px[laser, arc], camera), planes[laser, :3], planes[laser, 3])
    normal = np.linalg.svd(points - points.mean(axis=0))[2][2]
    along = np.cross([0.0, 1.0, 0.0], normal)
    along *= np.sign(along[0]) / np.linalg.norm(along)
    axes = np.stack([along, np.cross(normal, along)], axis=-1)
    return (points - points.mean(axis=0)) @ axes, arc, points[:, 2] / camera.camera_matrix[0, 0]


def least_squares_arcs(flat, arc):
    """Distances off the arcs a (x^2 + y^2) + x + b y + c_arc = 0 of least squares along x, and one over the radius."""
    x, y = flat.T
    rows = np.column_stack([x**2 + y**2, y, arc == 0, arc == 1])
    a, b, *c = np.linalg.lstsq(rows, -x)[0]
    gradient = np.hypot(2 * a * x + 1, 2 * a * y + b)
    return (rows @ [a, b, *c] + x) / gradient, -2 * a / np.sqrt(1 + b**2 - 2 * a * sum(c))


@pytest.mark.parametrize("hidden", [[], [(1, 0)]], ids=["all", "one hidden"])
@pytest.mark.parametrize("tilt", [-0.3, 0.0, 0.2])
def test_cost_and_curvature_are_those_of_least_squares(rng, tilt, hidden):
    position, covariance, planes, optics = seen_ring(rng, tilt)
    for each in hidden:
        position[each] = np.nan

    found = arc_fit(position, covariance, planes, optics, 0.5, 4)

    flat, arc, metres = flat_ends(position, planes)
    off, curvature = least_squares_arcs(flat, arc)
    sigma = metres * np.hypot(np.sqrt(covariance[..., 0, 0][~np.isnan(position[..., 0])]), 0.5)
    assert found.seen == (int(np.sum(arc == 0)), int(np.sum(arc == 1)))
    assert found.curvature == pytest.approx(curvature, rel=1e-4)
    assert found.cost == pytest.approx(0.5 * np.sum((off / sigma) ** 2), rel=1e-4)


def test_an_exact_ring_costs_nothing_until_an_end_is_moved(rng):
    rig = drawn_rig()
    position = true_break_points(DrawnScene(), rig)
    covariance, planes = (
        np.tile(0.01 * np.eye(2), (3, 2, 1, 1)),
        np.column_stack([rig.lasers.normal, rig.lasers.distance_m]),
    )
    moved = position.copy()
    moved[1, 0, 0] += 8.0

    exact, wrong = (arc_fit(each, covariance, planes, lens(rig.camera), 0.5, 4) for each in (position, moved))

    assert exact.cost < 1e-3
    assert wrong.cost > 20
    assert np.argmin(wrong.cost_without) == 2
    assert wrong.cost_without[2] < 1e-3


def test_curvatures_scatter_as_their_sigma_says(rng):
    rig = drawn_rig()
    position = true_break_points(DrawnScene(), rig)
    others = (np.tile(0.04 * np.eye(2), (3, 2, 1, 1)), np.column_stack([rig.lasers.normal, rig.lasers.distance_m]))
    others = (*others, lens(rig.camera), 0.5, 4)

    noise = np.zeros((200, *position.shape))
    noise[..., 0] = rng.normal(0, 0.2, noise.shape[:-1])
    found = [arc_fit(position + each, *others) for each in noise]

    scatter = np.std([each.curvature for each in found])
    assert scatter == pytest.approx(np.mean([each.curvature_sigma for each in found]), rel=0.15)


def test_a_ring_whose_centre_lies_to_the_right_bends_to_the_right(rng):
    found = arc_fit(*seen_ring(rng, 0.1), 0.5, 4)

    assert found.curvature == pytest.approx(1 / 0.582, abs=4 * found.curvature_sigma)
    assert found.curvature_sigma < 1.0


def test_arcs_through_four_ends_err_by_the_circles_too(rng):
    position, *others = seen_ring(rng, 0.1)
    position[1] = np.nan

    alone, with_circles = (arc_fit(position, *others, 0.5, exact).curvature_sigma for exact in (3, 4))

    assert with_circles > 1.5 * alone


def test_ends_whose_rays_miss_their_planes_give_no_cost_that_compares(rng):
    position, covariance, planes, optics = seen_ring(rng, 0.1)

    found = arc_fit(position, covariance, planes * [1, 1, 1, -1], optics, 0.5, 4)

    assert np.isnan(found.cost)


def test_no_ends_give_no_curvature(rng):
    position, *others = seen_ring(rng, 0.1)

    found = arc_fit(np.full_like(position, np.nan), *others, 0.5, 4)

    assert found.seen == (0, 0)
    assert np.isnan(found.curvature)
