import numpy as np

from ringpose.kernels.render import NONE, blocked, first_hits
from ringpose.simulate.target.parts import body_part, relief, target_tables
from ringpose.types.target import Body, Foil

SIZE_M = np.array([2.0, 1.5, 1.0])


def target_of(**values):
    return target_tables([body_part(Body(size_m=SIZE_M, **values))])


def rays_at_box(rng, n=3000):
    eye = np.array([0.3, -0.2, 0.6])
    aim = rng.uniform(-1.3, 1.3, (3, n))
    return eye, aim - eye[:, None]


def test_rays_hit_the_box_where_they_enter_it(rng):
    eye, direction = rays_at_box(rng)

    hits = first_hits(target_of(), eye[:, None], direction)

    point = hits.point_m[:, hits.surface != NONE]
    beyond = np.abs(point - [[0.0], [0.0], [-0.5]]) - SIZE_M[:, None] / 2
    np.testing.assert_allclose(beyond.max(axis=0), 0.0, atol=1e-12)


def test_normals_of_the_box_point_out_of_the_side_that_is_hit(rng):
    eye = np.array([3.0, 2.0, 1.5])
    direction = rng.uniform(-0.9, 0.2, (3, 2000)) - eye[:, None]

    hits = first_hits(target_of(), eye[:, None], direction)

    hit = hits.surface != NONE
    point, normal = hits.point_m[:, hit], hits.normal[:, hit]
    outside = np.abs(point + 1e-6 * normal - [[0.0], [0.0], [-0.5]]) - SIZE_M[:, None] / 2
    np.testing.assert_allclose(outside.max(axis=0), 1e-6, atol=1e-10)


def test_hits_settle_on_the_foil(rng):
    """Height of points above the relief, at the nearest points of its grid."""
    foil = Foil(rms_m=0.0008, crinkle_m=0.03)
    eye = np.array([0.1, 0.05, 0.4])
    direction = np.stack([*rng.uniform(-0.2, 0.2, (2, 2000)), np.zeros(2000)]) - eye[:, None]

    hits = first_hits(target_of(foil=foil), eye[:, None], direction)

    point, normal = hits.point_m, hits.normal
    field = relief(foil)
    grid = field.height_m
    column, row = (np.rint(axis / field.texel_m).astype(int) % 512 for axis in point[:2])
    steepest = np.hypot(field.slope[..., 0], field.slope[..., 1]).max()
    off_m = np.abs(point[2] - grid[row, column])
    assert off_m.max() < steepest * field.texel_m
    assert np.median(off_m) < 5e-5
    np.testing.assert_allclose(np.linalg.norm(normal, axis=0), 1.0, atol=1e-12)


def test_foil_is_determined_by_its_seed_and_has_the_requested_rms_height():
    first, again, other = (relief(Foil(seed=seed, rms_m=0.002)).height_m for seed in (1, 1, 2))

    assert (first == again).all()
    assert (first != other).any()
    np.testing.assert_allclose([first.mean(), first.std()], [0.0, 0.002], atol=1e-6)


def test_slopes_are_the_derivatives_of_the_heights():
    field = relief(Foil())
    grid = field.height_m.astype(float)

    numeric = (np.roll(grid, -1, axis=1) - np.roll(grid, 1, axis=1)) / (2 * field.texel_m)

    np.testing.assert_allclose(field.slope[..., 0], numeric, atol=1e-4)


def test_light_from_behind_a_box_does_not_pass_it():
    behind = blocked(
        target_of(), np.array([[0.1, 0.1], [0.2, 0.2], [0.01, 0.01]]), np.array([[0.0, 0], [0, 0], [-2, 2]])
    )

    assert behind.tolist() == [True, False]
