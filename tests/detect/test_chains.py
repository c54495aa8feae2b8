"""Edge chains: continuous, one pixel wide, strongest first."""

import numpy as np
import pytest

from ringpose.detect.line_segments import Gradient, edge_chains, image_gradient

RIGHT, DOWN = 0, 2
MARGIN = 4


def ridges(shape, *lines):
    """A gradient of ridges (pixels, magnitude, orientation), each with an anchor at its middle pixel.

    Their rows and columns count from within a margin of `MARGIN` pixels.
    """
    shape = (shape[0] + 2 * MARGIN, shape[1] + 2 * MARGIN)
    lines = [([(row + MARGIN, column + MARGIN) for row, column in pixels], *rest) for pixels, *rest in lines]
    magnitude = np.zeros(shape, np.int16)
    for pixels, value, _ in lines:
        magnitude[tuple(np.transpose(pixels))] = value
    anchors = [pixels[len(pixels) // 2] for pixels, _, _ in lines]
    return Gradient(
        magnitude=magnitude,
        anchors=np.array([row * shape[1] + column for row, column in anchors], np.int32),
        orientation=np.array([orientation for *_, orientation in lines], np.uint8),
    )


def row_of(row, first, last):
    return [(row, column) for column in range(first, last + 1)]


def column_of(column, first, last):
    return [(row, column) for row in range(first, last + 1)]


def chains_of(gradient, lower_dn=1.0, shortest=3):
    """Each chain as a list of (x, y), counted from within the margin."""
    chains = edge_chains(gradient, lower_dn, shortest)
    return [
        list(map(tuple, (chains.pixels[first:end] - MARGIN).tolist()))
        for first, end in zip(chains.starts[:-1], chains.starts[1:], strict=True)
    ]


def clutter(rng):
    """An image full of edges."""
    return np.kron(rng.integers(0, 256, (12, 14), np.uint8), np.ones((7, 7), np.uint8))


def test_two_walks_from_the_anchor_join_into_one_chain():
    gradient = ridges((9, 30), (row_of(4, 3, 25), 500, RIGHT))

    assert chains_of(gradient) == [[(x, 4) for x in range(3, 26)]]


def test_a_walk_turns_by_45_degrees_a_step():
    bent = [*row_of(4, 3, 12), *[(5 + i, 13 + i) for i in range(4)], *column_of(17, 9, 16)]

    gradient = ridges((20, 30), (bent, 500, RIGHT))

    assert chains_of(gradient) == [[(x, y) for y, x in bent]]


def test_a_walk_ends_where_the_magnitude_falls_under_the_lower_threshold():
    gradient = ridges((9, 40), (row_of(4, 3, 25), 500, RIGHT), (row_of(4, 26, 36), 127, RIGHT))

    assert chains_of(gradient, lower_dn=1.0) == [[(x, 4) for x in range(3, 26)]]


def test_the_stronger_of_two_crossing_ridges_is_walked_through_the_crossing():
    gradient = ridges((30, 30), (row_of(15, 5, 25), 400, RIGHT), (column_of(11, 5, 25), 500, DOWN))

    assert chains_of(gradient)[0] == [(11, y) for y in range(5, 26)]


def test_a_walk_ends_where_a_neighbour_has_no_gradient():
    gradient = ridges((9, 30), (row_of(4, -4, 33), 500, RIGHT))

    assert chains_of(gradient) == [[(x, 4) for x in range(-1, 31)]]


def test_a_walk_ends_at_another_chain():
    gradient = ridges((30, 30), (row_of(15, 12, 25), 400, RIGHT), (column_of(11, 5, 25), 500, DOWN))

    assert chains_of(gradient)[1] == [(x, 15) for x in range(12, 26)]


def test_chains_shorter_than_the_threshold_are_dropped():
    gradient = ridges((9, 40), (row_of(3, 3, 12), 500, RIGHT), (row_of(6, 3, 13), 500, RIGHT))

    assert chains_of(gradient, shortest=11) == [[(x, 6) for x in range(3, 14)]]


def test_a_chain_turns_by_more_than_45_degrees_at_its_anchor_only(rng):
    found = chains_of(image_gradient(clutter(rng), 3.0), shortest=8)

    steps = [np.diff(chain, axis=0) for chain in found]
    turns = [(step[:-1] * step[1:]).sum(axis=1) for step in steps]
    assert max(np.count_nonzero(turn < 1) for turn in turns) <= 1
    assert min(turn.min() for turn in turns) >= 0


@pytest.mark.parametrize("radius_px", [12.0, 25.3])
def test_a_disc_is_one_chain_along_its_rim(radius_px):
    row, column = np.indices((70, 70))
    distance = np.hypot(row - 35.2, column - 34.6)
    disc = (20 + 180 / (1 + np.exp((distance - radius_px) / 0.5))).astype(np.uint8)

    (chain,) = chains_of(image_gradient(disc, 20.0), lower_dn=10.0, shortest=10)

    off_px = np.hypot(*(np.array(chain) + MARGIN - [34.6, 35.2]).T) - radius_px
    assert abs(off_px).max() < 0.75
    assert len(chain) > 0.95 * 8 * np.sin(np.pi / 4) * radius_px
