"""Recall by length of drawn lines."""

import math

import numpy as np
import pytest

from ringpose.bench.detectors_lines import length_px, length_recalled_px
from ringpose.types.detection import Segments

LINES_PX = np.array([[(10.0, 20.0), (110.0, 20.0)], [(30.0, 40.0), (30.0, 240.0)]])
"""100 px along a row and 200 px along a column."""


def segments(*ends):
    values = np.array(ends, dtype=np.float64).reshape(-1, 2, 2)
    return Segments(start_px=values[:, 0], end_px=values[:, 1], support=np.ones(len(values), np.int64))


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
