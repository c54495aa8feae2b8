"""The line detector: where it cuts, how near its segments come."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtr

from ringpose.detect.line_segments import Chains, SegmentParameters, find_segments, straight_pieces
from ringpose.types.options import SegmentMethod

RIGHT, DOWN, UP, RISING, FALLING = (1, 0), (0, 1), (0, -1), (1, -1), (1, 1)
SHARES_OFF = 3.0
LENGTH_OFF = 1e9


def chain(*steps):
    """One chain of these steps."""
    pixels = np.cumsum([(0, 0), *steps], axis=0, dtype=np.int32)
    return Chains(pixels=pixels, starts=np.array([0, len(pixels)], np.int32))


def shallow(steps, count):
    """`count` times the flat line that rises or falls one pixel in three."""
    return [*steps, RIGHT, RIGHT] * count


def pieces_of(chain, **parameters):
    parameters = SegmentParameters(**parameters)
    return straight_pieces(chain, parameters, parameters.shortest_px).tolist()


CORNER = chain(*[RIGHT] * 40, *[DOWN] * 40)
SLOPE = chain(*[RIGHT, DOWN] * 40)
ROOF = chain(*shallow([RISING], 30), *shallow([FALLING], 30))


def test_a_corner_is_cut_within_half_a_window():
    first, second = pieces_of(CORNER)

    assert first[0] == 0
    assert second[1] == 80
    assert first[1] == second[0]
    assert abs(first[1] - 40) <= SegmentParameters().window_steps / 2


def test_a_slope_with_the_counts_of_the_corner_is_not_cut():
    assert pieces_of(SLOPE) == [[0, 80]]


def test_the_length_condition_alone_does_not_see_a_monotone_corner():
    assert pieces_of(CORNER, share_change=SHARES_OFF) == [[0, 80]]


def test_the_direction_shares_alone_do_not_see_a_roof():
    assert pieces_of(ROOF, deviation_px=LENGTH_OFF) == [[0, 180]]


def test_a_hairpin_is_cut_where_it_turns():
    first, second = pieces_of(chain(*[RIGHT] * 30, UP, *[(-1, 0)] * 30), share_change=SHARES_OFF)

    assert abs(first[1] - 30) <= 1
    assert second[1] == 61


@pytest.mark.parametrize("slope", np.linspace(-3, 3, 13))
def test_a_digital_line_of_any_slope_is_one_piece(slope):
    t = np.arange(120) / max(1, abs(slope))
    pixels = np.round(np.stack([t, slope * t], axis=1)).astype(np.int32)
    line = Chains(pixels=pixels, starts=np.array([0, 120], np.int32))

    assert pieces_of(line) == [[0, 119]]


def test_a_circle_is_cut_into_many_pieces():
    angle = np.linspace(0, 2 * np.pi, 4000)
    pixels = np.round(60 * np.stack([np.cos(angle), np.sin(angle)], axis=1)).astype(np.int32)
    pixels = pixels[np.r_[True, np.diff(pixels, axis=0).any(axis=1)]]
    circle = Chains(pixels=pixels, starts=np.array([0, len(pixels)], np.int32))

    assert len(pieces_of(circle)) >= 6


def test_pieces_shorter_than_the_threshold_are_dropped():
    assert pieces_of(CORNER, shortest_px=60) == []


def half_plane(angle_rad, offset_px, shape=(90, 110), blur_px=0.8):
    """Bright on one side of the line normal @ (x, y) = normal @ centre + offset; exact at pixel centres."""
    row, column = np.indices(shape)
    normal = np.array([np.cos(angle_rad), np.sin(angle_rad)])
    distance = normal[0] * (column - 55) + normal[1] * (row - 45) - offset_px
    return np.round(30 + 160 * ndtr(distance / blur_px)).astype(np.uint8), normal


def distances_px(segments, normal, offset_px):
    """Signed distance of all segment ends from the line of `half_plane`."""
    ends = np.concatenate([segments.start_px, segments.end_px])
    return (ends - [55, 45]) @ normal - offset_px


angles = st.floats(0, 2 * np.pi)
offsets = st.floats(-6, 6)


@given(angle_rad=angles, offset_px=offsets)
def test_the_chord_of_an_edge_is_within_a_pixel_of_it(angle_rad, offset_px):
    image, normal = half_plane(angle_rad, offset_px)

    segments = find_segments(image, method=SegmentMethod.LENGTH)

    assert segments.support.sum() > 60
    assert abs(distances_px(segments, normal, offset_px)).max() < 1.0


@given(angle_rad=angles, offset_px=offsets)
def test_the_refined_line_of_an_edge_is_within_a_tenth_of_a_pixel(angle_rad, offset_px):
    image, normal = half_plane(angle_rad, offset_px)

    segments = find_segments(image, method=SegmentMethod.REFINED)

    assert abs(distances_px(segments, normal, offset_px)).max() < 0.1


@pytest.mark.parametrize(("method", "bias_limit_px"), [(SegmentMethod.LENGTH, 0.05), (SegmentMethod.REFINED, 0.003)])
@pytest.mark.parametrize("angle_rad", [0.0, 0.5 * np.pi, np.pi, 1.5 * np.pi])
def test_lines_along_the_axes_have_no_half_pixel_bias(method, bias_limit_px, angle_rad):
    offsets_px = np.arange(-3, 3, 0.1) + 0.03

    errors_px = []
    for offset_px in offsets_px:
        image, normal = half_plane(angle_rad, offset_px)
        errors_px.extend(distances_px(find_segments(image, method=method), normal, offset_px))

    assert abs(np.mean(errors_px)) < bias_limit_px


@pytest.mark.parametrize(("method", "bias_limit_px"), [(SegmentMethod.LENGTH, 0.1), (SegmentMethod.REFINED, 0.005)])
def test_lines_of_all_directions_have_no_bias_to_their_dark_side(method, bias_limit_px, rng):
    errors_px = []
    for angle_rad, offset_px in rng.uniform([0, -5], [2 * np.pi, 5], (200, 2)):
        image, normal = half_plane(angle_rad, offset_px)
        errors_px.append(distances_px(find_segments(image, method=method), normal, offset_px).mean())

    assert abs(np.mean(errors_px)) < bias_limit_px


def test_the_two_edges_of_a_stripe_lie_about_its_centre(rng):
    row, column = np.indices((80, 300))
    centre_y = 38.3 + 0.03 * column
    stripe = 4 + 170 * np.exp(-0.5 * ((row - centre_y) / 2.5) ** 2)
    noise = rng.normal(0, np.sqrt(1.5**2 + 0.05 * stripe))
    image = np.round(stripe + noise).clip(0, 255).astype(np.uint8)

    segments = find_segments(image, method=SegmentMethod.REFINED)
    long = segments.support > 200
    ends = np.stack([segments.start_px[long], segments.end_px[long]])

    assert long.sum() == 2
    off_px = ends[..., 1] - (38.3 + 0.03 * ends[..., 0])
    assert abs(off_px.mean()) < 0.03


def test_support_counts_the_pixels_of_a_piece():
    image, _ = half_plane(0.0, 0.2)

    segments = find_segments(image, method=SegmentMethod.LENGTH)

    assert segments.support.tolist() == [abs(segments.end_px - segments.start_px).max() + 1]


@pytest.mark.parametrize("method", list(SegmentMethod))
@pytest.mark.parametrize("shape", [(1, 1), (3, 3), (1, 50), (50, 1), (40, 60)])
@pytest.mark.parametrize("value", [0, 255])
def test_a_flat_image_has_no_segments(method, shape, value):
    segments = find_segments(np.full(shape, value, np.uint8), method=method)

    assert (segments.start_px.shape, segments.end_px.shape, segments.support.shape) == ((0, 2), (0, 2), (0,))


def test_an_image_that_is_a_view_gives_the_segments_of_its_copy():
    image, _ = half_plane(0.3, 0.2)

    view, copy = find_segments(image[::2, ::-1]), find_segments(image[::2, ::-1].copy())

    np.testing.assert_array_equal(view.start_px, copy.start_px)


def broken_edge(gap_px, step_px=0.0):
    """A level edge at y = 39.3, dimmed to nothing over a gap from x = 150 on, and moved down by a step behind it."""
    row, column = np.indices((80, 300))
    edge_y = 39.3 + step_px * (column >= 150)
    image = 30 + 160 * ndtr((row - edge_y) / 0.8)
    image[:, 150 : 150 + gap_px] = 110
    return cv2.GaussianBlur(np.round(image).astype(np.uint8), (0, 0), 0.5)


@pytest.mark.parametrize("step_px", [0.0, 0.8])
def test_a_nearly_straight_edge_is_one_refined_segment(step_px):
    segments = find_segments(broken_edge(0, step_px))

    level = abs(segments.start_px - segments.end_px)[:, 1] < 3
    assert level.sum() == 1
    assert abs(segments.start_px - segments.end_px)[level, 0] > 285


def test_an_edge_with_a_step_of_four_pixels_stays_in_two():
    segments = find_segments(broken_edge(0, 4.0))

    level = (abs(segments.start_px - segments.end_px)[:, 0] > 100).sum()
    assert level == 2


def test_lines_across_the_shadow_of_a_ring_are_not_joined():
    segments = find_segments(broken_edge(16))

    x = np.sort(np.concatenate([segments.start_px[:, 0], segments.end_px[:, 0]]))
    assert not ((segments.start_px[:, 0] < 140) & (segments.end_px[:, 0] > 175)).any()
    assert not ((segments.end_px[:, 0] < 140) & (segments.start_px[:, 0] > 175)).any()
    assert x.min() < 140
    assert x.max() > 175


def speckled_stripe(rng):
    """A level stripe whose brightness wavers by 25 % in grains of three pixels."""
    row, _ = np.indices((80, 400))
    grain = cv2.GaussianBlur(rng.normal(size=(80, 400)), (0, 0), 1.0)
    stripe = 170 * np.exp(-0.5 * ((row - 40.2) / 2.5) ** 2) * (1 + 0.25 * grain / grain.std())
    return np.round(stripe + rng.normal(0, 1.5, stripe.shape)).clip(0, 255).astype(np.uint8)


def test_joining_leaves_a_third_of_the_fragments_of_a_speckled_stripe(rng):
    image = speckled_stripe(rng)

    joined, alone = find_segments(image), find_segments(image, SegmentParameters(aside_px=1e-3))

    assert 3 * len(joined.support) < len(alone.support)


@pytest.mark.parametrize("bits", [10, 12, 16])
def test_a_dim_image_of_more_bits_has_the_segments_of_eight(bits):
    eight, _ = half_plane(0.4, 0.3)
    eight //= 8
    wide = eight.astype(np.uint16) << (bits - 8)

    segments = find_segments(wide, saturation_dn=(1 << bits) - 1)

    np.testing.assert_array_equal(segments.start_px, find_segments(eight).start_px)
