import math

import numpy as np
import pytest

from ringpose.errors import DataError
from ringpose.files.schema import Fields


def fields(**values):
    return Fields("rig.yaml", values)


def message_of(action) -> str:
    with pytest.raises(DataError) as caught:
        action()
    return str(caught.value)


def test_a_location_has_the_file_and_the_path_to_the_key():
    laser = list(Fields("rig.yaml", {"lasers": [{}, {"name": 3}]}).each("lasers"))[1]

    assert message_of(lambda: laser.text("name")) == "rig.yaml: lasers[1].name: is 3, must be a text"


def test_an_unknown_key_is_rejected_with_the_closest_known_one():
    line = message_of(lambda: Fields("rig.yaml", {"distnace_m": 1}, ("distance_m", "normal")))

    assert line == "rig.yaml: unknown key 'distnace_m'; did you mean 'distance_m'?"


def test_an_unknown_key_without_a_close_one_is_rejected_with_the_free_prefix():
    assert "begin it with x_" in message_of(lambda: Fields("rig.yaml", {"colour": 1}, ("distance_m",)))


@pytest.mark.parametrize(
    ("values", "is_like"),
    [
        ({"image_width": 1, "camera_matrix": {}}, "a camera"),
        ({"camera": {}, "lasers": []}, "a rig"),
        ({"rig": "rig.yaml", "trajectory": []}, "a scene"),
        ({"kind": "charuco"}, "a board"),
    ],
)
def test_a_file_of_another_kind_is_reported(values, is_like):
    line = message_of(lambda: Fields("mount.yaml", values, ("mount",)))

    assert line.endswith(f"; this looks like {is_like}, give another file")


def test_keys_with_the_free_prefix_are_accepted():
    assert Fields("rig.yaml", {"x_colour": 1}, ("name",)).values == {"x_colour": 1}


def test_a_missing_key_is_reported_with_a_similar_one():
    assert message_of(lambda: fields(normall=1).raw("normal")) == (
        "rig.yaml: has no key 'normal'; did you mean 'normal' instead of 'normall'?"
    )


@pytest.mark.parametrize("value", [math.nan, math.inf, True, "1", None, [1.0]])
def test_a_value_that_is_not_a_finite_number_is_rejected(value):
    assert "rig.yaml: a" in message_of(lambda: fields(a=value).number("a"))


@pytest.mark.parametrize("value", [1.5, True, "3", None])
def test_a_value_that_is_not_a_whole_number_is_rejected(value):
    assert "rig.yaml: a" in message_of(lambda: fields(a=value).integer("a"))


def test_a_number_out_of_range_is_reported_with_the_range():
    assert message_of(lambda: fields(a=7).number("a", least=0, most=5)).endswith(
        "is 7, must be at least 0 and at most 5"
    )


def test_a_number_below_its_minimum_is_reported_with_the_minimum():
    assert message_of(lambda: fields(a=-1).integer("a", least=1)).endswith("is -1, must be at least 1")


@pytest.mark.parametrize("value", [-39.5, 5.1])
def test_a_length_in_millimetres_is_rejected_with_a_hint(value):
    assert "give metres; this looks like millimetres" in message_of(lambda: fields(a=value).length_m("a"))


def test_lengths_of_either_sign_up_to_five_metres_are_accepted():
    assert fields(a=-5.0).length_m("a") == -5.0


@pytest.mark.parametrize("value", [[1, 2], [1, 2, "3"], [1, 2, True], [[1, 2, 3]], 3.0, [1, 2, math.nan], [1, 2, None]])
def test_a_value_that_is_not_a_vector_of_three_is_rejected(value):
    assert "rig.yaml: a" in message_of(lambda: fields(a=value).vector("a", 3))


def test_a_ragged_matrix_is_rejected():
    assert "must be n x 2 numbers" in message_of(lambda: fields(a=[[1, 2], [3]]).array("a", (None, 2)))


def test_null_in_an_array_is_nan_where_that_is_allowed():
    array = fields(a=[[1, None], [3, 4]]).array("a", (2, 2), allow_nan=True)

    np.testing.assert_array_equal(array, [[1, math.nan], [3, 4]])


def test_empty_list_has_any_length():
    assert fields(a=[]).array("a", (None, 2)).shape == (0, 2)


def test_a_wrong_choice_is_reported_with_the_allowed_words():
    line = message_of(lambda: fields(a="charucco").choice("a", ("charuco", "chessboard")))

    assert line == "rig.yaml: a: is 'charucco', must be one of charuco, chessboard; did you mean 'charuco'?"


def test_a_known_key_is_not_suggested_as_a_misspelling_of_a_missing_one():
    fields = Fields("x.yaml", {"image_height": 480, "imge_width": 640}, None)
    fields.known = ("image_height", "image_width")

    with pytest.raises(DataError, match="did you mean 'image_width' instead of 'imge_width'"):
        fields.raw("image_width")


def test_known_keys_are_not_misspellings():
    with pytest.raises(DataError, match=r"has no key 'image_width'$"):
        Fields("x.yaml", {"image_height": 480}, ("image_height", "image_width")).raw("image_width")
