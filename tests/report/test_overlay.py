from dataclasses import replace

import numpy as np
import pytest
from ring_scenes import break_points_of

from ringpose.report.overlay import COLORS, EDGE_COLORS, SEGMENT_COLOR, UNLABELLED_COLOR, overlay
from ringpose.types.detection import (
    UNLABELLED,
    BreakPointFlag,
    BreakPoints,
    Detection,
    NoBreakPoints,
    RingEdgePoints,
    Segments,
    Stripes,
)


def empty(size=(200, 300), dtype=np.uint8):
    return np.zeros(size, dtype)


def detection(points=NoBreakPoints.NO_RING, **parts) -> Detection:
    return Detection(shot="a", stamp_s=0.0, break_points=points, **parts)


def break_points(position, variance_px2=0.01, flags=0) -> BreakPoints:
    pixels = np.full((2, 2, 2), np.nan)
    pixels[1, 1] = position
    return replace(break_points_of(pixels, np.sqrt(variance_px2)), flags=np.full((2, 2), flags))


def test_the_picture_shows_the_dimmed_image_which_is_not_changed(rng):
    image = rng.integers(0, 255, (200, 300), dtype=np.uint8)
    before = image.copy()

    picture = overlay(image, detection())
    overlay(image, detection(break_points([-50.0, 1e4])))  # a point outside is drawn at the border

    np.testing.assert_array_equal(picture[60:, :], np.repeat(image[60:, :, None] // 2, 3, axis=2))
    np.testing.assert_array_equal(image, before)
    assert overlay(np.full((200, 300), 65535, np.uint16), detection())[100, 100].tolist() == [127, 127, 127]


def test_stripes_have_the_colour_of_their_laser():
    stripes = Stripes(
        position_px=np.array([[50.0, 100.2], [51, 99.9], [80, 150], [9999, 3]]),
        sigma_px=np.ones(4),
        peak_dn=np.ones(4),
        piece=np.array([0, 0, 1, 1]),
        laser=np.array([1, UNLABELLED]),
    )

    picture = overlay(empty(), detection(stripes=stripes))

    assert picture[100, [50, 51]].tolist() == [list(COLORS[1])] * 2
    assert picture[150, 80].tolist() == list(UNLABELLED_COLOR)


def test_segments_run_from_start_to_end():
    segments = Segments(start_px=np.array([[20.0, 100]]), end_px=np.array([[120.0, 100]]), support=np.array([100]))

    picture = overlay(empty(), detection(segments=segments))

    np.testing.assert_allclose(picture[100, 21:120], np.tile(SEGMENT_COLOR, (99, 1)), atol=40)
    assert not picture[100, 125:].any()


def test_break_point_is_marked_where_it_is():
    picture = overlay(empty(), detection(break_points([150.0, 100.0])))

    picture[:60] = 0  # the title
    drawn = np.argwhere(np.abs(picture[:, :158].astype(int) - COLORS[1]).max(axis=2) < 60)
    np.testing.assert_allclose(picture[100, 150], COLORS[1], atol=5)
    np.testing.assert_allclose(drawn.mean(axis=0), [100, 150], atol=1)


@pytest.mark.parametrize("variance_px2", [0.25, np.nan])
def test_a_larger_error_has_a_larger_ellipse_and_an_unknown_one_none(variance_px2):
    def reach(variance: float) -> int:
        picture = overlay(empty(), detection(break_points([150.0, 100.0], variance)))
        return int(np.flatnonzero(picture[60:, 140:160].any(axis=(1, 2))).max()) + 60

    assert (reach(variance_px2) > reach(0.01)) == (variance_px2 == 0.25)


def test_flags_are_written_beside_the_point():
    plain = overlay(empty(), detection(break_points([150.0, 100.0])))
    flagged = overlay(empty(), detection(break_points([150.0, 100.0], flags=BreakPointFlag.SATURATED)))

    changed = np.argwhere((plain != flagged).any(axis=2))
    assert len(changed) > 20
    assert changed[:, 1].min() > 150


def test_points_of_the_ring_edges_are_dashes_along_the_edge():
    edges = RingEdgePoints(
        position_px=np.array([[100.0, 120.0], [200.0, 120.0]]),
        normal=np.array([[1.0, 0.0], [0.0, 1.0]]),
        sigma_px=np.ones(2),
        edge=np.array([0, 1]),
    )

    picture = overlay(empty(), detection(ring_edges=edges))

    np.testing.assert_allclose(picture[[118, 122], 100], [EDGE_COLORS[0]] * 2, atol=25)
    np.testing.assert_allclose(picture[120, [198, 202]], [EDGE_COLORS[1]] * 2, atol=25)
