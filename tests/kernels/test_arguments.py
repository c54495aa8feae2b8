"""The C kernels refuse what they cannot read, and never reach outside an array."""

import math
from dataclasses import fields, is_dataclass, make_dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from ringpose.detect.break_points import EndParams
from ringpose.detect.edge_search import PlaceParams, ProfileParams, StepParams
from ringpose.detect.stripes import DISTORTION, StripeParams
from ringpose.kernels import _kernels, kernel_record
from ringpose.kernels.lines import SEGMENT_COLUMNS, CandidateParams, Lens, RingParams, SegmentParams, UnionParams

IMAGE = np.zeros((8, 9), np.uint8)
MAGNITUDE = np.zeros((8, 9), np.int16)
ANCHORS = np.array([30], np.int32)
INNER = np.array([30, 31, 32, 39, 40, 41], np.int32)
ORIENTATION = np.zeros(1, np.uint8)
PIXELS = np.zeros((6, 2), np.int32)
STARTS = np.array([0, 6], np.int32)
PIECES = np.array([[0, 5]], np.int32)
FAR_CORNERS = np.array([[-(2**31), 2**31 - 1], [2**31 - 1, -(2**31)]] * 3, np.int32)


MASK = np.zeros((5, 9), np.bool_)
LENS = Lens(fx=900.0, fy=900.0, cx=400.0, cy=300.0, **dict.fromkeys(DISTORTION, 0.0))
PLACES = PlaceParams(image_width=100, image_height=90)
PROFILES = ProfileParams(reach_px=2, inside_px=2, outside_px=2, saturation_dn=255)
STRIPES = StripeParams(min_response=0.2, coarse_per_response=5.0, full_dn=255)
RING = RingParams(focal_x=900.0, focal_y=900.0, principal_x=400.0, principal_y=300.0)
TRACKS = np.zeros((2, len(SEGMENT_COLUMNS)))


def numbers(*shape):
    return np.ones(shape)


def vars_of(record):
    return {each.name: getattr(record, each.name) for each in fields(record)}


CALLS = {
    "gradient": (IMAGE, 8, 100, MAGNITUDE),
    "chains": (MAGNITUDE, ANCHORS, ORIENTATION, 1, 2),
    "cuts": (PIXELS, STARTS, 1.0, 0.7, 8, 12),
    "fits": (MAGNITUDE, PIXELS, PIECES, 0),
    "joins": (np.zeros((1, 4)), np.zeros((1, 6)), PIECES, 8.0, 1.5, 1),
    "stripes": (
        IMAGE,
        IMAGE,
        np.zeros((1, 4), np.int32),
        np.ones((2, 2, 5), np.float32),
        numbers(2, 4),
        STRIPES,
    ),
    "stripe_segments": (
        numbers(3, 2),
        numbers(3),
        np.zeros(3, np.int64),
        np.zeros(1, np.int64),
        LENS,
        SegmentParams(image_width=800, border_px=3.0),
    ),
    "arcs": (numbers(2, 3, 2), np.array([0, 1, 0]), numbers(2, 4)),
    "faces": (TRACKS, 7, numbers(3, 3), None, UnionParams(separation_sigmas=3.0), CandidateParams(), RING),
    "ends": (((IMAGE, IMAGE, numbers(2, 5)),), LENS, EndParams(saturation_dn=255)),
    "edge_places": (
        numbers(5, 3),
        numbers(5, 3),
        numbers(5),
        numbers(5),
        numbers(1, 3),
        numbers(7, 5),
        np.zeros((7, 7)),
        LENS,
        PLACES,
    ),
    "edge_profiles": (
        IMAGE,
        numbers(5, 2),
        numbers(5, 2),
        PROFILES,
        numbers(5, 9),
        MASK.copy(),
        numbers(5),
    ),
    "edge_steps": (
        numbers(5, 9),
        MASK,
        numbers(5),
        numbers(9),
        numbers(4),
        numbers(4),
        numbers(3, 9, 4),
        StepParams(),
    ),
}
"""Arguments that each kernel takes."""

ARRAYS = [(name, i) for name, call in CALLS.items() for i, each in enumerate(call) if isinstance(each, np.ndarray)]
RECORDS = [(name, i) for name, call in CALLS.items() for i, each in enumerate(call) if is_dataclass(each)]
FILLED = [("gradient", 3), ("chains", 0), ("arcs", 2), *(("edge_profiles", i) for i in (4, 5))]


def call(name, i, changed):
    arguments = [each.copy() if isinstance(each, np.ndarray) else each for each in CALLS[name]]
    arguments[i] = changed
    return getattr(_kernels, name)(*arguments)


def read_only(array):
    """A copy that must not be written to."""
    copy = array.copy()
    copy.flags.writeable = False
    return copy


@pytest.mark.parametrize("name", CALLS)
def test_fitting_arguments_are_taken_and_others_in_number_are_not(name):
    call(name, 0, CALLS[name][0])

    with pytest.raises(TypeError, match=f"takes {len(CALLS[name])} arguments"):
        getattr(_kernels, name)(*CALLS[name][:-1])


@pytest.mark.parametrize(("name", "i"), ARRAYS)
@pytest.mark.parametrize("other", [np.complex128, np.uint32, "S3", None])
def test_an_array_of_another_type_is_a_type_error(name, i, other):
    with pytest.raises(TypeError):
        call(name, i, np.zeros(CALLS[name][i].shape, other) if other else [1, 2])


@pytest.mark.parametrize(("name", "i"), ARRAYS)
def test_an_array_of_other_axes_or_layout_is_a_value_error(name, i):
    array = CALLS[name][i]
    strided = np.repeat(array, 2, axis=-1)[..., ::2]

    for changed in (array[None], array[0], strided):
        if changed.shape != array.shape or not changed.flags.c_contiguous:
            with pytest.raises(ValueError, match=r"axes|contiguous"):
                call(name, i, changed)


@pytest.mark.parametrize(("name", "i"), ARRAYS)
def test_extents_that_do_not_fit_the_other_arrays_are_a_value_error(name, i):
    array, refused = CALLS[name][i], 0
    for axis in range(array.ndim):
        try:
            call(name, i, np.ascontiguousarray(np.concatenate([array, array], axis=axis)))
        except ValueError:
            refused += 1

    free = {("cuts", 0), ("cuts", 1), ("fits", 1), ("fits", 2), ("stripes", 2), ("stripes", 3)}
    free |= {("faces", 0), ("faces", 2), ("stripe_segments", 3), ("fits", 0), ("chains", 0), ("edge_profiles", 0)}
    assert refused == array.ndim or (name, i) in free


@pytest.mark.parametrize(("name", "i"), RECORDS)
def test_records_are_read_by_the_names_of_their_numbers(name, i):
    numbers = vars_of(CALLS[name][i])
    reversed_order = SimpleNamespace(**dict(reversed(numbers.items())))

    call(name, i, reversed_order)

    for number, value in numbers.items():
        for changed in ("x", None, *([value + 0.5] if isinstance(value, int) else [])):
            with pytest.raises(TypeError, match=f"{number} of a {type(CALLS[name][i]).__name__} must be"):
                call(name, i, SimpleNamespace(**{**numbers, number: changed}))
        with pytest.raises(ValueError, match=f"{number}: is nan" if isinstance(value, float) else f"{number}: is -1"):
            call(name, i, SimpleNamespace(**{**numbers, number: math.nan if isinstance(value, float) else -1}))
        with pytest.raises(TypeError, match=number):
            call(name, i, SimpleNamespace(**{other: numbers[other] for other in numbers if other != number}))


@pytest.mark.parametrize(("name", "kind"), [("spacing_px", int), ("spacing_pixels", float)])
def test_a_data_class_that_differs_from_its_c_struct_is_a_type_error(name, kind):
    numbers = [(each.name, each.type) for each in fields(StepParams) if each.name != "spacing_px"]

    with pytest.raises(TypeError, match=rf"StepParams: differs from the C struct in .*\b{name}"):
        kernel_record(make_dataclass("StepParams", [*numbers, (name, kind)]))

    assert kernel_record(make_dataclass("StepParams", [("spacing_px", float), *numbers]))


@pytest.mark.parametrize(("name", "i"), FILLED)
def test_an_array_that_cannot_be_filled_is_a_value_error(name, i):
    with pytest.raises(ValueError, match="writable"):
        call(name, i, read_only(CALLS[name][i]))


def changed(array, place, value):
    copy = array.copy()
    copy[place] = value
    return copy


FIGURES = CALLS["stripes"][4]
OUT_OF_RANGE = {
    "image without pixels": [
        (name, 0, np.zeros(shape, np.uint8), r"2\^31|extent")
        for name in ("stripes", "edge_profiles", "gradient")
        for shape in ((0, 9), (8, 0))
    ],
    "dark frame of another depth": [
        ("stripes", 1, IMAGE.astype(np.uint16), "dark"),
        ("ends", 0, ((IMAGE, IMAGE.astype(np.uint16), numbers(2, 5)),), "dark"),
    ],
    "image of ends": [
        ("ends", 0, [], "images: must be a tuple"),
        ("ends", 0, (IMAGE,), "takes 3 arguments"),
        ("ends", 0, ((IMAGE, IMAGE[:4], numbers(2, 5)),), "dark: has extent"),
        ("ends", 0, ((np.zeros((0, 9), np.uint8), None, numbers(2, 5)),), r"2\^31"),
        ("ends", 0, ((IMAGE, None, numbers(2, 4)),), "lines: has extent"),
    ],
    "filter": [
        ("stripes", 4, changed(FIGURES, (1, figure), value), "filters")
        for figure, value in ((0, 0.0), (0, np.nan), (1, 0.0), (1, 41.0), (1, np.nan), (1, 5.0), (2, -1.0))
    ],
    "stripe parameter": [
        ("stripes", 5, replace(STRIPES, **{number: value}), f"params.{number}: is")
        for number, value in (
            ("begin_sigmas", -1.0),
            ("continue_sigmas", math.nan),
            ("min_response", 0.0),
            ("coarse_per_response", -1.0),
            ("gap", -1),
            ("gap", 1001),
            ("shortest", 0),
        )
    ],
    "arc": [("arcs", 1, np.array(arc), "arc: ") for arc in ([0, 0, 0], [0, 1, 2], [0, 1, -1])],
    "anchor threshold": [("gradient", 2, upper, "upper") for upper in (0, -1, 32768, 10**9)],
    "bits": [("gradient", 1, bits, "bits") for bits in (7, 17, 10**9)],
    "bits for other elements": [("gradient", 1, 9, "image"), ("gradient", 0, IMAGE.astype(np.uint16), "image")],
    "anchor on the margin or outside": [
        ("chains", 1, np.array([anchor], np.int32), "anchors: number 0 has no gradient")
        for anchor in (-1, 0, 26, 29, 33, 48, 72, 2**31 - 1)
    ],
    "anchor on a negative magnitude": [("chains", 0, np.full((8, 9), -5, np.int16), "a negative one")],
    "walk limit": [("chains", *limit, "must be") for limit in ((3, 0), (3, 32768), (4, 0))],
    "start": [("cuts", 1, np.array(starts, np.int32), "starts") for starts in ([], [0, 7], [-1, 6], [4, 2, 6])],
    "cut limit": [("cuts", *limit, "must be") for limit in ((4, 1), (5, 1), (4, 2**31))],
    "piece": [("fits", 2, np.array([piece], np.int32), "pieces: number 0") for piece in ([-1, 3], [3, 2], [0, 6])],
    "joining limit": [
        ("joins", number, value, "gap, aside")
        for number, value in ((3, -1.0), (4, 0.0), (3, np.nan), (4, np.nan), (3, np.inf), (4, 1e7))
    ],
}


@pytest.mark.parametrize("what", OUT_OF_RANGE)
def test_values_out_of_range_are_rejected_by_name(what):
    for name, i, value, words in OUT_OF_RANGE[what]:
        with pytest.raises((ValueError, TypeError), match=words):
            call(name, i, value)


def test_a_single_filter_is_a_value_error():
    taps, filters = np.ones((1, 2, 5), np.float32), numbers(1, 4)

    with pytest.raises(ValueError, match="filters"):
        _kernels.stripes(IMAGE, None, None, taps, filters, STRIPES)


def test_an_image_of_more_pixels_than_an_index_can_count_is_a_value_error():
    image = np.empty((1 << 16, 1 << 15), np.uint8)

    with pytest.raises(ValueError, match="2\\^31"):
        _kernels.gradient(image, 8, 100, MAGNITUDE)


def test_a_magnitude_that_is_strong_up_to_the_border_keeps_the_walks_inside():
    magnitude = np.full((8, 9), 7, np.int16)

    pixels, _ = _kernels.chains(magnitude, INNER, np.zeros(len(INNER), np.uint8), 1, 1)

    walked = np.frombuffer(pixels, np.int32).reshape(-1, 2)
    assert sorted(map(tuple, walked.tolist())) == [(x, y) for x in (3, 4, 5) for y in (3, 4)]
    assert (magnitude == 7).all()


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


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300, -1e300])
def test_joining_takes_wild_ends_without_a_crash(value):
    lines = np.full((40, 4), value)
    lines[::3] = 5.0
    pieces = np.tile(np.array([[0, 9]], np.int32), (40, 1))

    joined, support = _kernels.joins(lines, np.ones((40, 6)), pieces, 8.0, 1.5, 1)

    assert len(joined) == 4 * len(support)
