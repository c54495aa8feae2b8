"""Identification of a ring by a catalogue."""

from dataclasses import replace

import numpy as np
import pytest
from ring_scenes import face_points_of, make_scene

from ringpose.files.rings import read_rings
from ringpose.measure.stream import estimate_pose
from ringpose.pose.catalogue import LIKELY_ENOUGH, NONE_OF_THESE, likely_ring, ring_posterior
from ringpose.types.plausible import FACE_WIDTH_M, RING_RADIUS_M
from ringpose.types.pose import Ring

SIZES = {"R468": (0.4285, 0.4685), "R597": (0.567, 0.597), "R833": (0.798, 0.833), "R1312": (1.272, 1.312)}
RINGS = [
    Ring(
        name=name,
        radius_inner_m=(inner - 0.002, inner + 0.002),
        radius_outer_m=(outer - 0.002, outer + 0.002),
    )
    for name, (inner, outer) in SIZES.items()
]


def test_the_ring_that_was_seen_is_found(rng):
    scene = make_scene("B", distance_m=0.5)

    pose = estimate_pose(face_points_of(scene, 0.3, 0.01, rng), scene.rig, known=RINGS)

    assert pose.ring_posterior["R597"] > 0.99


def test_the_radii_of_the_ring_that_was_found_make_the_center_better(rng):
    scene = make_scene("B", distance_m=0.5)
    points = face_points_of(scene, 0.3, 0.01, rng)

    poses = [estimate_pose(points, scene.rig, known=known) for known in (None, RINGS)]

    spread = [np.sqrt(np.trace(pose.covariance_center_m2)) for pose in poses]
    assert spread[0] > 3 * spread[1]


def test_a_ring_of_another_size_is_none_of_these(rng):
    scene = make_scene("B", distance_m=0.5, size="R1194")

    pose = estimate_pose(face_points_of(scene, 0.1, 0.01, rng), scene.rig, known=RINGS)

    assert pose.ring_posterior[NONE_OF_THESE] > 0.95


def test_where_the_curvature_is_hardly_seen_no_ring_is_forced(rng):
    scene = make_scene("A", distance_m=0.25)

    pose = estimate_pose(face_points_of(scene, 0.3, 0.03, rng), scene.rig, known=RINGS)

    assert max(pose.ring_posterior.values()) < 0.95


@pytest.mark.parametrize("curvature_sd", [1e-3, 0.1, 3.0])
def test_probabilities_sum_to_one(curvature_sd):
    posterior = ring_posterior(1.7, 0.03, np.diag([curvature_sd**2, 1e-8]), RINGS)

    assert sum(posterior.values()) == pytest.approx(1.0)


def test_a_wider_interval_promises_less():
    wide = replace(RINGS[1], name="wide", radius_inner_m=(0.517, 0.59), radius_outer_m=(0.592, 0.602))

    posterior = ring_posterior(2 / 1.164, 0.03, np.diag([1e-4, 1e-8]), [RINGS[1], wide])

    assert posterior["R597"] > 2 * posterior["wide"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rig", "distance_m"),
    [("B", 0.5), *(pytest.param(*case, marks=pytest.mark.slow) for case in (("A", 0.5), ("B", 0.25)))],
)
def test_rings_drawn_from_a_catalogue_and_from_elsewhere_are_as_likely_as_told(rng, rig, distance_m):
    named, told, right = 0, 0.0, 0
    for _ in range(60):
        which = len(RINGS) if rng.random() < 0.5 else rng.integers(len(RINGS))
        if which < len(RINGS):
            radii = rng.uniform(*RINGS[which].radius_inner_m), rng.uniform(*RINGS[which].radius_outer_m)
        else:
            middle, band = np.exp(rng.uniform(np.log([0.25, 0.01]), np.log([2.0, 0.1]))).tolist()
            radii = middle - 0.5 * band, middle + 0.5 * band
        scene = make_scene(rig, distance_m=distance_m, size=radii)
        pose = estimate_pose(face_points_of(scene, 0.3, 0.02, rng), scene.rig, known=RINGS)
        name, share = max(pose.ring_posterior.items(), key=lambda each: each[1])
        if share > LIKELY_ENOUGH:
            named, told = named + 1, told + share
            right += name == ([*SIZES, NONE_OF_THESE][which])

    # so many wrong names are to be expected, and at most three standard deviations more
    wrong, expected = named - right, named - told
    assert wrong <= expected + 3.0 * np.sqrt(expected + 0.1)


def test_a_band_as_wide_as_none_is_a_little_less_likely_at_the_limit_than_inside():
    shares = [ring_posterior(2 / 1.164, band, np.diag([1e-4, 1e-6]), RINGS)[NONE_OF_THESE] for band in (0.1999, 0.2001)]

    assert shares[0] == pytest.approx(shares[1], rel=0.01)


@pytest.mark.slow
def test_a_catalogue_of_many_flanges_is_as_often_right_as_it_promises(rng):
    """Half of the rings are of the catalogue, the others of any size; exact and poor measurements."""
    rings = read_rings()
    names = [*(ring.name for ring in rings), NONE_OF_THESE]
    promised, happened = [], []
    for _ in range(1500):
        which = len(rings) if rng.random() < 0.5 else rng.integers(len(rings))
        if which < len(rings):
            inner_m, outer_m = rng.uniform(*rings[which].radius_inner_m), rng.uniform(*rings[which].radius_outer_m)
        else:
            middle_m = np.exp(rng.uniform(*np.log([RING_RADIUS_M.lowest, RING_RADIUS_M.highest])))
            band_m = np.exp(rng.uniform(*np.log([FACE_WIDTH_M.lowest, FACE_WIDTH_M.highest])))
            inner_m, outer_m = middle_m - 0.5 * band_m, middle_m + 0.5 * band_m
        curvature, band_m = 2.0 / (inner_m + outer_m), outer_m - inner_m
        sd = np.array(
            [curvature * np.exp(rng.uniform(*np.log([1e-4, 0.1]))), np.exp(rng.uniform(*np.log([2e-5, 2e-3])))]
        )
        posterior = ring_posterior(*rng.normal([curvature, band_m], sd), np.diag(sd**2), rings)
        promised.append([posterior[name] for name in names])
        happened.append(np.arange(len(names)) == which)
    promised, happened = np.array(promised), np.array(happened)

    sure = promised > LIKELY_ENOUGH
    expected_wrong = (1.0 - promised[sure]).sum()
    assert sure.sum() > 700
    assert (sure & ~happened).sum() <= expected_wrong + 3.0 * np.sqrt(expected_wrong)
    for start, end in ((0.02, 0.2), (0.2, 0.5), (0.5, 0.95)):
        likely = (promised > start) & (promised < end)
        assert abs((promised - happened)[likely].sum()) < 3.5 * np.sqrt((promised * (1.0 - promised))[likely].sum())


def test_rings_of_nearly_equal_size_are_not_told_apart_and_give_one_radius():
    """Facings of 535, 533.4 and 532 mm, bores between 381 and 463 mm."""
    rings = read_rings()
    posterior = ring_posterior(2 / 0.490, 0.042, np.diag([0.02**2, 0.001**2]), rings)

    found = likely_ring(posterior, rings)

    assert max(posterior.values()) < LIKELY_ENOUGH
    assert set(found.name.split(" or ")) == {"en1092-dn450-pn10", "asme-nps18"}
    np.testing.assert_allclose(found.radius_outer_m, [0.265, 0.2675])


def test_with_no_ring_that_is_likely_enough_no_radius_is_assumed():
    posterior = ring_posterior(2 / 0.490, 0.042, np.diag([2.0**2, 0.01**2]), RINGS)

    assert likely_ring(posterior, RINGS) is None
