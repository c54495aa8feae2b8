"""Straight segments: the kernel finds the lines that were drawn."""

from dataclasses import astuple, replace

import cv2
import numpy as np
import pytest

from ringpose.detect.stripes import DISTORTION, straight_segments
from ringpose.kernels.lines import SEGMENT_COLUMNS, Lens, SegmentParams

RULES = SegmentParams(image_width=800, border_px=3.0)
STRAIGHT = Lens(fx=900.0, fy=900.0, cx=400.0, cy=300.0, **dict.fromkeys(DISTORTION, 0.0))
BENT = replace(STRAIGHT, fy=905.0, k1=-0.2, k2=0.1, p1=0.001, p2=-0.002, k3=0.03, k4=0.01, k5=0.002)


def line(x, y, laser=-1):
    """One piece as arguments of straight_segments."""
    position = np.column_stack([x, y]).astype(np.float64)
    return position, np.full(len(x), 0.1), np.zeros(len(x), dtype=np.int64), np.array([laser], dtype=np.int64)


def columns(rows, name):
    return rows[:, SEGMENT_COLUMNS.index(name)]


@pytest.mark.parametrize("wrong", [{"min_columns": 3}, {"image_width": 0}, {"kink_px": np.nan}])
def test_parameters_out_of_range_are_a_value_error(wrong):
    with pytest.raises(ValueError, match="params"):
        straight_segments(*line(np.arange(100, 300), np.zeros(200)), STRAIGHT, replace(RULES, **wrong))


def test_a_drawn_line_comes_back():
    x = np.arange(100, 300)

    rows = straight_segments(*line(x, 200 + 0.03 * x), STRAIGHT, RULES)

    assert len(rows) == 1
    assert columns(rows, "slope") == pytest.approx(0.03, abs=1e-9)
    assert columns(rows, "middle_y") == pytest.approx(200 + 0.03 * 199.5, abs=1e-9)
    assert (columns(rows, "x_start")[0], columns(rows, "x_end")[0]) == (100, 299)


def test_tracks_of_noisy_lines_are_least_squares_lines(rng):
    x = np.arange(100, 300)
    drawn = [250.0 + slope * (x - 200) + rng.normal(0, 0.2, 200) for slope in (-0.2, 0.0, 0.3)]
    position = np.concatenate([np.column_stack([x, y + 60 * k]) for k, y in enumerate(drawn)])
    piece, laser = np.repeat([0, 1, 2], 200), np.array([-1, 2, 0])

    rows = straight_segments(position, np.full(600, 0.2), piece, laser, STRAIGHT, RULES)

    assert columns(rows, "laser").tolist() == [-1, 2, 0]
    for k, y in enumerate(drawn):
        slope, offset = np.polyfit(x, y + 60 * k, 1)
        assert columns(rows, "slope")[k] == pytest.approx(slope, abs=2e-4)
        expected_y = offset + slope * columns(rows, "middle_x")[k]
        assert columns(rows, "middle_y")[k] == pytest.approx(expected_y, abs=0.01)
        assert columns(rows, "scatter")[k] == pytest.approx(np.std(y + 60 * k - offset - slope * x), rel=0.1)


def test_pieces_in_another_order_give_the_same_tracks(rng):
    x = np.tile(np.arange(100.0, 160.0), 4)
    y = np.repeat([100.0, 200.0, 200.4, 300.0], 60) + np.repeat([0.0, 0.1, 0.1, -0.1], 60) * x
    x[120:180] += 70
    position = np.column_stack([x, y + rng.normal(0, 0.1, 240)])
    piece, laser = np.repeat(np.arange(4), 60), np.full(4, -1)

    found, other = (
        straight_segments(each, np.full(240, 0.1), piece, laser, STRAIGHT, RULES)
        for each in (position, position.reshape(4, 60, 2)[::-1].reshape(-1, 2).copy())
    )

    order, reverse = (np.lexsort((rows[:, 5], rows[:, 2])) for rows in (found, other))
    np.testing.assert_allclose(found[order], other[reverse], atol=1e-9)


def test_a_kink_cuts_a_piece_in_two():
    x = np.arange(100, 300)
    y = 200 + np.where(x > 220, 0.3 * (x - 220), 0.0)

    rows = straight_segments(*line(x, y), STRAIGHT, RULES)

    assert np.sort(columns(rows, "slope")) == pytest.approx([0.0, 0.3], abs=0.01)
    assert np.sort(columns(rows, "x_start"))[1] == pytest.approx(220, abs=3)


def test_a_step_that_raised_all_sigmas_is_cut(rng):
    """From a ring's face to the foil behind it, at 1 m: neither it nor its own smooth rise may join the two."""
    x = np.arange(100, 250)
    y = 200 + 4.6 / (1 + np.exp(-(x - 152.0) / 1.5)) + rng.normal(0, 0.1, 150)
    position, sigma, piece, laser = line(x, y)

    rows = straight_segments(position, np.full_like(sigma, 1.2), piece, laser, STRAIGHT, RULES)

    assert np.sort(columns(rows, "middle_y")) == pytest.approx([200.0, 204.6], abs=0.1)
    assert np.sort(columns(rows, "x_end"))[0] == pytest.approx(150, abs=5)


def test_a_gap_on_one_line_is_bridged():
    x = np.concatenate([np.arange(100, 160), np.arange(175, 240)])
    piece = np.repeat([0, 1], [60, 65])

    rows = straight_segments(
        np.column_stack([x, np.full(125, 50.0)]).astype(np.float64),
        np.full(125, 0.1),
        piece.astype(np.int64),
        np.array([-1, -1], dtype=np.int64),
        STRAIGHT,
        RULES,
    )

    assert columns(rows, "centers").tolist() == [125]


def test_distortion_is_undone():
    x = np.linspace(20, 780, 400)
    rays = np.column_stack([(x - 400) / 900, np.full(400, 0.25), np.ones(400)])

    matrix = np.array([[900.0, 0, 400], [0, 905.0, 300], [0, 0, 1]])
    coefficients = np.array(astuple(BENT)[4:])
    bent = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, coefficients)[0].reshape(-1, 2)

    rows = straight_segments(bent, np.full(400, 0.1), np.zeros(400, np.int64), np.zeros(1, np.int64), BENT, RULES)

    assert len(rows) == 1
    assert columns(rows, "slope") == pytest.approx(0.0, abs=1e-8)
    assert columns(rows, "middle_y") == pytest.approx(300 + 905 * 0.25, abs=1e-5)


def test_white_noise_has_a_correlation_near_one(rng):
    x = np.arange(0, 700)

    rows = straight_segments(*line(x, 200 + rng.normal(0, 0.2, 700)), STRAIGHT, RULES)

    assert 1.0 <= columns(rows, "correlation")[0] < 1.6


def test_no_centres_give_no_tracks():
    nothing = np.zeros((0, 2)), np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64)

    assert straight_segments(*nothing, STRAIGHT, RULES).shape == (0, len(SEGMENT_COLUMNS))


@pytest.mark.parametrize(
    ("piece", "position"),
    [(np.array([1, 0]), 1.0), (np.array([0, 5]), 1.0), (np.array([0, 0]), np.nan)],
    ids=["descending", "beyond", "not a number"],
)
def test_centres_out_of_order_are_rejected(piece, position):
    with pytest.raises(ValueError, match="centers"):
        straight_segments(
            np.full((2, 2), position), np.ones(2), piece.astype(np.int64), np.zeros(2, np.int64), STRAIGHT, RULES
        )
