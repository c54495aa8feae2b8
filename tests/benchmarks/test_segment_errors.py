"""What the comparison says of segments that are off by known amounts."""

import math

import numpy as np
import pytest
from benchmarks.robust_statistics import joined
from benchmarks.segment_errors import COVERED, length_px, length_recalled_px, stripe_errors
from benchmarks.stripe_images import StripeImage, stripe_rig

from ringpose.types.detection import Segments

SIGMA_PX = 2.5
SLOPE = 0.05
STARTS_AND_STOPS = ((10.0, 100.0), (120.0, 160.0), (180.0, 290.0))


def row(laser, x):
    return 50.0 * (laser + 1) + SLOPE * x


@pytest.fixture
def image():
    """Nine straight pieces; nobody looks at the pixels."""
    pieces = [[(x, row(laser, x)) for x in ends] for laser in range(3) for ends in STARTS_AND_STOPS]
    return StripeImage(
        image=np.zeros((240, 320), np.uint8),
        rig=stripe_rig(0.2, lens=False),
        break_points_px=np.zeros((3, 2, 2)),
        pieces_px=np.array(pieces),
        stripe_sigma_px=SIGMA_PX,
        peak_dn=np.full(3, 170.0),
    )


def segments(*ends):
    values = np.array(ends, dtype=np.float64).reshape(-1, 2, 2)
    return Segments(start_px=values[:, 0], end_px=values[:, 1], support=np.ones(len(values), np.int64))


def lines_along(image, off_px=0.0, short_px=0.0):
    """A segment along each piece, below it by `off_px`, that stops short of both ends; every second one turned."""
    ends = image.pieces_px.copy()
    ends[:, 0] += short_px * np.array([1.0, SLOPE])
    ends[:, 1] -= short_px * np.array([1.0, SLOPE])
    ends[..., 1] += off_px
    ends[::2] = ends[::2, ::-1].copy()
    return list(ends)


def edges_along(image, off_px=0.0, short_px=0.0):
    upper = lines_along(image, off_px - SIGMA_PX, short_px)
    return upper + lines_along(image, off_px + SIGMA_PX, short_px)


@pytest.mark.parametrize("off_px", [-0.3, 0.0, 0.3])
def test_a_shift_of_edges_is_the_error_of_the_center(image, off_px):
    errors = stripe_errors(segments(*edges_along(image, off_px)), image, centers=False)

    assert errors.center_px == pytest.approx(np.full(len(errors.center_px), off_px), abs=1e-9)
    assert len(errors.center_px) == 3 * (91 + 41 + 111)


def test_a_shift_of_center_lines_is_the_error_of_the_center(image):
    errors = stripe_errors(segments(*lines_along(image, 0.3)), image, centers=True)

    assert errors.center_px == pytest.approx(np.full(len(errors.center_px), 0.3), abs=1e-9)


def test_one_shifted_edge_counts_by_half(image):
    moved = lines_along(image, 0.4 - SIGMA_PX) + lines_along(image, SIGMA_PX)

    errors = stripe_errors(segments(*moved), image, centers=False)

    assert errors.center_px == pytest.approx(np.full(len(errors.center_px), 0.2), abs=1e-9)


@pytest.mark.parametrize("short_px", [-1.5, 0.0, 1.5])
def test_ends_that_stop_short_are_short_by_that(image, short_px):
    errors = stripe_errors(segments(*edges_along(image, short_px=short_px)), image, centers=False)

    assert errors.short_px == pytest.approx(np.full(18, short_px), abs=1e-9)


def test_a_whole_line_on_each_edge_is_one_segment_and_covers_all(image):
    errors = stripe_errors(segments(*edges_along(image)), image, centers=False)

    assert errors.coverage.tolist() == [1.0] * 9
    assert errors.segments.tolist() == [1.0] * 9
    assert errors.false == 0


def test_one_edge_alone_covers_the_piece_but_gives_no_center(image):
    errors = stripe_errors(segments(*lines_along(image, -SIGMA_PX)), image, centers=False)

    assert (errors.coverage > COVERED).all()
    assert len(errors.center_px) == 0
    assert errors.segments.tolist() == [0.5] * 9


def test_coverage_is_the_share_of_columns(image):
    half = [[(10.0, row(0, 10.0)), (55.0, row(0, 55.0))]]

    errors = stripe_errors(segments(*half), image, centers=True)

    assert errors.coverage[0] == pytest.approx(46 / 91)
    assert len(errors.short_px) == 0


def test_two_parts_of_a_line_are_two_segments(image):
    parts = [[(10.0, row(0, 10.0)), (50.0, row(0, 50.0))], [(52.0, row(0, 52.0)), (100.0, row(0, 100.0))]]

    errors = stripe_errors(segments(*parts), image, centers=True)

    assert (errors.segments[0], errors.coverage[0]) == (2.0, pytest.approx(90 / 91))
    assert errors.short_px == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize(
    "stranger",
    [
        [(30.0, row(0, 30.0) - 12), (80.0, row(0, 80.0) - 12)],
        [(50.0, row(0, 50.0) - 6), (80.0, row(0, 80.0) + 6)],
        [(300.0, row(0, 300.0)), (318.0, row(0, 318.0))],
        [(50.0, row(0, 50.0) - 5), (50.0, row(0, 50.0) + 5)],
    ],
    ids=["beside", "turned", "beyond", "across"],
)
def test_what_lies_along_no_piece_is_false(image, stranger):
    errors = stripe_errors(segments(*edges_along(image), stranger), image, centers=False)

    assert errors.false == 1
    assert errors.segments.tolist() == [1.0] * 9


def test_no_segments_are_no_recall(image):
    errors = stripe_errors(segments(), image, centers=False)

    assert (errors.coverage.tolist(), len(errors.center_px), errors.false) == ([0.0] * 9, 0, 0)


def test_images_add_up(image):
    parts = [
        stripe_errors(segments(*edges_along(image, off_px), stranger), image, centers=False)
        for off_px, stranger in ((0.1, [(300, 5), (310, 5)]), (0.3, [(300, 9), (310, 9)]))
    ]

    both = joined(parts)

    assert (len(both.coverage), both.false, len(both.short_px)) == (18, 2, 36)
    assert both.center_px.mean() == pytest.approx(0.2)


LINES_PX = np.array([[(10.0, 20.0), (110.0, 20.0)], [(30.0, 40.0), (30.0, 240.0)]])
"""100 px along a row and 200 px along a column."""


def recalled(*ends, distance_px=1.5):
    return length_recalled_px(LINES_PX, segments(*ends), distance_px)


def test_all_lines_together_are_as_long_as_they_are():
    assert length_px(LINES_PX) == 300


def test_lines_that_are_found_are_recalled_whole_in_either_sense():
    assert recalled([(10, 20), (110, 20)], [(30, 240), (30, 40)]) == pytest.approx(300)


def test_half_a_line_is_half_recalled():
    assert recalled([(10, 20), (59, 20)]) == pytest.approx(50)


def test_parts_add_up_but_count_once():
    assert recalled([(10, 20), (59, 20)], [(10, 21), (59, 21)], [(80, 20), (110, 20)]) == pytest.approx(50 + 31)


@pytest.mark.parametrize(("off_px", "distance_px", "length"), [(1.4, 1.5, 100), (1.6, 1.5, 0), (1.6, 3.0, 100)])
def test_a_segment_must_be_near(off_px, distance_px, length):
    assert recalled([(10, 20 + off_px), (110, 20 + off_px)], distance_px=distance_px) == pytest.approx(length)


@pytest.mark.parametrize(("turned_deg", "found"), [(4.9, True), (5.1, False), (175.1, True), (90, False)])
def test_a_segment_must_run_along_the_line(turned_deg, found):
    along = 10 * np.array([math.cos(math.radians(turned_deg)), math.sin(math.radians(turned_deg))])
    middle = np.array([60.0, 20.0])

    assert (recalled([middle - along, middle + along]) > 0) == found


def test_a_segment_without_length_recalls_nothing():
    assert recalled([(60, 20), (60, 20)]) == 0


def test_no_segments_recall_nothing():
    assert recalled() == 0
