from itertools import pairwise

import numpy as np
import pytest

from ringpose.kernels import render
from ringpose.simulate.target.parts import target_tables
from ringpose.types.target import MATERIALS, Gap, Part, Revolution, RingForm

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


def tables_of(profile_m, **values):
    shape = Revolution(profile_m=np.asarray(profile_m, dtype=float))
    return target_tables([Part(name="part", shape=shape, materials=(MATERIALS["metal"],), **values)])


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
def test_hits_lie_on_the_surface_and_normals_are_its_gradient(name, rng):
    profile_m = np.array(PROFILES[name])

    hits = render.first_hits(tables_of(profile_m), *rays(rng))

    hit = hits.surface >= 0
    point, normal = hits.point_m[:, hit], hits.normal[:, hit]
    assert hit.sum() > 50
    assert distance_from_profile(profile_m, point).max() < 1e-9
    step_m = 1e-6
    stepped = distance_from_profile(profile_m, point + step_m * normal)
    edge = distance_from_corners(profile_m, point) < 2 * step_m
    assert np.abs(stepped[~edge] / step_m - 1).max() < 1e-4


def test_a_ray_hits_the_solid_where_it_enters_it_first(rng):
    """Compared with dense samples along the rays, which may miss what is shorter than their distance."""
    profile_m = np.array(PROFILES["annulus with walls"])
    origin, direction = rays(rng)
    share = np.linspace(0, 3, 2400)

    hits = render.first_hits(tables_of(profile_m), origin, direction)

    inside = np.array(
        [inside_ring(origin + direction * each, profile_m) for each in share]  # (sample, ray)
    )
    enters = inside.any(axis=0)
    assert enters.sum() > 100
    first = share[inside.argmax(axis=0)[enters]]
    assert (hits.surface[enters] >= 0).all()
    assert (hits.parameter[enters] <= first).all()
    assert not (inside & (share[:, None] < hits.parameter)).any()


def distance_from_corners(profile_m, point):
    meridian = np.stack([np.hypot(point[0], point[1]), point[2]], axis=1)
    return np.linalg.norm(meridian[:, None] - profile_m, axis=2).min(axis=1)


def test_the_ring_blocks_what_passes_through_it(rng):
    profile_m = np.array(PROFILES["annulus with walls"])
    start = np.stack([rng.uniform(0.4, 0.55, 500), rng.uniform(-0.1, 0.1, 500), rng.uniform(0, 0.05, 500)])
    end = np.stack([rng.uniform(0.61, 0.8, 500), rng.uniform(-0.1, 0.1, 500), rng.uniform(0, 0.3, 500)])
    between = start[:, None] + (end - start)[:, None] * np.linspace(0, 1, 3000)[:, None]
    passes = inside_ring(between.reshape(3, -1), profile_m).reshape(3000, -1).any(axis=0)

    found = render.blocked(tables_of(profile_m), start, end - start)

    np.testing.assert_array_equal(found, passes)


RING = [[0.567, 0.0], [0.567, 0.06], [0.597, 0.06], [0.597, 0.0]]
GAP = Gap(angle_rad=0.1, width_m=0.05, depth_m=0.02)


def in_gap(point):
    across = point[1] * np.cos(GAP.angle_rad) - point[0] * np.sin(GAP.angle_rad)
    return (np.abs(across) < GAP.width_m / 2) & (point[2] > 0.04) & (point[0] > 0)


def test_a_gap_has_two_walls_and_a_floor_and_nothing_within(rng):
    """Every hit lies on the surface outside the gap, or on a wall or the floor of the gap within the ring's section."""
    origin, direction = rays(rng)
    direction = np.array([[0.58], [0.06], [0.05]]) + 0.04 * rng.standard_normal(direction.shape) - origin

    hits = render.first_hits(tables_of(RING, gaps=(GAP,)), origin, direction)

    hit = hits.surface >= 0
    point = hits.point_m[:, hit]
    on_gap = hits.surface[hit] == 3
    assert on_gap.sum() > 20
    assert not in_gap(point[:, ~on_gap]).any()
    across = np.abs(point[1] * np.cos(GAP.angle_rad) - point[0] * np.sin(GAP.angle_rad))[on_gap]
    off_wall, off_floor = np.abs(across - GAP.width_m / 2), np.abs(point[2, on_gap] - 0.04)
    assert np.minimum(off_wall, off_floor).max() < 1e-9
    radius = np.hypot(point[0], point[1])[on_gap]
    assert radius.min() > 0.567
    assert radius.max() < 0.597


def test_rays_pass_through_a_gap_that_is_open_below(rng):
    deep = Gap(angle_rad=0.1, width_m=0.05, depth_m=0.06)
    middle = np.array([np.cos(0.1), np.sin(0.1)])
    start = np.array([*(0.4 * middle), 0.03])[:, None]

    through = render.blocked(tables_of(RING, gaps=(deep,)), start, np.array([[*(0.4 * middle), 0.0]]).T)

    assert not through.any()
    assert render.blocked(tables_of(RING), start, np.array([[*(0.4 * middle), 0.0]]).T).all()


def test_hits_lie_on_the_deformed_ring(rng):
    """The radius and height of each hit, less the deviations at its angle, lie on the ideal profile."""
    form = RingForm(radial_m=2e-4 * rng.standard_normal((2, 3, 2)), axial_m=2e-4 * rng.standard_normal((3, 2)))
    origin, direction = rays(rng)

    hits = render.first_hits(tables_of(RING, form=form), origin, direction)

    point = hits.point_m[:, hits.surface >= 0]
    angle = np.arctan2(point[1], point[0])
    waves = np.array([[np.cos(order * angle), np.sin(order * angle)] for order in (2, 3, 4)])
    inner, outer = np.einsum("eow,own->en", form.radial_m, waves)
    radius = np.hypot(point[0], point[1])
    share = np.clip((radius - 0.567 - inner) / (0.03 + outer - inner), 0, 1)
    ideal = np.stack([radius - inner - share * (outer - inner), np.zeros_like(radius)])
    ideal = np.vstack([ideal, point[2] - np.einsum("ow,own->n", form.axial_m, waves)])
    assert len(angle) > 50
    assert np.percentile(distance_from_profile(np.array(RING), ideal), 98) < 1e-8
