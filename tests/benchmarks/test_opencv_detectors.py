"""All detectors speak of the same pixels."""

import numpy as np
import pytest
from benchmarks.opencv_detectors import GIVES_CENTERS, DetectorName, detector, segments_of, stripe_segments
from scipy.special import ndtr

from ringpose.types.detection import UNLABELLED, Stripes

EDGE_DETECTORS = [name for name in DetectorName if name not in GIVES_CENTERS]
ALONG_X, ALONG_Y = (0.03, 1.0), (1.0, -0.04)
"""Normals (not yet of unit length) of an edge that runs nearly along the rows, and one nearly along the columns."""

SLACK_PX = {DetectorName.LSD: 0.05, DetectorName.REFINED: 0.05, DetectorName.LENGTH: 1.5, DetectorName.HOUGH: 1.0}
"""What a chord of whole pixels, or votes for whole pixels, may be off by; the others fit lines."""


def distance_px(points, normal):
    """Signed distances from the edge, which passes through (120.3, 90.2)."""
    return (points - np.array([120.3, 90.2])) @ (normal / np.hypot(*normal))


def edge_image(normal):
    """From 40 to 160 grey values across a straight edge, blurred by one pixel."""
    row, column = np.mgrid[0:180, 0:240].astype(np.float64)
    value = 40 + 120 * ndtr(distance_px(np.stack([column, row], axis=-1), normal))
    return np.rint(value).astype(np.uint8)


@pytest.mark.parametrize("normal", [ALONG_X, ALONG_Y])
@pytest.mark.parametrize("name", EDGE_DETECTORS)
def test_every_detector_finds_an_edge_where_it_is(name, normal):
    segments = detector(name)(edge_image(normal))

    length = np.hypot(*(segments.end_px - segments.start_px).T)
    middle = (segments.start_px + segments.end_px)[np.argmax(length)] / 2
    assert length.max() > (25 if name == DetectorName.HOUGH else 100)
    assert abs(distance_px(middle, normal)) < SLACK_PX.get(name, 0.35)


@pytest.mark.parametrize("shape", [(100, 120), (1, 1), (5, 50), (50, 5), (6, 6)])
@pytest.mark.parametrize("name", DetectorName)
def test_an_empty_image_has_no_segments(name, shape):
    segments = detector(name)(np.zeros(shape, np.uint8))

    assert (segments.start_px.shape, segments.end_px.shape, segments.support.shape) == ((0, 2), (0, 2), (0,))


@pytest.mark.parametrize("shape", [(2, 4), (2, 1, 4)])
def test_lines_of_both_opencv_versions_are_the_same_segments(shape):
    lines = np.array([1, 2, 11, 2, 5, 5, 5, 9], np.float32).reshape(shape)

    segments = segments_of(lines, shift_px=0.5)

    assert segments.start_px.tolist() == [[1.5, 2.5], [5.5, 5.5]]
    assert segments.end_px.tolist() == [[11.5, 2.5], [5.5, 9.5]]
    assert segments.support.tolist() == [11, 5]


def test_no_lines_are_no_segments():
    assert len(segments_of(None).support) == 0


def stripes_of(*pieces):
    position = np.concatenate([np.asarray(piece, dtype=np.float64) for piece in pieces])
    return Stripes(
        position_px=position,
        sigma_px=np.full(len(position), 0.1),
        peak_dn=np.full(len(position), 100.0),
        piece=np.repeat(np.arange(len(pieces)), [len(piece) for piece in pieces]),
        laser=np.full(len(pieces), UNLABELLED),
    )


def test_a_straight_stripe_is_one_segment_from_its_first_to_its_last_center():
    x = np.array([10.0, 11.0, 13.0, 20.0])
    first = np.column_stack([x, 5 + 0.25 * x])
    second = np.column_stack([x + 30, 80 - 0.1 * x])

    segments = stripe_segments(stripes_of(first, second))

    assert segments.start_px == pytest.approx(np.array([first[0], second[0]]), abs=1e-12)
    assert segments.end_px == pytest.approx(np.array([first[-1], second[-1]]), abs=1e-12)
    assert segments.support.tolist() == [4, 4]


def test_a_stripe_of_one_column_is_a_segment_without_length():
    segments = stripe_segments(stripes_of([(7.0, 3.5)]))

    assert segments.start_px.tolist() == segments.end_px.tolist() == [[7.0, 3.5]]


def test_the_stripe_detector_runs_along_the_middle(rng):
    row, column = np.mgrid[0:60, 0:200].astype(np.float64)
    stripe = 120 * np.exp(-0.5 * ((row - 30.3 - 0.02 * column) / 2.2) ** 2)
    noisy = np.clip(np.rint(stripe + rng.normal(scale=1.5, size=stripe.shape)), 0, 255).astype(np.uint8)

    segments = detector(DetectorName.STRIPES)(noisy)

    assert len(segments.support) == 1
    assert segments.start_px[0, 1] - 0.02 * segments.start_px[0, 0] == pytest.approx(30.3, abs=0.02)
