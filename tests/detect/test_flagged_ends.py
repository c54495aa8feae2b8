"""Covariances and flags of ends, against the errors of least-squares lines."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_scene import drawn_rig

from ringpose.detect.break_points import FACET_SIGMAS, flagged_ends
from ringpose.types.rig import LaserPlanes, Rig


def rig_of(lasers: int) -> Rig:
    """A rig with so many lasers and images of 800 columns."""
    rig = drawn_rig()
    planes = LaserPlanes(
        names=tuple(map(str, range(lasers))),
        normal=np.tile([0.0, 1.0, 0.0], (lasers, 1)),
        distance_m=np.full(lasers, -0.1),
        projector_m=np.full((lasers, 3), np.nan),
    )
    return replace(rig, camera=replace(rig.camera, image_width=800), lasers=planes)


def segments(rng, count):
    """Segments of any kind."""
    start, length = rng.uniform(0, 500, count), rng.uniform(0, 300, count)
    line = (start + length / 2, rng.uniform(50, 550, count), rng.uniform(-0.2, 0.2, count))
    spread = (rng.uniform(0.01, 0.5, count), rng.uniform(1, 20, count))
    rest = (np.zeros(count), np.zeros(count), np.zeros(count))
    return np.stack(
        [np.full(count, -1.0), rng.integers(8, 300, count), start, start + length, *line, *spread, *rest], -1
    )


def found_ends(rng, count):
    """Results of `stripe_ends`; some are not there, and some lie at the border."""
    section, beneath = rng.uniform(0.8, 4, (count, 1)), rng.uniform(0, 0.05, (count, 1))
    shape = (count, 2)
    columns = (
        rng.uniform(-5, 805, shape),
        rng.uniform(0, 600, shape),
        rng.uniform(-0.2, 0.2, shape),
        rng.uniform(0.01, 1.5, shape),
        rng.uniform(0, 0.5, shape),
        rng.uniform(0, 1, shape) * (rng.random(shape) < 0.3),
        rng.uniform(0.5, 4, shape),
        np.broadcast_to(section, shape),
        1.0 * (rng.random(shape) < 0.2),
        np.broadcast_to(beneath, shape),
    )
    ends = np.stack(columns, axis=-1)
    ends[rng.random(shape) < 0.2, :7] = np.nan
    ends[rng.random(count) < 0.1] = np.nan
    return ends


def clean_ends(count):
    """Ends at columns 300 and 500 on a horizontal line, of stripes with nothing beneath them."""
    ends = np.zeros((count, 2, 10))
    ends[:, 0], ends[:, 1] = ([x, 200.0, 0.0, 0.1, 0.0, 0.0, 1.0, 2.0, 0.0, 0.0] for x in (300.0, 500.0))
    return ends


@pytest.mark.parametrize(("columns", "alike"), [(200, 1.0), (200, 2.0), (60, 3.0)])
def test_ordinates_err_like_those_of_a_least_squares_line(columns, alike):
    """Of so many centres less four at either end, each few correlated ones count as one, and the fit takes five."""
    scatter, length = 0.3, 200.0
    segment = np.array([[-1.0, columns, 300.0, 500.0, 400.0, 200.0, 0.0, scatter, alike, 0.0, 0.0, 0.0]])

    found = flagged_ends(segment, clean_ends(1), [0], rig_of(1))

    used = columns - 8
    x = np.linspace(-length / 2, length / 2, 10_001) * used / columns
    middle = scatter / np.sqrt(used / alike - 5)
    expected = middle * np.sqrt(1 + (length / 2) ** 2 / np.mean(x**2))
    np.testing.assert_allclose(found.straight_sigma_px, expected, rtol=1e-3)
    np.testing.assert_allclose(found.straight_px[0], [[300, 200], [500, 200]])
    np.testing.assert_allclose(found.position_px[0], [[300, 200], [500, 200]])


def test_what_lies_beneath_a_stripe_makes_its_line_no_better_than_that():
    segment = np.array([[-1.0, 200.0, 300.0, 500.0, 400.0, 200.0, 0.0, 1e-6, 1.0, 0.0, 0.0, 0.0]])
    ends = clean_ends(1)
    ends[..., 9] = 0.04

    found = flagged_ends(segment, ends, [0], rig_of(1))

    shift = 2.0 * 0.2 / np.sqrt(200 / (FACET_SIGMAS * 2.0))
    at_ends = np.sqrt(1.0 + 3.0 / (192 / 200) ** 2)  # four of 200 centres at either end are not used
    np.testing.assert_allclose(found.straight_sigma_px, at_ends * shift, rtol=1e-6)


def test_ends_belong_to_the_lasers_of_their_tracks(rng):
    drawn, ends = segments(rng, 5), found_ends(rng, 5)
    lasers = rng.permutation(8)[:5].tolist()

    found = flagged_ends(drawn, ends, lasers, rig_of(8))

    for number, laser in enumerate(lasers):
        alone = flagged_ends(drawn[[number]], ends[[number]], [0], rig_of(1))
        np.testing.assert_array_equal(found.position_px[laser], alone.position_px[0])
        np.testing.assert_array_equal(found.flags[laser], alone.flags[0])
        np.testing.assert_array_equal(found.straight_px[laser], alone.straight_px[0])


@pytest.mark.parametrize(
    ("scatter_px", "lowest_px", "highest_px"),
    [(0.01, 0.02, 0.05), (0.05, 0.05, 0.05), (0.4, 0.29, 0.4)],
    ids=["small by chance", "as the others", "on textured background"],
)
def test_scatter_of_a_stripe_is_estimated_together_with_that_of_the_others(scatter_px, lowest_px, highest_px):
    """Of three stripes of 68 columns; the fit of a line then takes 5 / sqrt(3) columns from each."""
    segment = np.array([[-1.0, 68.0, 300.0, 500.0, 400.0, 200.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0]] * 3)
    segment[2, 7] = scatter_px

    found = flagged_ends(segment, clean_ends(3), [0, 1, 2], rig_of(3))

    middle_px = found.straight_sigma_px[2, 0] / np.hypot(1, np.sqrt(3) * 68 / 60)
    assert lowest_px <= middle_px * np.sqrt(60 - 5 / np.sqrt(3)) * 1.001
    assert middle_px * np.sqrt(60 - 5 / np.sqrt(3)) <= highest_px * 1.001


def test_an_end_errs_along_its_line_by_its_own_sigma_and_across_by_the_lines(rng):
    drawn, ends = segments(rng, 1), found_ends(rng, 1)
    ends[0, 1] = [drawn[0, 3], 300.0, 0.5, 0.2, 0.0, 0.0, 1.0, 2.0, 0.0, 0.0]

    marks = flagged_ends(drawn, ends, [0], rig_of(1))

    covariance, across = marks.covariance_px2[0, 1], np.array([-0.5, 1.0])
    assert covariance[0, 0] == pytest.approx(0.2**2)
    assert across @ covariance @ across == pytest.approx(marks.straight_sigma_px[0, 1] ** 2)


@pytest.mark.parametrize(
    ("column", "value", "flag"),
    [(5, 0.5, 1), (4, 0.5, 2), (0, 1.0, 4), (0, np.nan, 4), (8, 1.0, 32), (3, 1.0, 64)],
    ids=["saturated", "kink", "at the border", "none", "blunt", "unclear"],
)
def test_flags_say_what_an_end_is(rng, column, value, flag):
    ends = np.zeros((1, 2, 10))
    ends[0, 0] = [400.0, 300.0, 0.0, 0.2, 0.0, 0.0, 1.0, 2.0, 0.0, 0.0]
    ends[0, 0, column] = value

    assert flagged_ends(segments(rng, 1), ends, [0], rig_of(1)).flags[0, 0] == flag


def test_lasers_without_a_track_have_no_end(rng):
    ends = flagged_ends(segments(rng, 1), found_ends(rng, 1), [1], rig_of(3))

    assert all(np.isnan(each[[0, 2]]).all() for each in (*ends[:2], *ends[3:]))
    assert not ends.flags[[0, 2]].any()
