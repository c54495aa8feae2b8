"""The C kernels refuse what they cannot read, and never reach outside an array."""

import numpy as np
import pytest

from ringpose.kernels import _kernels

IMAGE = np.zeros((8, 9), np.uint8)
MAGNITUDE = np.zeros((8, 9), np.int16)
ANCHORS = np.array([30], np.int32)
INNER = np.array([30, 31, 32, 39, 40, 41], np.int32)
ORIENTATION = np.zeros(1, np.uint8)
PIXELS = np.zeros((6, 2), np.int32)
STARTS = np.array([0, 6], np.int32)
PIECES = np.array([[0, 5]], np.int32)
FAR_CORNERS = np.array([[-(2**31), 2**31 - 1], [2**31 - 1, -(2**31)]] * 3, np.int32)


def read_only(array):
    """A copy that nobody may write to."""
    copy = array.copy()
    copy.flags.writeable = False
    return copy


@pytest.mark.parametrize("image", [None, 3, [[1, 2]], IMAGE.astype(np.uint16), IMAGE.astype(np.int8)])
def test_an_image_of_another_type_is_a_type_error(image):
    with pytest.raises(TypeError):
        _kernels.gradient(image, 8, 100, MAGNITUDE)


@pytest.mark.parametrize("image", [IMAGE[:, ::2], IMAGE.T, IMAGE[0], IMAGE[None], IMAGE[:0], IMAGE[:-1]])
def test_an_image_of_another_shape_or_layout_is_a_value_error(image):
    with pytest.raises(ValueError, match="image"):
        _kernels.gradient(image, 8, 100, MAGNITUDE)


@pytest.mark.parametrize("magnitude", [read_only(MAGNITUDE), np.zeros((16, 18), np.int16)[::2, ::2]])
def test_a_magnitude_that_cannot_be_filled_is_a_value_error(magnitude):
    with pytest.raises(ValueError, match="magnitude"):
        _kernels.gradient(IMAGE, 8, 100, magnitude)


@pytest.mark.parametrize("upper", [0, -1, 32768, 10**9])
def test_a_threshold_outside_sixteen_bits_is_a_value_error(upper):
    with pytest.raises(ValueError, match="upper"):
        _kernels.gradient(IMAGE, 8, upper, MAGNITUDE)


def test_an_image_of_more_pixels_than_an_index_can_count_is_a_value_error():
    image = np.empty((1 << 16, 1 << 15), np.uint8)

    with pytest.raises(ValueError, match="2\\^31"):
        _kernels.gradient(image, 8, 100, MAGNITUDE)


@pytest.mark.parametrize("bits", [7, 17, 10**9])
def test_bits_out_of_range_are_a_value_error(bits):
    with pytest.raises(ValueError, match="bits"):
        _kernels.gradient(IMAGE, bits, 100, MAGNITUDE)


@pytest.mark.parametrize(("image", "bits"), [(IMAGE, 9), (IMAGE.astype(np.uint16), 8)])
def test_bits_that_do_not_go_with_the_elements_are_a_type_error(image, bits):
    with pytest.raises(TypeError, match="image"):
        _kernels.gradient(image, bits, 100, MAGNITUDE)


@pytest.mark.parametrize("anchor", [-1, 0, 26, 29, 33, 48, 72, 2**31 - 1])
def test_an_anchor_outside_the_image_or_on_its_margin_is_a_value_error(anchor):
    with pytest.raises(ValueError, match="anchors: number 0 has no gradient"):
        _kernels.chains(MAGNITUDE.copy(), np.array([anchor], np.int32), ORIENTATION, 1, 2)


def test_an_anchor_on_a_negative_magnitude_is_a_value_error():
    with pytest.raises(ValueError, match="a negative one"):
        _kernels.chains(np.full((8, 9), -5, np.int16), ANCHORS, ORIENTATION, 1, 2)


def test_anchors_without_orientation_are_a_value_error():
    with pytest.raises(ValueError, match="orientation"):
        _kernels.chains(MAGNITUDE.copy(), ANCHORS, ORIENTATION[:0], 1, 2)


@pytest.mark.parametrize("limits", [(0, 2), (32768, 2), (1, 0)])
def test_walk_limits_out_of_range_are_a_value_error(limits):
    with pytest.raises(ValueError, match="must be"):
        _kernels.chains(MAGNITUDE.copy(), ANCHORS, ORIENTATION, *limits)


def test_a_magnitude_that_is_strong_up_to_the_border_keeps_the_walks_inside():
    magnitude = np.full((8, 9), 7, np.int16)

    pixels, _ = _kernels.chains(magnitude, INNER, np.zeros(len(INNER), np.uint8), 1, 1)

    walked = np.frombuffer(pixels, np.int32).reshape(-1, 2)
    assert sorted(map(tuple, walked.tolist())) == [(x, y) for x in (3, 4, 5) for y in (3, 4)]
    assert (magnitude == 7).all()


@pytest.mark.parametrize("starts", [[], [0, 7], [-1, 6], [4, 2, 6]])
def test_starts_that_do_not_ascend_within_the_pixels_are_a_value_error(starts):
    with pytest.raises(ValueError, match="starts"):
        _kernels.cuts(PIXELS, np.array(starts, np.int32), 1.0, 0.7, 8, 12)


@pytest.mark.parametrize("rules", [(1, 12), (8, 1), (2**31, 12)])
def test_cut_rules_out_of_range_are_a_value_error(rules):
    with pytest.raises(ValueError, match="must be"):
        _kernels.cuts(PIXELS, STARTS, 1.0, 0.7, *rules)


@pytest.mark.parametrize("deviation", [-1.0, 0.0, float("nan"), float("inf")])
def test_cutting_ends_even_on_a_chain_that_stands_still(deviation):
    pieces = _kernels.cuts(PIXELS, STARTS, deviation, 0.7, 2, 2)

    assert len(pieces) > 0


def test_cutting_takes_the_largest_coordinates_there_and_back():
    pieces = _kernels.cuts(FAR_CORNERS, STARTS, 1.0, 0.7, 2, 2)

    assert np.frombuffer(pieces, np.int32).tolist() == [0, 1, 1, 2, 2, 3, 3, 4, 4, 5]


def test_fitting_takes_the_largest_coordinates_as_chords():
    lines, _ = _kernels.fits(MAGNITUDE, FAR_CORNERS, PIECES, 0)

    assert np.frombuffer(lines).tolist() == [-(2.0**31), 2.0**31 - 1, 2.0**31 - 1, -(2.0**31)]


@pytest.mark.parametrize("piece", [[-1, 3], [3, 2], [0, 6]])
def test_a_piece_outside_the_pixels_is_a_value_error(piece):
    with pytest.raises(ValueError, match="pieces: number 0"):
        _kernels.fits(MAGNITUDE, PIXELS, np.array([piece], np.int32), 0)


@pytest.mark.parametrize("pixels", [PIXELS[:, :1].copy(), np.zeros((6, 3), np.int32)])
def test_pixels_that_are_no_pairs_are_a_value_error(pixels):
    with pytest.raises(ValueError, match="pixels: must be pairs"):
        _kernels.fits(MAGNITUDE, pixels, PIECES, 0)


LINES = np.zeros((1, 4))
MOMENTS = np.zeros((1, 6))


@pytest.mark.parametrize("rules", [(-1.0, 1.0), (1.0, 0.0), (np.nan, 1.0), (1.0, np.nan), (np.inf, 1.0), (1.0, 1e7)])
def test_joining_rules_out_of_range_are_a_value_error(rules):
    with pytest.raises(ValueError, match="gap, aside"):
        _kernels.joins(LINES, MOMENTS, PIECES, *rules, 1)


@pytest.mark.parametrize(
    ("lines", "moments", "pieces"),
    [(LINES[:, :2].copy(), MOMENTS, PIECES), (LINES, MOMENTS[:, :5].copy(), PIECES), (LINES, MOMENTS, PIECES[:0])],
)
def test_joining_tables_of_other_shapes_is_a_value_error(lines, moments, pieces):
    with pytest.raises(ValueError, match="equal lengths"):
        _kernels.joins(lines, moments, pieces, 8.0, 1.5, 1)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300, -1e300])
def test_joining_takes_wild_ends_without_a_crash(value):
    lines = np.full((40, 4), value)
    lines[::3] = 5.0
    pieces = np.tile(np.array([[0, 9]], np.int32), (40, 1))

    joined, support = _kernels.joins(lines, np.ones((40, 6)), pieces, 8.0, 1.5, 1)

    assert len(joined) == 4 * len(support)
