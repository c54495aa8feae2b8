"""What is lit, frame by frame."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ringpose.errors import UsageError
from ringpose.types.session import MAX_LASERS, Step, parsed_sequence, steps_of, written_sequence

numbers = st.sets(st.integers(1, MAX_LASERS), min_size=1)


def test_the_default_sequence_lights_one_laser_after_the_other():
    steps = parsed_sequence("off,1,2,3,off")

    assert [step.mask(3) for step in steps] == [0, 0b001, 0b010, 0b100, 0]


def test_all_is_every_laser_of_the_rig():
    assert [Step("all").mask(count) for count in (1, 3, 8)] == [0b1, 0b111, 0b11111111]


@given(numbers)
def test_joined_numbers_set_just_their_bits(wanted):
    (step,) = parsed_sequence("+".join(map(str, sorted(wanted))))

    assert {bit + 1 for bit in range(MAX_LASERS) if step.mask(MAX_LASERS) >> bit & 1} == wanted


def test_spaces_around_the_commas_do_no_harm():
    assert parsed_sequence("off, all") == parsed_sequence("off,all")


@pytest.mark.parametrize(
    "text", ["", "off,", ",1", "on", "0", "01", "1+", "+1", "1++2", "1 2", "-1", "OFF", "off+1", "1;2", "1.0", "٣"]
)
def test_a_word_that_is_not_a_step_is_a_usage_error(text):
    with pytest.raises(UsageError, match="laser numbers from 1 joined by"):
        parsed_sequence(text)


def test_a_laser_named_twice_is_wrong_usage():
    with pytest.raises(UsageError, match='step 2, "1\\+1", names a laser twice'):
        parsed_sequence("off,1+1")


def test_a_ninth_laser_does_not_fit_into_a_mask():
    with pytest.raises(UsageError, match="beyond the 8"):
        parsed_sequence("9")


@pytest.mark.parametrize("text", ["4", "1+4"])
def test_a_fourth_laser_of_three_is_wrong_usage(text):
    (step,) = parsed_sequence(text)

    with pytest.raises(UsageError, match="names laser 4 of a rig with 3 lasers"):
        step.mask(3)


@given(st.lists(st.integers(0, 7), min_size=1))
def test_masks_come_back_from_the_steps_that_light_them(masks):
    assert [step.mask(3) for step in steps_of(masks, 3)] == masks


def test_masks_read_as_a_user_would_write_them():
    assert [step.text for step in steps_of([0, 1, 2, 4, 5, 7], 3)] == ["off", "1", "2", "3", "1+3", "all"]


@pytest.mark.parametrize(
    ("text", "exposure_s"), [("1@500us", 500e-6), ("all@4ms", 4e-3), ("off@0.5s", 0.5), ("2", None)]
)
def test_a_step_may_have_an_exposure_of_its_own(text, exposure_s):
    (step,) = parsed_sequence(text)

    assert step.exposure_s == pytest.approx(exposure_s)
    assert written_sequence([step]) == text


@pytest.mark.parametrize(
    "text", ["1@", "1@4", "1@ms", "1@-4ms", "1@0ms", "1@4 ms", "1@1e3us", "1@4m", "off@@4ms", "1@nans"]
)
def test_an_exposure_without_number_or_unit_is_wrong_usage(text):
    with pytest.raises(UsageError, match="write it as 500us"):
        parsed_sequence(text)
