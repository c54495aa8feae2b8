"""The kernels that look for the ring equal their twins."""

import math

import numpy as np
import pytest
from drawn_scene import DrawnScene, drawn_rig, true_break_points

from ringpose.detect.tracks import lens
from ringpose.geometry.rays import undistort
from ringpose.kernels import _ring, reference_ring
from ringpose.kernels.ring import RingRules, arc_fit, best_groups

RULES = RingRules(
    focal_x=1781.0,
    focal_y=1780.0,
    principal_y=596.0,
    image_height=1200.0,
    border_px=15.0,
    along_sigma_px=2.0,
    across_sigma_px=0.4,
    plane_limit=8.0,
    circle_limit=6.0,
    dropped_end_cost=6.0,
    unseen_cost=6.0,
    maximum_tilt_rad=1.3,
    minimum_radius_m=0.1,
    minimum_band_m=0.003,
)


def planes():
    lasers = drawn_rig().lasers
    return lasers.normal / lasers.distance_m[:, None]


def true_ends(rng, *, moved_px=0.0):
    """Normalised ends (laser, end, xy) of a true ring's stripes, moved by noise."""
    rig = drawn_rig()
    scene = DrawnScene(center_m=(0.58, rng.uniform(-0.05, 0.05), rng.uniform(0.3, 1.0)))
    position = true_break_points(scene, rig)[:, ::-1]
    return undistort(position + rng.normal(0, moved_px, position.shape), rig.camera)


def crowd(rng, count):
    """A true ring's stripes among random ones, as candidates sorted by laser."""
    ends = np.concatenate([true_ends(rng, moved_px=0.3), rng.uniform(-0.4, 0.4, (count, 2, 2))])
    ends[3:, 1] = ends[3:, 0] + [0.05, 0.0] + rng.normal(0, 0.002, (count, 2))
    track = np.arange(len(ends), dtype=np.int32)
    laser = np.repeat(np.arange(3, dtype=np.int32), len(ends))
    everywhere = np.tile(track, 3)
    return everywhere, laser, np.ascontiguousarray(ends[everywhere]), rng.uniform(5, 9, len(ends))[everywhere]


@pytest.mark.parametrize("seed", range(12))
def test_best_groups_equal_the_twin(seed):
    track, laser, ends, merit = crowd(np.random.default_rng(seed), 6)

    found = best_groups(track, laser, ends, merit, planes(), RULES)
    expected = reference_ring.best_groups(track, laser, ends, merit, planes(), RULES)

    assert [group.candidates for group in found] == [group.candidates for group in expected]
    np.testing.assert_allclose([group.score for group in found], [group.score for group in expected], rtol=1e-6)
    np.testing.assert_allclose([group.rival for group in found], [group.rival for group in expected], rtol=1e-6)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("left_x", "right_x"), [(-0.1, 0.1), (0.0, 0.3), (0.5, 0.6)])
def test_groups_with_ends_that_the_border_cuts_off_equal_the_twin(seed, left_x, right_x):
    track, laser, ends, merit = crowd(np.random.default_rng(seed), 6)
    rules = RULES._replace(left_x=left_x, right_x=right_x)

    found = best_groups(track, laser, ends, merit, planes(), rules)
    expected = reference_ring.best_groups(track, laser, ends, merit, planes(), rules)

    assert [group.candidates for group in found] == [group.candidates for group in expected]
    np.testing.assert_allclose([group.score for group in found], [group.score for group in expected], rtol=1e-6)


def test_an_end_beyond_the_border_may_lie_off_the_circles(rng):
    ends = true_ends(rng)
    number, zero = np.arange(3, dtype=np.int32), np.zeros(3)
    moved = ends.copy()
    moved[:, 0] += 0.03 * (ends[:, 1] - ends[:, 0]) * np.array([[1.0], [-1.0], [2.0]])
    cut = RULES._replace(left_x=float(moved[:, 0, 0].max()) + 1e-3)

    exact = best_groups(number, number, ends, zero, planes(), RULES)[2].score
    found = best_groups(number, number, moved, zero, planes(), cut)[2].score

    assert found == pytest.approx(exact, abs=0.01)


def test_the_true_ring_wins_under_its_true_labels(rng):
    track, laser, ends, merit = crowd(rng, 8)

    best = best_groups(track, laser, ends, merit, planes(), RULES)[2]

    assert [(int(laser[each]), int(track[each])) for each in best.candidates] == [(0, 0), (1, 1), (2, 2)]


def test_an_exact_ring_costs_nothing(rng):
    ends = true_ends(rng)
    zero = np.zeros(3)

    cost = reference_ring.group_cost(np.arange(3, dtype=np.int32), ends, planes(), RULES)
    best = best_groups(np.arange(3, dtype=np.int32), np.arange(3, dtype=np.int32), ends, zero, planes(), RULES)[2]

    tilt = np.arctan2(np.hypot(0.05, 0.08), 0.9955)
    assert cost == pytest.approx(0.5 * (tilt / 0.5) ** 2, abs=1e-6)
    assert best.score == pytest.approx(-cost, abs=1e-6)


def test_nothing_gives_no_group():
    nothing = np.zeros(0, dtype=np.int32)

    best = best_groups(nothing, nothing, np.zeros((0, 2, 2)), np.zeros(0), planes(), RULES)

    assert [group.score for group in best] == [-np.inf] * 3


def test_a_laser_beyond_the_rig_is_refused():
    one = np.zeros(1, dtype=np.int32)

    with pytest.raises(ValueError, match="laser"):
        best_groups(one, one + 3, np.zeros((1, 2, 2)), np.zeros(1), planes(), RULES)


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, 1e300])
def test_wild_ends_give_no_crash(rng, value):
    track, laser, ends, merit = crowd(rng, 4)
    ends[::2, 1, 0] = value

    best = best_groups(track, laser, ends, merit, planes(), RULES)

    assert len(best) == 3


def seen_ring(rng, tilt):
    """Noisy ends on a ring to the right, arcs, sigmas along the stripes, the ends' light planes, and the lens."""
    rig = drawn_rig()
    scene = DrawnScene(normal=(tilt, -0.08, -math.sqrt(1 - tilt**2 - 0.08**2)))
    pixels = true_break_points(scene, rig).reshape(6, 2) + rng.normal(0, 0.2, (6, 2))
    planes = np.column_stack([rig.lasers.normal, rig.lasers.distance_m])
    arc = np.tile(np.array([0, 1], np.int32), 3)
    return pixels, arc, rng.uniform(0.05, 0.3, 6), np.repeat(planes, 2, axis=0), lens(rig.camera)


@pytest.mark.parametrize("tilt", [-0.3, 0.0, 0.2])
@pytest.mark.parametrize("seed", range(8))
def test_arc_fits_equal_the_twin(seed, tilt):
    ends = seen_ring(np.random.default_rng(seed), tilt)

    found, expected = arc_fit(*ends, 0.5), reference_ring.arc_fit(*ends, 0.5)

    np.testing.assert_allclose(found.cost_without, expected.cost_without, rtol=1e-4)
    np.testing.assert_allclose(found[0:1] + found[2:], expected[0:1] + expected[2:], rtol=1e-4)


def test_a_ring_whose_centre_lies_to_the_right_bends_to_the_right(rng):
    found = arc_fit(*seen_ring(rng, 0.1), 0.5)

    assert found.curvature == pytest.approx(1 / 0.582, abs=4 * found.curvature_sigma)
    assert found.curvature_sigma < 1.0


@pytest.mark.parametrize("changed", range(5))
def test_arcs_of_arrays_that_do_not_fit_together_are_a_value_error(changed, rng):
    position, arc, along, planes, _ = seen_ring(rng, 0.1)
    arrays = [position, arc, along, planes, np.zeros(12)]
    arrays[changed] = arrays[changed][:-1].copy()

    with pytest.raises(ValueError, match="arcs"):
        _ring.arcs(*arrays, 0.5)


def test_ends_whose_rays_miss_their_planes_give_no_cost_that_compares(rng):
    position, arc, along, planes, optics = seen_ring(rng, 0.1)

    found = arc_fit(position, arc, along, planes * [1, 1, 1, -1], optics, 0.5)

    assert np.isnan(found.cost)
