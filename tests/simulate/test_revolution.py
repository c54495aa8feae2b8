from itertools import pairwise

import numpy as np
import pytest

from ringpose.simulate.surface_of_revolution import blocked, first_hits, normals

PROFILES = {
    "annulus with walls": [[0.567, 0.0], [0.567, 0.06], [0.597, 0.06], [0.597, 0.0]],
    "cones": [[0.50, 0.0], [0.52, 0.05], [0.56, 0.05], [0.60, 0.02], [0.60, 0.0]],
    "bowl": [[0.0, 0.10], [0.3, 0.0], [0.4, 0.2]],
}


def rays(rng, n=4000):
    """Rays from one point in random directions near the ring."""
    origin = np.array([[0.55], [0.05], [0.5]]) + 0.1 * rng.standard_normal((3, 1))
    aim = np.stack([rng.uniform(-0.7, 0.7, n), rng.uniform(-0.7, 0.7, n), rng.uniform(-0.05, 0.25, n)])
    return origin, aim - origin


def distance_from_profile(profile_m, point):
    """Distance of (radius, height) from the polyline, segment by segment."""
    meridian = np.stack([np.hypot(point[0], point[1]), point[2]], axis=1)
    best = np.full(len(meridian), np.inf)
    for first, second in pairwise(profile_m):
        along = second - first
        share = np.clip((meridian - first) @ along / (along @ along), 0, 1)
        best = np.minimum(best, np.linalg.norm(meridian - first - share[:, None] * along, axis=1))
    return best


def inside_ring(point, profile_m):
    radius = np.hypot(point[0], point[1])
    slack = 1e-9
    return (
        (radius > profile_m[0][0] + slack) & (radius < profile_m[2][0] - slack)
        & (point[2] > slack) & (point[2] < profile_m[1][1] - slack)
    )  # fmt: skip


@pytest.mark.parametrize("name", PROFILES)
def test_hits_lie_on_the_surface(name, rng):
    profile_m = np.array(PROFILES[name])
    origin, direction = rays(rng)

    parameter, piece = first_hits(profile_m, origin, direction)

    hit = piece >= 0
    worst_m = distance_from_profile(profile_m, origin + parameter[hit] * direction[:, hit]).max()
    assert hit.sum() > 50
    assert worst_m < 1e-9


def test_no_ray_passes_through_the_solid_before_its_hit(rng):
    profile_m = np.array(PROFILES["annulus with walls"])
    origin, direction = rays(rng)

    parameter, _ = first_hits(profile_m, origin, direction)

    end = np.minimum(parameter, 3.0)
    share = np.linspace(0, 1, 800)[:-1, None]
    passed = origin[:, None] + direction[:, None] * (share * end)
    assert not inside_ring(passed.reshape(3, -1), profile_m).any()


def test_every_ray_that_enters_the_solid_hits(rng):
    profile_m = np.array(PROFILES["annulus with walls"])
    origin, direction = rays(rng)
    share = np.linspace(0, 3, 2000)[:, None]
    enters = np.zeros(direction.shape[1], dtype=bool)
    for block in np.array_split(np.arange(direction.shape[1]), 8):
        passed = origin[:, None] + direction[:, None, block] * share
        enters[block] = inside_ring(passed.reshape(3, -1), profile_m).reshape(len(share), -1).any(axis=0)

    _, piece = first_hits(profile_m, origin, direction)

    assert enters.sum() > 100
    assert (piece[enters] >= 0).all()


@pytest.mark.parametrize("name", PROFILES)
def test_normals_are_the_gradient_of_the_surface(name, rng):
    profile_m = np.array(PROFILES[name])
    origin, direction = rays(rng)
    parameter, piece = first_hits(profile_m, origin, direction)
    hit = piece >= 0
    point = origin + parameter[hit] * direction[:, hit]

    normal = normals(profile_m, point, piece[hit])

    step_m = 1e-6
    stepped = distance_from_profile(profile_m, point + step_m * normal)
    edge = distance_from_corners(profile_m, point) < 2 * step_m
    assert np.abs(stepped[~edge] / step_m - 1).max() < 1e-4


def distance_from_corners(profile_m, point):
    meridian = np.stack([np.hypot(point[0], point[1]), point[2]], axis=1)
    return np.linalg.norm(meridian[:, None] - profile_m, axis=2).min(axis=1)


def test_the_ring_blocks_what_passes_through_it(rng):
    profile_m = np.array(PROFILES["annulus with walls"])
    start = np.stack([rng.uniform(0.4, 0.55, 500), rng.uniform(-0.1, 0.1, 500), rng.uniform(0, 0.05, 500)])
    end = np.stack([rng.uniform(0.61, 0.8, 500), rng.uniform(-0.1, 0.1, 500), rng.uniform(0, 0.3, 500)])
    between = start[:, None] + (end - start)[:, None] * np.linspace(0, 1, 3000)[:, None]
    passes = inside_ring(between.reshape(3, -1), profile_m).reshape(3000, -1).any(axis=0)

    found = blocked(profile_m, start, end - start)

    np.testing.assert_array_equal(found, passes)
