"""The kernels of the line detector against OpenCV and NumPy, and on inputs with a known answer."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ringpose.detect.line_segments import (
    STEPS_PER_DN,
    Chains,
    Gradient,
    SegmentParameters,
    edge_chains,
    fitted_lines,
    image_gradient,
    joined_lines,
    straight_pieces,
)

BINOMIAL = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16
ROUNDING = 8
"""Most by which a magnitude is off because the smoothed image is kept in sixteenths of a grey value."""


def opencv_magnitude(image, bits):
    """max + 3/8 min of the components of OpenCV's Sobel gradient, in units of 1/128 grey value per pixel."""
    smooth = cv2.sepFilter2D(image.astype(np.float64) / 2 ** (bits - 8), -1, BINOMIAL, BINOMIAL)
    x, y = (16 * np.abs(cv2.Sobel(smooth, cv2.CV_64F, *order)) for order in ((1, 0), (0, 1)))
    return np.maximum(x, y) + 0.375 * np.minimum(x, y)


@pytest.mark.parametrize(("bits", "dtype"), [(8, np.uint8), (12, np.uint16), (16, np.uint16)])
@pytest.mark.parametrize("shape", [(7, 7), (24, 33), (64, 80)])
def test_magnitude_is_that_of_opencvs_gradient(bits, dtype, shape, rng):
    image = rng.integers(0, 1 << bits, shape).astype(dtype)

    magnitude = image_gradient(image, 1.0, bits).magnitude

    np.testing.assert_allclose(magnitude[3:-3, 3:-3], opencv_magnitude(image, bits)[3:-3, 3:-3], atol=ROUNDING)


@given(arrays(np.uint8, st.tuples(st.integers(1, 24), st.integers(1, 40)), elements=st.integers(0, 255)))
def test_anchors_are_strong_maxima_on_every_eighth_row_or_column(image):
    gradient = image_gradient(image, 500 / STEPS_PER_DN)
    magnitude, anchors, orientation = gradient.magnitude, gradient.anchors, gradient.orientation

    assert (np.diff(anchors) > 0).all()
    for (row, column), way in zip(np.argwhere(np.ones_like(image))[anchors].tolist(), orientation, strict=True):
        along_row = [magnitude[row, column + k] for k in (-1, 0, 1)]
        down_column = [magnitude[row + k, column] for k in (-1, 0, 1)]
        on_row = row % 8 == 0 and max(along_row) == along_row[1]
        on_column = column % 8 == 0 and max(down_column) == down_column[1]
        assert magnitude[row, column] >= 500
        assert {0: on_column, 2: on_row}.get(way, on_row or on_column)


@given(
    magnitude=arrays(np.int16, st.tuples(st.integers(7, 20), st.integers(7, 24)), elements=st.integers(0, 5)),
    lower=st.integers(1, 4),
    data=st.data(),
)
def test_chains_of_any_magnitude_are_connected_and_strong_and_share_no_pixel(magnitude, lower, data):
    inner = np.arange(magnitude.size).reshape(magnitude.shape)[3:-3, 3:-3].ravel().tolist()
    anchors = np.array(data.draw(st.lists(st.sampled_from(inner), max_size=30)), np.int32)

    orientation = np.resize(np.arange(4, dtype=np.uint8), len(anchors))
    gradient = Gradient(magnitude=magnitude, anchors=anchors, orientation=orientation)
    chains = edge_chains(gradient, lower / STEPS_PER_DN, 2)
    pixels, starts = chains.pixels, chains.starts

    x, y = pixels.T
    assert (magnitude[y, x] >= lower).all()
    assert len(np.unique(pixels, axis=0)) == len(pixels)
    for chain in np.split(pixels, starts[1:-1]) if len(starts) > 1 else []:
        assert set(np.abs(np.diff(chain, axis=0)).max(axis=1)) == {1}
        assert set(map(int, chain @ [1, magnitude.shape[1]])) & set(anchors.tolist())


@given(steps=st.lists(st.integers(0, 7), min_size=1, max_size=80))
def test_pieces_of_any_walk_are_no_longer_than_their_chords_by_more_than_the_deviation(steps):
    angle = np.array(steps) * np.pi / 4
    walk = np.cumsum(np.round(np.stack([np.cos(angle), np.sin(angle)], axis=1)), axis=0, dtype=np.float64)
    pixels = walk.astype(np.int32)

    parameters = SegmentParameters(deviation_px=0.5, share_change=0.7, window_steps=6)
    pieces = straight_pieces(Chains(pixels=pixels, starts=np.array([0, len(pixels)], np.int32)), parameters, 4)

    assert (np.diff(pieces.ravel()) >= 0).all()
    for first, last in pieces:
        moves = np.abs(np.diff(pixels[first : last + 1], axis=0))
        length = np.hypot(*np.cumsum(moves, axis=0).T)
        chord = np.hypot(*(pixels[first + 1 : last + 1] - pixels[first]).T)
        assert last - first + 1 >= 4
        assert (length - chord <= 0.5 + 1e-9).all()


@pytest.mark.parametrize(("deviation_px", "last"), [(1.3, 40), (1.5, 41)])
def test_a_roof_is_cut_at_its_ridge_as_soon_as_it_is_longer_than_its_chord_by_the_deviation(deviation_px, last):
    """40 steps up and one down along diagonals: hypot(41, 41) - hypot(41, 39) = 1.40."""
    walk = [(k, min(k, 80 - k)) for k in range(42)]

    parameters = SegmentParameters(deviation_px=deviation_px, share_change=9.0, window_steps=50)
    chains = Chains(pixels=np.array(walk, np.int32), starts=np.array([0, 42], np.int32))
    pieces = straight_pieces(chains, parameters, 4)

    assert pieces[0].tolist() == [0, last]


def ridge(slope, offset, upright):
    """A magnitude whose crest is a line, its pixels nearest to that, and the crests in each column (or row)."""
    along = np.arange(5, 75)
    crest = offset + slope * along
    magnitude = np.zeros((80, 80), np.int16)
    for x, y in zip(along, crest, strict=True):
        rows = np.arange(80)
        magnitude[:, x] = np.maximum(20000 - 3000 * (rows - y) ** 2, 0)
    pixels = np.stack([along, np.rint(crest)], axis=1).astype(np.int32)
    return (magnitude.T.copy(), pixels[:, ::-1].copy()) if upright else (magnitude, pixels)


@pytest.mark.parametrize("upright", [False, True])
@pytest.mark.parametrize(("slope", "offset"), [(0.0, 30.27), (0.31, 20.4), (-0.72, 70.9)])
def test_the_line_of_a_piece_runs_along_the_crest(slope, offset, upright):
    magnitude, pixels = ridge(slope, offset, upright)

    lines, moments = fitted_lines(magnitude, pixels, np.array([[0, 69]], np.int32), 3)

    ends = lines[0, :, ::-1] if upright else lines[0]
    np.testing.assert_allclose(ends, [[5, offset + 5 * slope], [74, offset + 74 * slope]], atol=2e-3)
    along, across = np.arange(8, 72), offset + slope * np.arange(8, 72)
    u, v = (across, along) if upright else (along, across)
    sums = [64, u.sum(), v.sum(), u @ u, u @ v, v @ v]
    np.testing.assert_allclose(moments[0], sums, rtol=1e-4)


def fragments(*spans, slope=0.4, offset=3.0, scatter=0.3):
    """Fragments of one line between these abscissae: ends, moments and pieces."""
    rng = np.random.default_rng(7)
    points = [
        np.stack([x, offset + slope * x + rng.normal(0, scatter, len(x))]) for x in (np.arange(*s) for s in spans)
    ]
    fits = [np.polyfit(*each, 1) for each in points]
    lines = [[[x, np.polyval(fit, x)] for x in each[0, [0, -1]]] for fit, each in zip(fits, points, strict=True)]
    moments = [[len(x), x.sum(), y.sum(), x @ x, x @ y, y @ y] for x, y in points]
    pieces = [[0, len(each[0]) - 1] for each in points]
    return points, (np.array(lines), np.array(moments), np.array(pieces, np.int32))


def test_fragments_of_a_line_become_the_least_squares_line_through_all_their_points():
    points, tables = fragments((0, 30), (34, 50), (55, 90))

    lines, support = joined_lines(*tables, 8.0, 1.5, 10)

    fit = np.polyfit(*np.concatenate(points, axis=1), 1)
    assert support.tolist() == [30 + 16 + 35]
    np.testing.assert_allclose(lines[0], [[x, np.polyval(fit, x)] for x in (0.0, 89.0)], atol=1e-9)


@pytest.mark.parametrize(
    "second", [{"spans": (50, 90)}, {"offset": 9.0}, {"slope": 0.9}], ids=["far", "beside", "bent"]
)
def test_what_is_not_on_one_line_stays_apart(second):
    (_, first), (_, other) = fragments((0, 30)), fragments(second.pop("spans", (33, 70)), **second)

    _, support = joined_lines(*map(np.concatenate, zip(first, other, strict=True)), 8.0, 1.5, 10)

    assert len(support) == 2


def test_short_lines_that_no_other_took_are_dropped():
    _, tables = fragments((0, 30), (60, 68))

    assert joined_lines(*tables, 8.0, 1.5, 10)[1].tolist() == [30]


@given(
    ends=arrays(np.float64, st.tuples(st.integers(0, 25), st.just(2), st.just(2)), elements=st.integers(-3, 40)),
    gap_px=st.sampled_from([0.0, 3.0, 30.0]),
    aside_px=st.sampled_from([0.5, 2.0, 9.0]),
)
def test_no_line_is_joined_to_two_others(ends, gap_px, aside_px):
    x, y = ends[..., 0], ends[..., 1]
    moments = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1).sum(axis=2)
    pieces = np.stack([np.zeros(len(ends)), 2.0 ** np.arange(len(ends)) - 1], axis=1).astype(np.int32)

    _, support = joined_lines(ends, moments, pieces, gap_px, aside_px, 1)

    assert support.sum() == 2 ** len(ends) - 1
