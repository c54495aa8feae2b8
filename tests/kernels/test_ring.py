"""The kernel that fits arcs to the ends of stripes equals its twin."""

import math

import numpy as np
import pytest
from drawn_scene import DrawnScene, drawn_rig, true_break_points

from ringpose.detect.tracks import lens
from ringpose.kernels import _ring, reference_ring
from ringpose.kernels.ring import arc_fit


def seen_ring(rng, tilt):
    """Noisy ends on a ring to the right, their covariances, the light planes, and the lens."""
    rig = drawn_rig()
    scene = DrawnScene(normal=(tilt, -0.08, -math.sqrt(1 - tilt**2 - 0.08**2)))
    pixels = true_break_points(scene, rig) + rng.normal(0, 0.2, (3, 2, 2))
    planes = np.column_stack([rig.lasers.normal, rig.lasers.distance_m])
    return pixels, rng.uniform(0.05, 0.3, (3, 2, 1, 1)) ** 2 * np.eye(2), planes, lens(rig.camera)


@pytest.mark.parametrize("hidden", [[], [(1, 0)], [(0, 1), (2, 0)]], ids=["all", "one hidden", "two hidden"])
@pytest.mark.parametrize("tilt", [-0.3, 0.0, 0.2])
@pytest.mark.parametrize("seed", range(8))
def test_arc_fits_equal_the_twin(seed, tilt, hidden):
    position, *others = seen_ring(np.random.default_rng(seed), tilt)
    for each in hidden:
        position[each] = np.nan

    found, expected = arc_fit(position, *others, 0.5, 4), reference_ring.arc_fit(position, *others, 0.5, 4)

    assert found.seen == expected.seen
    np.testing.assert_allclose(found.cost_without, expected.cost_without, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(found[1:2] + found[3:], expected[1:2] + expected[3:], rtol=1e-4, atol=1e-9)


def test_a_ring_whose_centre_lies_to_the_right_bends_to_the_right(rng):
    found = arc_fit(*seen_ring(rng, 0.1), 0.5, 4)

    assert found.curvature == pytest.approx(1 / 0.582, abs=4 * found.curvature_sigma)
    assert found.curvature_sigma < 1.0


def test_arcs_through_four_ends_err_by_the_circles_too(rng):
    position, *others = seen_ring(rng, 0.1)
    position[1] = np.nan

    alone, with_circles = (arc_fit(position, *others, 0.5, exact).curvature_sigma for exact in (3, 4))

    assert with_circles > 1.5 * alone


@pytest.mark.parametrize("changed", range(4))
def test_arcs_of_arrays_that_do_not_fit_together_are_a_value_error(changed, rng):
    arrays = [*seen_ring(rng, 0.1)]
    arrays[changed] = arrays[changed][:-1]

    with pytest.raises(ValueError, match=r"arcs|lens"):
        _ring.arcs(*arrays, 0.5, 4)


def test_ends_whose_rays_miss_their_planes_give_no_cost_that_compares(rng):
    position, covariance, planes, optics = seen_ring(rng, 0.1)

    found = arc_fit(position, covariance, planes * [1, 1, 1, -1], optics, 0.5, 4)

    assert np.isnan(found.cost)


def test_no_ends_give_no_curvature(rng):
    position, *others = seen_ring(rng, 0.1)

    found = arc_fit(np.full_like(position, np.nan), *others, 0.5, 4)

    assert found.seen == (0, 0)
    assert np.isnan(found.curvature)
